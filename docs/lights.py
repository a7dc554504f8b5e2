#!/usr/bin/env python3
"""Draw the picture of docs/lights.md: docs/lights.py [FOLDER], by default docs/images."""

import sys
from pathlib import Path

import lightdome
import numpy as np
from lightdome.lighting.median_cut import regions
from lightdome.maps.conventions import to_uv
from lightdome.plotting import plain, save_figure
from lightdome.reference import relative_rmse
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

COUNT = 16
SIZE = 255


@plain()
def picture() -> Figure:
    """The map with its regions and their lights, the sphere under them, and the exact one."""
    device = lightdome.open_device()
    envmap = lightdome.EnvironmentMap.read(Path(__file__).parents[1] / "data" / "default.exr")
    distribution = lightdome.build_distribution(device, envmap)
    lights = lightdome.median_cut(distribution, COUNT)
    image = lightdome.shade(device, lights.direction, lights.flux, SIZE)
    truth = lightdome.exact(device, envmap, SIZE)

    figure = Figure(figsize=(9.6, 2.6), layout="constrained")
    of_map, of_lights, exact = figure.subplots(1, 3, width_ratios=[2, 1, 1])
    of_map.imshow(lightdome.tone_map(envmap.radiance, lightdome.auto_exposure(envmap.radiance)))
    for x0, y0, x1, y1 in regions(distribution, COUNT):
        of_map.add_patch(Rectangle((x0 - 0.5, y0 - 0.5), x1 - x0, y1 - y0, fill=False, color="white", linewidth=0.8))
    place = to_uv(lights.direction) * (envmap.width, envmap.height) - 0.5
    color = lights.flux / lights.flux.max(axis=1, keepdims=True)
    of_map.scatter(*place.T, s=45, c=color ** (1 / 2.2), edgecolors="black", linewidths=1.2, zorder=2)
    of_map.set_title(f"{COUNT} regions of equal energy, and their lights", fontsize=10)

    exposure = lightdome.auto_exposure(truth)
    error = 100 * relative_rmse(image, truth)
    for axes, pixels, title in (
        (of_lights, image, f"{COUNT} lights: relative RMSE {error:.1f} %"),
        (exact, truth, "every pixel of the map"),
    ):
        axes.imshow(np.where(truth > 0, lightdome.tone_map(pixels, exposure), 255).astype(np.uint8))
        axes.set_title(title, fontsize=10)
    for axes in figure.axes:
        axes.set_axis_off()
    return figure


folder = Path(sys.argv[1] if len(sys.argv) > 1 else Path(__file__).with_name("images"))
save_figure(picture(), folder / "lights.png")
print(f"wrote {folder / 'lights.png'}")
