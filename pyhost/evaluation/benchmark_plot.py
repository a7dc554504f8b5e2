"""The benchmark's pictures: error against time, error against count, stages, and all images at one count."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import cycle
from typing import Any

import numpy as np

from .. import plotting  # first: it imports matplotlib

# isort: split
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from ..disc import disc_mask
from ..maps.images import auto_exposure, tone_map
from ..plotting import COLOURS, MARKERS
from .benchmark import MethodMeasurement
from .metrics import LEVELS, cheapest, most_exact, pareto_front, relative_rmse, slope

ROUNDING = 1e-6  # an error below this is the exact image
READ_OUT = {"family": "monospace", "size": 7}
BEHIND: dict[str, Any] = {"color": "0.85", "linewidth": 1, "zorder": 1}
STAGES = 6  # that are shown by name
RUN_TIME, COUNT = "run time, map to image, ms (median)", "count: samples or lights in all, samples per pixel, or order"
ERROR = "relative RMSE over the sphere, %"
DASHES = {"shared": "-", "per pixel": "--", "order": ":", "peer": "-."}


def _by_method(points: Iterable[MethodMeasurement]) -> dict[str, list[MethodMeasurement]]:
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


def _logarithmic(axes: Axes, label: str) -> None:
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.grid(True, which="both", alpha=0.25)
    axes.set_xlabel(label)
    axes.set_ylabel(ERROR)


def _label_decades(axes: Axes) -> None:
    """Plain numbers at 1, 2 and 5 of each decade, or only at 1 of many decades; matplotlib's own would overlap."""
    for axis, (low, high) in (axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim()):
        axis.set_major_locator(LogLocator(subs=(1, 2, 5) if high < 300 * low else (1,)))
        axis.set_major_formatter(StrMethodFormatter("{x:g}"))
        axis.set_minor_formatter(NullFormatter())


def _places(line: Iterable[MethodMeasurement]) -> tuple[list[float], list[float]]:
    """Milliseconds and percent."""
    line = list(line)
    return [1e3 * m.wall_seconds for m in line], [100 * m.rmse for m in line]


def _counted(point: MethodMeasurement) -> str:
    said = {"per pixel": f"{point.count} spp", "order": f"order {point.count}"}
    return said.get(point.kind, f"{point.count} lights")


def _group(point: MethodMeasurement) -> str:
    """The group in which a method competes for a line in the headline: a peer program, or a kind of method."""
    if point.peer:
        return re.split("[ -]", point.method)[0]
    if point.method in ("median-cut", "harmonics"):
        return point.method
    return f"{point.kind} samples" if point.kind == "shared" else point.kind


@plotting.plain()
def error_against_time(points: Sequence[MethodMeasurement], title: str) -> Figure:
    """Log-log, the headline: a line for the best method of each group, at most seven, named where it ends.

    Groups are samples shared by all pixels, median cut, harmonics, samples per pixel, and each other program. The best
    has the least product of squared error and time, which for independent samples does not depend on their number.
    """
    figure = Figure(figsize=(9, 5.6), layout="constrained")
    axes = figure.add_subplot()
    axes.set_title(plotting.text(title), loc="left")
    _logarithmic(axes, RUN_TIME)
    groups: dict[str, list[MethodMeasurement]] = {}
    for m in points:
        if m.rmse >= ROUNDING:
            groups.setdefault(_group(m), []).append(m)
    ends, lines = [], []
    for i, (group, of_group) in enumerate(groups.items()):
        best = min(of_group, key=lambda m: m.rmse**2 * m.wall_seconds).method
        line = _by_method(of_group)[best]
        x, y = _places(line)
        axes.plot(x, y, label=plotting.text(best), **_style(i, line[0]))
        if len(line) > 1:
            axes.annotate(str(line[0].count), (x[0], y[0]), (0, 6), textcoords="offset points", fontsize=7, ha="center")
        lines.append((x, y))
        name = best if group in best else f"{group}: {best}"
        ends.append((x[-1], y[-1], plotting.text(f"{name}, {_counted(line[-1])}")))
    exact = [m for m in points if m.rmse < ROUNDING]
    if exact:
        x_exact = 1e3 * exact[0].wall_seconds
        axes.axvline(x_exact, color="0.35", linewidth=1, linestyle=DASHES["order"], label="exact")
        place = axes.get_xaxis_transform()
        axes.text(x_exact, 0.02, " exact image", transform=place, fontsize=9, color="0.35")
    axes.margins(x=0.12, y=0.08)
    _label_ends(axes, ends, lines)
    _label_decades(axes)
    return figure


def _label_ends(
    axes: Axes, ends: Sequence[tuple[float, float, str]], lines: Sequence[tuple[list[float], list[float]]]
) -> None:
    """Names to the right of (x, y), moved down or up where they would cover a line or each other.

    The axes grow to hold them. Widths and heights of names are approximate fractions of the axes.
    """
    (left, right), (low, high) = np.log(axes.get_xlim()), np.log(axes.get_ylim())
    widths = [0.03 + 0.0085 * len(name) for _, _, name in ends]
    right = max(
        [right, *(left + (np.log(x) - left) / (1 - width) for (x, _, _), width in zip(ends, widths, strict=True))]
    )
    axes.set_xlim(np.exp(left), np.exp(right))

    def place(x: Sequence[float] | float, y: Sequence[float] | float) -> tuple[np.ndarray, np.ndarray]:
        return (np.log(x) - left) / (right - left), (np.log(y) - low) / (high - low)

    drawn = [np.zeros((0, 2))]
    for line in lines:
        across, up = place(*line)
        along = np.linspace(0, len(across) - 1, 50 * len(across))
        drawn.append(np.stack([np.interp(along, range(len(across)), of_line) for of_line in (across, up)], axis=1))
    taken = np.concatenate(drawn)
    for (x, y, name), width in sorted(zip(ends, widths, strict=True), key=lambda end: end[0][1]):
        across, up = place(x, y)
        near = taken[(taken[:, 0] > across + 0.01) & (taken[:, 0] < across + width), 1]
        up = min(
            (up + 0.015 * step for step in (0, -1, 1, -2, 2, -3, 3, -4, 4, 5, 6)),
            key=lambda at: np.sum(np.abs(near - at) < 0.028),
        )
        label = axes.annotate(
            name, (x, np.exp(low + up * (high - low))), (9, -3), textcoords="offset points", fontsize=9
        )
        label.set_path_effects([withStroke(linewidth=3, foreground="white")])
        of_name = np.linspace(across, across + width, 50)
        taken = np.concatenate([taken, np.stack([of_name, np.full(50, up)], axis=1)])


def _family(point: MethodMeasurement) -> str:
    if point.peer:
        return "other programs"
    return f"per pixel: {point.method.partition('-')[0]}" if point.kind == "per pixel" else "shared by all pixels"


def _panels(
    points: Sequence[MethodMeasurement], title: str, label: str
) -> tuple[Figure, Iterator[tuple[Axes, list[list[MethodMeasurement]], list[list[MethodMeasurement]]]]]:
    """A figure with a panel for each family of methods, and for each panel: its axes, its own lines, and all others."""
    families: dict[str, list[MethodMeasurement]] = {}
    for m in points:
        families.setdefault(_family(m), []).append(m)
    columns = min(max(len(families), 1), 3)
    rows = max(-(-len(families) // columns), 1)
    figure = Figure(figsize=(4 * columns + 2.6, 3.6 * rows + 0.4), layout="constrained")
    figure.suptitle(plotting.text(title), x=0.01, ha="left")
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for axes in grid.flat[len(families) :]:
        axes.remove()

    def fill() -> Iterator[tuple[Axes, list[list[MethodMeasurement]], list[list[MethodMeasurement]]]]:
        for i, (axes, (family, own)) in enumerate(zip(grid.flat, families.items(), strict=False)):
            _logarithmic(axes, label)
            if i % columns > 0:
                axes.set_ylabel("")
            if i + columns < len(families):
                axes.set_xlabel("")
            else:
                axes.tick_params(labelbottom=True)
            axes.set_title(family, loc="left", fontsize=10)
            others = [m for m in points if _family(m) != family]
            yield axes, list(_by_method(own).values()), list(_by_method(others).values())
            axes.legend(fontsize=7.5, loc="lower right" if label == RUN_TIME else "upper right", handlelength=3)
        _label_decades(grid.flat[0])

    return figure, fill()


@plotting.plain()
def error_against_time_all(points: Sequence[MethodMeasurement], title: str) -> Figure:
    """Log-log, every method, in a panel for each family; the Pareto front, and the best at equal error and equal time.

    In each panel, the lines of other families are grey.
    """
    exact = [p for p in points if p.rmse < ROUNDING]
    points = [p for p in points if p.rmse >= ROUNDING]
    figure, panels = _panels(points, title, RUN_TIME)
    front = pareto_front(points)
    handles: list[Line2D] = []
    for axes, own, others in panels:
        for line in others:
            axes.plot(*_places(line), **BEHIND)
        for i, line in enumerate(own):
            axes.plot(*_places(line), label=plotting.text(line[0].method), **_style(i, line[0]))
            for m in {line[0].count: line[0], line[-1].count: line[-1]}.values():
                place = 1e3 * m.wall_seconds, 100 * m.rmse
                axes.annotate(str(m.count), place, (4, 4), textcoords="offset points", fontsize=6.5)
        handles = axes.step(*_places(front), where="post", color="black", linewidth=6, alpha=0.15)
        handles[0].set_label("Pareto front")
        for m, dashes in zip(exact, cycle(DASHES.values()), strict=False):
            label = f"{m.method}, {m.wall_seconds:.2g} s"
            x_exact = 1e3 * m.wall_seconds
            handles.append(axes.axvline(x_exact, color="black", linewidth=1, linestyle=dashes, label=label))
        for handle in handles:
            handle.set_label(f"_{handle.get_label()}")  # only in the figure's legend
    names = [str(handle.get_label())[1:] for handle in handles]
    legend = {"fontsize": 8, "title": _read_outs(points), "title_fontproperties": READ_OUT}
    figure.legend(handles, names, loc="outside right upper", **legend)
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
    """Log-log, every method with its spread over the seeds, in a panel for each family; slopes are in the legends."""
    several = [p for p in points if p.rmse >= ROUNDING]
    several = [p for line in _by_method(several).values() if len(line) > 1 for p in line]
    figure, panels = _panels(several, title, COUNT)
    for axes, own, others in panels:
        for line in others:
            axes.plot([m.count for m in line], [100 * m.rmse for m in line], **BEHIND)
        for i, line in enumerate(own):
            axes.errorbar(
                [m.count for m in line],
                [100 * m.rmse for m in line],
                yerr=[100 * min(m.rmse_spread, 0.9 * m.rmse) for m in line],
                label=plotting.text(f"{line[0].method}, slope {slope(line):.2f}"),
                capsize=2,
                **_style(i, line[0]),
            )
    for axes in figure.axes[:1]:  # all share its scale
        axes.set_ylim(top=8 * axes.get_ylim()[1])  # room for the legends above the lines
    return figure


@plotting.plain()
def stages(points: Sequence[MethodMeasurement], title: str) -> Figure:
    """A bar for each method at its least and its largest count: shares of the wall time, stacked.

    The bars show the six stages that take the most time, all others as one, and the host's share, which is the rest.
    """
    lines = _by_method(p for p in points if p.stages)
    points = [p for line in lines.values() for p in (line[:1] + line[-1:] if len(line) > 1 else line)]
    shares = [{name: seconds / p.wall_seconds for name, seconds in p.stages.items()} for p in points]
    total = Counter[str]()
    for of_point in shares:
        total.update(of_point)
    most = {name for name, _ in total.most_common(STAGES)}
    figure = Figure(figsize=(9, 1.2 + 0.18 * max(len(points), 6)), layout="constrained")
    axes = figure.add_subplot()
    axes.set_title(plotting.text(title), loc="left")
    bars: dict[str, list[float]] = {
        name: [of_point.get(name, 0.0) for of_point in shares] for name in total if name in most
    }
    # From dark to light, so that they can be told apart in grey too.
    looks: list[dict[str, Any]] = [{"color": colour} for colour in colormaps["viridis"](np.linspace(0, 1, len(bars)))]
    if len(total) > len(most):
        bars["other stages"] = [sum(s for name, s in of_point.items() if name not in most) for of_point in shares]
        looks.append({"color": "white", "hatch": "////"})
    bars["host"] = [max(1 - sum(of_point.values()), 0.0) for of_point in shares]
    looks.append({"color": "0.85"})
    y, left = np.arange(len(points)), np.zeros(len(points))
    for (name, widths), look in zip(bars.items(), looks, strict=True):
        axes.barh(y, widths, left=left, label=name, edgecolor="0.4", linewidth=0.4, **look)
        left += widths
    labels = [plotting.text(f"{p.method} {p.count} ({1e3 * p.wall_seconds:.1f} ms)") for p in points]
    axes.set_yticks(y, labels, fontsize=7)
    axes.set_ylim(len(points) - 0.4, -0.6)
    axes.set_xlabel("share of the wall time")
    axes.set_xlim(0, max(1.0, left.max(initial=1.0)))
    figure.legend(fontsize=8, loc="outside lower center", ncols=len(bars))
    return figure


@plotting.plain()
def images(
    named: Mapping[str, np.ndarray],
    exact: np.ndarray,
    title: str,
    exact_of: Mapping[str, np.ndarray] | None = None,
    exposure: float | None = None,
) -> Figure:
    """Every method's image above its error in false colour, beside the exact image; one scale for all errors.

    Errors are against ``exact``, except for images named in ``exact_of``, which have an exact image of their own.
    ``exposure`` is by default that of the exact image.
    """
    exposure = exposure or auto_exposure(exact)
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
