#!/usr/bin/env python3
"""Draw the picture of docs/projections.md: docs/projections.py [FOLDER], by default docs/images."""

import sys
from pathlib import Path

import numpy as np
from lightdome import maps
from lightdome.maps.geometry import column_angles, directions, row_angles
from lightdome.maps.projections import PROJECTIONS
from lightdome.plotting import plain, save_figure
from matplotlib.figure import Figure

HEIGHT = 180
RADIUS = 18.0  # degrees
AXES = np.array([[1, 0, 0], [0, 0, 1], [-1, 0, 0], [0, 0, -1], [0, 1, 0], [0, -1, 0]])
LABELS = ["+x", "+z", "−x", "−z", "+y", "−y"]
COLOURS = [(0.84, 0.37, 0), (0, 0.45, 0.7), (0.8, 0.47, 0.65), (0, 0.62, 0.45), (0.94, 0.89, 0.26), (0.62, 0.62, 0.62)]
SKY, GROUND = (0.82, 0.9, 0.97), (0.88, 0.84, 0.78)
# The position of each in a grid of 5 x 12: rows and columns.
PLACES = {
    "latlong": ((0, 2), (0, 4)),
    "angular": ((0, 2), (4, 7)),
    "mirror": ((0, 2), (7, 10)),
    "octahedral": ((2, 4), (7, 10)),
    "cube-cross": ((2, 4), (4, 7)),
    "cube-cross-horizontal": ((2, 4), (0, 4)),
    "cube-strip-horizontal": ((4, 5), (0, 10)),
    "cube-strip": ((0, 5), (10, 12)),
}


@plain()
def projections() -> Figure:
    """Sky and ground, with a patch of a different colour around each axis, in every projection."""
    towards = directions(row_angles(HEIGHT)[:, None], column_angles(2 * HEIGHT))
    radiance = np.where(towards[..., 1:2] > 0, SKY, GROUND)
    for axis, colour in zip(AXES, COLOURS, strict=True):
        radiance[towards @ axis > np.cos(np.radians(RADIUS))] = colour
    figure = Figure(figsize=(9.6, 6.6), layout="constrained")
    grid = figure.add_gridspec(5, 12)
    for name, (rows, columns) in PLACES.items():
        projection = PROJECTIONS[name]
        image = maps.convert(radiance, to=name)
        shape = image.shape[:2]
        panel = figure.add_subplot(grid[slice(*rows), slice(*columns)])
        panel.imshow(np.where(projection.used(shape)[..., None], image, 1), interpolation="nearest")
        inward = AXES + 1e-3 * np.array([0.3, 0.4, 0.5])  # so that +z and -y are inside the image
        inward /= np.linalg.norm(inward, axis=1)[:, None]
        for label, *place in zip(LABELS, *projection.positions(inward, shape), strict=True):
            x, y = np.clip(place, 0.05 * np.array(shape[::-1]), 0.95 * np.array(shape[::-1]))
            panel.text(x, y, label, ha="center", va="center", fontsize=9, weight="bold")
        panel.set_title(name, fontsize=10)
        panel.axis("off")
    return figure


folder = Path(sys.argv[1] if len(sys.argv) > 1 else Path(__file__).with_name("images"))
save_figure(projections(), folder / "projections.png")
print(f"wrote {folder}/projections.png")
