"""The benchmark's pictures: error against time, error against count, stages, and all images at one count."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import Any

import numpy as np

from .. import plotting  # first: it imports matplotlib

# isort: split
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from ..disc import disc_mask
from ..maps.images import auto_exposure, tone_map
from ..plotting import COLOURS, MARKERS
from .benchmark import MethodMeasurement
from .metrics import LEVELS, cheapest, most_exact, pareto_front, relative_rmse, slope

ROUNDING = 1e-6  # an error below this is the exact image
READ_OUT = {"family": "monospace", "size": 7}
DASHES = {"shared": "-", "per pixel": "--", "order": ":", "peer": "-."}


def _by_method(points: Sequence[MethodMeasurement]) -> dict[str, list[MethodMeasurement]]:
    result: dict[str, list[MethodMeasurement]] = {}
    for point in points:
        result.setdefault(point.method, []).append(point)
    return {name: sorted(of_it, key=lambda m: m.count) for name, of_it in result.items()}


def _style(index: int, point: MethodMeasurement) -> dict[str, Any]:
    return {
        "color": COLOURS[index % len(COLOURS)],
        "marker": MARKERS[index % len(MARKERS)],
        "linestyle": DASHES.get("peer" if point.peer else point.kind, "-"),
        "markersize": 6,
    }


def _axes(title: str) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(11, 6), layout="constrained")
    axes = figure.add_subplot()
    axes.set_title(plotting.text(title), loc="left")
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.grid(True, which="both", alpha=0.25)
    return figure, axes


def _label_decades(axes: Axes) -> None:
    """Plain numbers at 1, 2 and 5 of each decade, or at 1 where decades are many; matplotlib's would overlap."""
    for axis, (low, high) in (axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim()):
        axis.set_major_locator(LogLocator(subs=(1, 2, 5) if high < 300 * low else (1,)))
        axis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axis.set_minor_formatter(NullFormatter())


@plotting.plain()
def error_against_time(points: Sequence[MethodMeasurement], title: str) -> Figure:
    """Log-log, a line for each method, the Pareto front drawn, with read-outs at equal error and equal time."""
    exact = [p for p in points if p.rmse < ROUNDING]
    points = [p for p in points if p.rmse >= ROUNDING]
    figure, axes = _axes(title)
    for i, (name, line) in enumerate(_by_method(points).items()):
        axes.plot(
            [1e3 * m.wall_seconds for m in line],
            [100 * m.rmse for m in line],
            label=plotting.text(name),
            **_style(i, line[0]),
        )
        for m in line:
            axes.annotate(
                str(m.count),
                (1e3 * m.wall_seconds, 100 * m.rmse),
                textcoords="offset points",
                xytext=(4, 4),
                fontsize=6,
                alpha=0.7,
            )
    front = pareto_front(points)
    axes.step(
        [1e3 * m.wall_seconds for m in front],
        [100 * m.rmse for m in front],
        where="post",
        color="black",
        linewidth=6,
        alpha=0.15,
        label="Pareto front",
    )
    axes.set_xlabel("run time, map to image, ms (median)")
    axes.set_ylabel("relative RMSE over the sphere, %")
    for m, dashes in zip(exact, cycle(DASHES.values()), strict=False):
        label = f"{m.method}, {m.wall_seconds:.2g} s"
        axes.axvline(1e3 * m.wall_seconds, color="black", linewidth=1, linestyle=dashes, label=label)
    _label_decades(axes)
    # Beside the plot: inside, they would cover points.
    axes.legend(
        fontsize=8, loc="upper left", bbox_to_anchor=(1.01, 1), title=_read_outs(points), title_fontproperties=READ_OUT
    )
    return figure


def _read_outs(points: Sequence[MethodMeasurement]) -> str:
    lines = ["cheapest at equal error"]
    for error in LEVELS:
        best = cheapest(points, error)
        found = f"{best.method} {best.count}, {1e3 * best.wall_seconds:.1f} ms" if best else "none measured"
        lines.append(f"  {100 * error:4.1f} %  {found}")
    lines.append("most exact at equal time")
    for seconds in (0.01, 0.03, 0.1, 1):
        best = most_exact(points, seconds)
        found = f"{best.method} {best.count}, {100 * best.rmse:.2f} %" if best else "none measured"
        lines.append(f"  {1e3 * seconds:4.0f} ms {found}")
    return "\n".join(lines)


@plotting.plain()
def error_against_count(points: Sequence[MethodMeasurement], title: str) -> Figure:
    """Log-log, a line for each method with its spread over the seeds, the fitted slope in the legend."""
    figure, axes = _axes(title)
    lines = {n: line for n, line in _by_method([p for p in points if p.rmse > 0]).items() if len(line) > 1}
    for i, (name, line) in enumerate(lines.items()):
        exponent = slope(line)
        axes.errorbar(
            [m.count for m in line],
            [100 * m.rmse for m in line],
            yerr=[100 * min(m.rmse_spread, 0.9 * m.rmse) for m in line],
            label=plotting.text(f"{name}, slope {exponent:.2f}"),
            capsize=2,
            **_style(i, line[0]),
        )
    axes.set_xlabel("count: samples or lights in all, samples per pixel, or order")
    axes.set_ylabel("relative RMSE over the sphere, %")
    _label_decades(axes)
    if lines:
        axes.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.01, 1))
    return figure


@plotting.plain()
def stages(points: Sequence[MethodMeasurement], title: str) -> Figure:
    """A bar for each run: time of each stage stacked, and what the host adds up to the wall time."""
    points = [p for p in points if p.stages]
    names = list(dict.fromkeys(stage for p in points for stage in p.stages))
    figure = Figure(figsize=(9, 0.8 + 0.22 * max(len(points), 6)), layout="constrained")
    axes = figure.add_subplot()
    axes.set_title(plotting.text(title), loc="left")
    y = np.arange(len(points))
    left = np.zeros(len(points))
    hatches = ["", "//", "..", "xx", "\\\\", "--", "++", "oo"]
    for i, name in enumerate(names):
        width = np.array([p.stages.get(name, 0) / p.wall_seconds for p in points])
        axes.barh(
            y, width, left=left, label=name, color=COLOURS[i % len(COLOURS)], hatch=hatches[(i + i // 8) % 8], alpha=0.8
        )
        left += width
    axes.barh(y, np.maximum(1 - left, 0), left=left, label="host", color="0.9", edgecolor="0.6")
    labels = [plotting.text(f"{p.method} {p.count} ({1e3 * p.wall_seconds:.1f} ms)") for p in points]
    axes.set_yticks(y, labels, fontsize=7)
    axes.invert_yaxis()
    axes.set_xlabel("share of the wall time")
    axes.set_xlim(0, max(1.0, left.max(initial=1.0)))
    figure.legend(fontsize=8, loc="outside lower center", ncols=6)
    return figure


@plotting.plain()
def images(
    named: Mapping[str, np.ndarray], exact: np.ndarray, title: str, exact_of: Mapping[str, np.ndarray] | None = None
) -> Figure:
    """Every method's image over its error in false colour, beside the exact image; one scale for all errors.

    Errors are against ``exact``, or by an image's name against another one in ``exact_of``.
    """
    exposure = auto_exposure(exact)
    mask = disc_mask(len(exact))
    peak = exact.max()
    norm = LogNorm(1e-4, 1)
    columns = min(len(named) + 1, 6)
    bands = -(-(len(named) + 1) // columns)
    figure = Figure(figsize=(2.1 * columns, 4.5 * bands + 0.7), layout="compressed")
    figure.suptitle(plotting.text(title), x=0.01, ha="left")
    grid = figure.subplots(2 * bands, columns, squeeze=False)
    for axes in grid.flat:
        axes.axis("off")
    error_axes = []
    for i, (name, image) in enumerate([("exact", exact), *named.items()]):
        band, column = divmod(i, columns)
        top, bottom = grid[2 * band, column], grid[2 * band + 1, column]
        picture = tone_map(image, exposure)
        picture[~mask] = 255
        top.imshow(picture)
        top.set_title(plotting.text(name), fontsize=9)
        if i == 0:
            continue
        own = (exact_of or {}).get(name, exact)
        error = np.abs(image - own).max(axis=2) / peak
        bottom.imshow(np.where(mask, np.maximum(error, 1e-4), np.nan), norm=norm, cmap="magma")
        bottom.set_title(f"{100 * relative_rmse(image[mask], own[mask]):.2f} %", fontsize=8)
        error_axes.append(bottom)
    figure.colorbar(
        ScalarMappable(norm, "magma"),
        ax=error_axes or list(grid.flat),
        label="largest channel's error / image maximum",
        shrink=0.7,
        location="bottom",
    )
    return figure
