"""The stability table as a picture: a row per case, a column per figure, light where the goal is met, dark if not."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from .. import plotting  # first: it imports matplotlib

# isort: split
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from .stability import COLUMNS, Result, text

HEADS = {
    "p": "p",
    "tiny": "tiny\np",
    "sum": "sum\nof p",
    "zero": "zeros\ndrawn",
    "cdf": "CDF",
    "drawn": "drawn",
    "chi2": "chi\nsquare",
    "flux": "flux",
    "image": "image",
    "wrong": "wrong",
    "fresnel": "Fresnel",
    "nonfinite": "NaN\ninf",
}
# From light to dark also in grey; blue and orange are told apart by colour-blind readers.
HOLDS = np.array([[1.0, 1.0, 1.0], [0.62, 0.80, 0.95]])  # far below the goal, and at it
MISSES = np.array([[0.84, 0.37, 0.0], [0.30, 0.08, 0.0]])  # just above the goal, and a million times above
NONE = (0.93, 0.93, 0.93)
ROW, CELL = 0.165, 0.48  # inches


def colour(value: float | None, goal: float) -> np.ndarray:
    """The cell's colour, RGB, by the number of decades between figure and goal."""
    if value is None:
        return np.array(NONE)
    if value <= goal:
        near = 1 + math.log10(value / goal) / 3 if value > 0 and goal > 0 else 0.0
        return HOLDS[0] + max(near, 0.0) * (HOLDS[1] - HOLDS[0])
    far = math.log10(value / goal) / 6 if goal > 0 and math.isfinite(value) else 1.0
    return MISSES[0] + min(far, 1.0) * (MISSES[1] - MISSES[0])


@plotting.plain()
def table(results: Sequence[Result], title: str) -> Figure:
    """lightdome's columns, and each peer's beside them."""
    cases = [(r.group, r.case) for r in results if r.judged]
    programs = list(dict.fromkeys(r.program for r in results))
    found = {program: {(r.group, r.case): r for r in results if r.program == program} for program in programs}
    columns = {
        program: [name for name in COLUMNS if any(name in r.figures for r in found[program].values())]
        for program in programs
    }
    widths = [max(len(columns[program]), 1) for program in programs]
    labels = 4.2
    figure = Figure(figsize=(labels + CELL * sum(widths) + 0.3 * len(programs), 1.3 + ROW * len(cases)))
    width, height = figure.get_size_inches()
    left = labels
    for program, n in zip(programs, widths, strict=True):
        axes = figure.add_axes((left / width, 0.45 / height, CELL * n / width, ROW * len(cases) / height))
        _cells(axes, program, cases, columns[program], found[program])
        left += CELL * n + 0.25
        if program == programs[0]:
            _labels(axes, cases)
    figure.text(0.1 / width, 1 - 0.25 / height, title, fontsize=11)
    legend = [
        Patch(facecolor=HOLDS[0], edgecolor="0.6", label="holds, a thousandth of the goal or less"),
        Patch(facecolor=HOLDS[1], edgecolor="0.6", label="holds, near the goal"),
        Patch(facecolor=MISSES[0], label="misses"),
        Patch(facecolor=MISSES[1], label="misses by a factor of a million, or NaN"),
        Patch(facecolor=NONE, label="does not apply"),
    ]
    figure.legend(handles=legend, loc="lower center", ncols=len(legend), fontsize=7, frameon=False)
    return figure


def _cells(
    axes: Axes,
    program: str,
    cases: Sequence[tuple[str, str]],
    columns: Sequence[str],
    found: dict[tuple[str, str], Result],
) -> None:
    picture = np.full((len(cases), max(len(columns), 1), 3), NONE)
    for y, case in enumerate(cases):
        result = found.get(case)
        if result is None:
            continue
        if result.skipped:
            axes.text(0, y, result.skipped[: 9 * len(columns)], fontsize=5.5, va="center", color="0.3")
        for x, name in enumerate(columns):
            value, goal = result.figures.get(name), COLUMNS[name].goal
            picture[y, x] = colour(value, goal)
            dark = value is not None and not value <= goal
            axes.text(x, y, text(value), fontsize=6, ha="center", va="center", color="white" if dark else "black")
    axes.imshow(picture, aspect="auto", interpolation="nearest")
    axes.xaxis.tick_top()
    goals = [f"{HEADS[name]}\n≤ {text(COLUMNS[name].goal)}" for name in columns]
    axes.set_xticks(range(len(columns)), goals, fontsize=6.5)
    axes.set_yticks([])
    axes.tick_params(length=0)
    axes.set_xlabel(program, fontsize=9, fontweight="bold")
    axes.set_xticks(np.arange(len(columns) - 1) + 0.5, minor=True)
    axes.grid(which="minor", axis="x", color="white", linewidth=1)
    axes.tick_params(which="minor", length=0)
    for y in range(1, len(cases)):
        new_group = cases[y][0] != cases[y - 1][0]
        axes.axhline(y - 0.5, color="0.35" if new_group else "white", linewidth=0.8 if new_group else 0.5)
    axes.spines[:].set_visible(False)


def _labels(axes: Axes, cases: Sequence[tuple[str, str]]) -> None:
    place = axes.get_yaxis_transform()
    n = axes.get_xlim()[1] + 0.5
    for y, (group, name) in enumerate(cases):
        axes.text(-0.08 / (CELL * n), y, name, fontsize=6.5, ha="right", va="center", transform=place)
        if y == 0 or cases[y - 1][0] != group:
            axes.text(-4.1 / (CELL * n), y, group, fontsize=7, fontweight="bold", va="center", transform=place)
