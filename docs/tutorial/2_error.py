#!/usr/bin/env python3
"""Lesson 2: how the error falls with the number of samples. Usage: 2_error.py [MAP]"""

import sys
from pathlib import Path

try:
    import lightdome
    import numpy as np
    from lightdome.reference import relative_rmse
    from lightdome.rendering import render
except ImportError:
    sys.exit("lightdome is not installed for this Python; run scripts/demo, then the lesson with .venv/bin/python")

SIZE = 127

path = Path(sys.argv[1]) if len(sys.argv) > 1 else lightdome.default_map()
out = Path("out/tutorial")
out.mkdir(parents=True, exist_ok=True)
device = lightdome.open_device()
envmap = lightdome.EnvironmentMap.read(path)
distribution = lightdome.build_distribution(device, envmap)

# The image to which every estimator converges: a sum over all pixels of the map.
truth = lightdome.exact(device, envmap, SIZE)

# One set of samples for all pixels. Four times as many independent points halve the error; the others do better.
print("relative RMSE in %, mean of 8 seeds")
print("one set for all pixels      64     256    1024")
for sequence in ("independent", "stratified", "sobol", "r2", "lattice"):
    row = []
    for count in (64, 256, 1024):
        drawn = (distribution.sample(count, seed, sequence) for seed in range(8))
        errors = [relative_rmse(lightdome.shade_samples(device, samples, SIZE), truth) for samples in drawn]
        row.append(100 * np.mean(errors))
    print(f"  {sequence:<18}" + "".join(f"{error:8.2f}" for error in row))

# Fresh samples for every pixel. For the same number, the error and the time are larger, but the error is noise.
print("fresh for every pixel        8      32")
for estimator in ("light", "bsdf", "mis", "product"):
    images = dict(render(distribution, [8, 32], SIZE, estimator=estimator))
    print(f"  {estimator:<18}" + "".join(f"{100 * relative_rmse(image, truth):8.2f}" for image in images.values()))

# Bias, noise and the truth side by side, at the same exposure.
shared = lightdome.shade_samples(device, distribution.sample(64), SIZE)
((_, fresh),) = render(distribution, [64], SIZE)
exposure = lightdome.auto_exposure(truth)
picture = np.concatenate([lightdome.tone_map(image, exposure) for image in (shared, fresh, truth)], axis=1)
lightdome.write_image(out / "bias_noise_truth.png", picture)
print(f"wrote {out}/bias_noise_truth.png: 64 samples for all pixels, 64 for each, the truth")
