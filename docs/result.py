#!/usr/bin/env python3
"""Draw the README's first picture: docs/result.py [FOLDER], by default docs/images."""

import sys
from pathlib import Path

import lightdome
import numpy as np
from lightdome.maps.sphere import sphere_exposure
from lightdome.plotting import plain, save_figure
from lightdome.rendering.per_pixel import render
from matplotlib.figure import Figure

MARKED = 256
SHARED, SPP = (64, 1024), (8, 64)
SIZE = 239


@plain()
def picture() -> Figure:
    """The map with its samples; below it, spheres with shared samples and with samples per pixel, and the exact one."""
    device = lightdome.open_device()
    envmap = lightdome.EnvironmentMap.read(Path(__file__).parents[1] / "data" / "default.exr")
    distribution = lightdome.build_distribution(device, envmap)
    spheres = {f"{n} samples, shared": lightdome.shade_samples(device, distribution.sample(n), SIZE) for n in SHARED}
    spheres |= {f"{n} samples per pixel": image for n, image in render(distribution, SPP, SIZE)}
    truth = lightdome.exact(device, envmap, SIZE)
    spheres["exact"] = truth

    figure = Figure(figsize=(9.6, 7.0), layout="constrained")
    of_map, below = figure.subfigures(2, 1, height_ratios=[4.7, 2.3])
    axes = of_map.subplots()
    axes.imshow(lightdome.show(envmap.radiance, distribution.sample(MARKED).pixel).pixels)
    axes.set_axis_off()
    for axes, (title, image) in zip(below.subplots(1, len(spheres)), spheres.items(), strict=True):
        shown = lightdome.tone_map(image, sphere_exposure(envmap))
        axes.imshow(np.where(truth > 0, shown, 255).astype(np.uint8))
        axes.set_title(title, fontsize=10, y=-0.14)
        axes.set_axis_off()
    return figure


folder = Path(sys.argv[1] if len(sys.argv) > 1 else Path(__file__).with_name("images"))
save_figure(picture(), folder / "result.png", 100)
print(f"wrote {folder / 'result.png'}")
