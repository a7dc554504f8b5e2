#!/usr/bin/env python3
"""Draw the pictures of docs/conventions.md: docs/conventions.py [FOLDER], by default docs/images."""

import sys
from pathlib import Path

import numpy as np
from lightdome import EnvironmentMap
from lightdome.maps.conventions import PRESETS, to_axes, to_uv
from lightdome.maps.geometry import column_angles, directions, row_angles
from lightdome.maps.rotation import rotation_matrix
from lightdome.plotting import plain, save_figure
from matplotlib.figure import Figure

HEIGHT = 180
RADIUS = 18.0  # degrees
AXES = np.array([[1, 0, 0], [0, 0, 1], [-1, 0, 0], [0, 0, -1], [0, 1, 0], [0, -1, 0]])
COLOURS = [(0.84, 0.37, 0), (0, 0.45, 0.7), (0.8, 0.47, 0.65), (0, 0.62, 0.45), (0.94, 0.89, 0.26), (0.62, 0.62, 0.62)]
SKY, GROUND = (0.82, 0.9, 0.97), (0.88, 0.84, 0.78)


def labelled_map() -> EnvironmentMap:
    """Sky and ground, with a patch of a different colour around each of lightdome's axes."""
    towards = directions(row_angles(HEIGHT)[:, None], column_angles(2 * HEIGHT))
    radiance = np.where(towards[..., 1:2] > 0, SKY, GROUND)
    for axis, colour in zip(AXES, COLOURS, strict=True):
        radiance[towards @ axis > np.cos(np.radians(RADIUS))] = colour
    return EnvironmentMap(radiance)


def axis_name(axis: np.ndarray) -> str:
    """The name of an axis, such as +x."""
    nth = int(np.abs(axis).argmax())
    return ("+" if axis[nth] > 0 else "−") + "xyz"[nth]


def show(axes: object, envmap: EnvironmentMap, labels: dict[str, np.ndarray], title: str) -> None:
    """Draw a map, with a label at each position (u, v)."""
    axes.imshow(envmap.radiance, extent=(0, 1, 1, 0), aspect=0.5, interpolation="nearest")
    for label, (u, v) in labels.items():
        u = 0.5 if min(v, 1 - v) < 1e-6 else u  # at a pole, any u will do
        places = {0.0: "left", 1.0: "right"} if min(u, 1 - u) < 0.02 else {u: "center"}
        for place, across in places.items():
            axes.text(place, np.clip(v, 0.05, 0.95), label, ha=across, va="center", fontsize=9, weight="bold")
    axes.set_title(title, fontsize=10)
    axes.set_xticks([0, 0.25, 0.5, 0.75, 1], ["0", "¼", "½", "¾", "u = 1"], fontsize=8)
    axes.set_yticks([])


@plain()
def conventions() -> Figure:
    """The labelled map as each program expects it, labelled with the program's own axes."""
    figure = Figure(figsize=(9.6, 4), layout="constrained")
    for panel, name in zip(figure.subplots(2, 3).flat, PRESETS, strict=True):
        own = to_axes(AXES, name)
        labels = {axis_name(axis): to_uv(axis, name) for axis in own}
        hand = "left" if np.linalg.det(PRESETS[name].axes) < 0 else "right"
        show(panel, labelled_map().to_convention(name), labels, f"{name}: {axis_name(own[4])} up, {hand}-handed")
    return figure


@plain()
def rotations() -> Figure:
    """The labelled map, and the map turned by 30 degrees about each axis."""
    figure = Figure(figsize=(7, 4), layout="constrained")
    turns = {
        "as it is": (0,),
        "yaw 30: about +y": (30,),
        "pitch 30: about +x": (0, 30),
        "roll 30: about +z": (0, 0, 30),
    }
    for panel, (title, turn) in zip(figure.subplots(2, 2).flat, turns.items(), strict=True):
        turned = AXES @ rotation_matrix(*turn).T
        labels = {axis_name(axis): to_uv(place) for axis, place in zip(AXES, turned, strict=True)}
        show(panel, labelled_map().rotated(*turn), labels, title)
    return figure


folder = Path(sys.argv[1] if len(sys.argv) > 1 else Path(__file__).with_name("images"))
for name, figure in {"conventions": conventions(), "rotations": rotations()}.items():
    save_figure(figure, folder / f"{name}.png")
    print(f"wrote {folder / name}.png")
