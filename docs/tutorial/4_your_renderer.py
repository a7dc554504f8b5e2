#!/usr/bin/env python3
"""Lesson 4: check a renderer of your own against the exact image. Usage: 4_your_renderer.py [MAP]"""

import sys
from pathlib import Path

try:
    import lightdome
    import numpy as np
    from lightdome.reference import normals, relative_rmse
except ImportError:
    sys.exit("lightdome is not installed for this Python; run scripts/demo, then the lesson with .venv/bin/python")

SIZE = 63

path = Path(sys.argv[1]) if len(sys.argv) > 1 else lightdome.default_map()
out = Path("out/tutorial")
out.mkdir(parents=True, exist_ok=True)
device = lightdome.open_device()
envmap = lightdome.EnvironmentMap.read(path)
truth = lightdome.exact(device, envmap, SIZE)


def your_renderer(radiance: np.ndarray, spp: int, rng: np.random.Generator, mistake: bool) -> np.ndarray:
    """A stand-in for your renderer. It draws pixels by I sin(theta), or forgets the sine by mistake."""
    height, width, _ = radiance.shape
    theta, phi = np.pi * (np.arange(height) + 0.5) / height, 2 * np.pi * (np.arange(width) + 0.5) / width
    intensity = radiance.astype(np.float64).sum(axis=2) / 3
    solid_angle = 2 * np.pi / width * np.pi / height * np.sin(theta)[:, None]  # nearly; theory.md has the exact one
    weight = intensity if mistake else intensity * np.sin(theta)[:, None]
    y, x = np.divmod(rng.choice(weight.size, spp, p=(weight / weight.sum()).ravel()), width)
    direction = np.stack([np.sin(theta[y]) * np.cos(phi[x]), np.cos(theta[y]), np.sin(theta[y]) * np.sin(phi[x])])
    density = intensity[y, x] / (intensity * solid_angle).sum()  # per steradian
    cosine = np.maximum(np.nan_to_num(normals(SIZE)) @ direction, 0)
    return cosine @ (radiance[y, x] / density[:, None]) / (np.pi * spp)  # the albedo is 1


# With four times the samples, the error of the right renderer halves. That of the wrong one stops falling.
rng = np.random.default_rng(1)
print("relative RMSE in %\nsamples     right   wrong")
for spp in (64, 256, 1024, 4096, 16384):
    images = [your_renderer(envmap.radiance, spp, rng, mistake) for mistake in (False, True)]
    print(f"{spp:>7}  " + "".join(f"{100 * relative_rmse(image, truth):8.2f}" for image in images))

# lightdome recognises this mistake, and many others.
for image in images:
    print(lightdome.check_image(device, image, envmap, samples=spp).verdict)

# The difference shows why. Red is too bright: it is lit from near the poles, here the floor. Blue is too dark.
difference = (images[1] - truth).mean(axis=2) / truth.max()
picture = np.zeros((SIZE, SIZE, 3), np.float32)
picture[..., 0], picture[..., 2] = np.maximum(difference, 0), np.maximum(-difference, 0)
picture = lightdome.tone_map(picture, 1 / np.abs(difference).max()).repeat(4, axis=0).repeat(4, axis=1)
lightdome.write_image(out / "difference.png", picture)
print(f"wrote {out}/difference.png")
