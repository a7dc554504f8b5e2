#!/usr/bin/env python3
"""Lesson 1: from a map to samples to a sphere. Usage: 1_light.py [MAP]"""

import sys
from pathlib import Path

try:
    import lightdome
except ImportError:
    sys.exit("lightdome is not installed for this Python; run scripts/demo, then the lesson with .venv/bin/python")

path = Path(sys.argv[1]) if len(sys.argv) > 1 else lightdome.default_map()
out = Path("out/tutorial")
out.mkdir(parents=True, exist_ok=True)

# A map is radiance by direction: an array (H, W, 3) whose row 0 is straight up.
envmap = lightdome.EnvironmentMap.read(path)
print(f"{path.name}: {envmap.width} x {envmap.height}, brightest value {envmap.peak:g}")

# The distribution is built on a device. The flux is the integral of (R + G + B) / 3 over all directions.
device = lightdome.open_device()
distribution = lightdome.build_distribution(device, envmap)
print(f"{device.description}\nflux {distribution.flux:.4f}")

# Samples are numpy arrays. Pixels are drawn in proportion to their light.
samples = distribution.sample(1024, seed=1)
x, y = samples.pixel[0]
print(f"first sample: pixel ({x}, {y}), direction {samples.direction[0]}, radiance {samples.radiance[0]}")
print(f"  drawn with probability {samples.probability[0]:.3g}, density {samples.density[0]:.3g} per steradian")

# Mark 64 of them on the map, of which every fourth pixel is shown. Most are in windows and lamps.
picture = lightdome.show(envmap.radiance[::4, ::4], samples[:64].pixel // 4).pixels
lightdome.write_image(out / "samples.png", picture)

# Each sample carries a share of the light, and together they carry all of it. Because pixels are drawn by
# (R + G + B) / 3, all shares of that sum are equal, and only the directions are random.
print(f"flux of the samples: {samples.flux.mean(axis=1).sum():.4f}")

# The same samples light every pixel of the sphere. The .pfm holds linear radiance; the .png is for viewing.
image = lightdome.shade_samples(device, samples, resolution=255)
lightdome.write_image(out / "sphere.pfm", image)
picture = lightdome.tone_map(image, lightdome.auto_exposure(image))
lightdome.write_image(out / "sphere.png", picture)
print(f"wrote {out}/samples.png, sphere.pfm and sphere.png")
