#!/usr/bin/env python3
"""Lesson 3: a map as a few lights, for a renderer without environment maps. Usage: 3_lights.py [MAP]"""

import sys
from pathlib import Path

try:
    import lightdome
    import numpy as np
    from lightdome.reference import relative_rmse
except ImportError:
    sys.exit("lightdome is not installed for this Python; run scripts/demo, then the lesson with .venv/bin/python")

SIZE = 127

path = Path(sys.argv[1]) if len(sys.argv) > 1 else lightdome.default_map()
out = Path("out/tutorial")
out.mkdir(parents=True, exist_ok=True)
device = lightdome.open_device()
envmap = lightdome.EnvironmentMap.read(path)
distribution = lightdome.build_distribution(device, envmap)
truth = lightdome.exact(device, envmap, SIZE)

# Median cut divides the map into rectangles of equal energy, and makes each one a light. Nothing is random, so there
# is no noise. Any number of lights is possible.
spheres = [truth]
for count in (4, 16, 64, 100):
    lights = lightdome.median_cut(distribution, count)
    image = lightdome.shade(device, lights, resolution=SIZE)
    spheres.append(image)
    print(f"{count:>4} lights: {100 * relative_rmse(image, truth):6.2f} % from the exact image")

# The exact image, and the images of 4 and 16 lights.
exposure = lightdome.auto_exposure(truth)
picture = np.concatenate([lightdome.tone_map(image, exposure) for image in spheres[:3]], axis=1)
lightdome.write_image(out / "lights.png", picture)

# The file has one light per line: the direction towards it and its flux, the irradiance of a surface that faces it.
lightdome.write_csv(out / "lights.csv", lights)
lightdome.write_pbrt(out / "lights.pbrt", lights)
print((out / "lights.csv").read_text().partition("\n")[0])
print(f"wrote {out}/lights.png, and {len(lights)} lights into lights.csv and lights.pbrt")

# A shader needs no lights at all: nine numbers per channel are enough.
harmonics = lightdome.project(device, envmap, order=2)
image = lightdome.shade_harmonics(device, harmonics, SIZE)
print(f"9 harmonics: {100 * relative_rmse(image, truth):6.2f} %")
print(harmonics.coefficients.round(4))
