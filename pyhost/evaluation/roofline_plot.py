"""The pictures of :mod:`lightdome.evaluation.roofline`: stages under the machine's roof; how time and memory grow."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from .. import plotting  # first: it imports matplotlib

# isort: split
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import NullLocator

from ..plotting import COLOURS, MARKERS
from .metrics import exponent
from .roofline import AXES, Limits, StageMeasurement, extent, lines

SHAPES = [*MARKERS, "d", (4, 1, 0)]
LEAST_PEAK = 1.0  # MiB; smaller peaks depend on which pages the allocator had at hand
AXIS_LABELS = {"map": "pixels of the map", "resolution": "pixels of the image", "N": "N, samples or lights"}


def _styles(points: Sequence[StageMeasurement]) -> dict[str, dict[str, Any]]:
    """A colour and a marker for each stage, the same in all pictures; markers tell stages apart in grey."""
    names = list(dict.fromkeys(p.stage for p in points))
    return {
        name: {"color": COLOURS[i % len(COLOURS)], "marker": SHAPES[i % len(SHAPES)]} for i, name in enumerate(names)
    }


@plotting.plain()
def roofline(points: Sequence[StageMeasurement], limits: Limits, title: str) -> Figure:
    """Operations per second over operations per byte, log-log: large marks are the longest runs, small ones others.

    Marks carry the legend's numbers, since names would cover other marks. A hollow mark is a stage that was counted
    as brute force, so it may lie above the roof.
    """
    styles = _styles(points)
    figure = Figure(figsize=(12, 7), layout="constrained")
    axes = figure.add_subplot()
    axes.set_title(title, loc="left")
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.grid(True, alpha=0.25)
    axes.set_xlabel("operations on float32 per byte")
    axes.set_ylabel("operations per second")

    intensity = [p.operations / p.bytes for p in points]
    x = np.geomspace(min(intensity) / 2, max(intensity) * 8, 200)
    for size, dash in (max(limits.copies, key=lambda size: limits.copies[size]), "--"), (max(limits.copies), "-"):
        said = f"copy of {size >> 20} MiB: {1e-9 * limits.copies[size]:.3g} GB/s"
        axes.plot(x, np.minimum(limits.copies[size] * x, limits.multiply_adds), dash, color="black", label=said)
    axes.plot([], [], " ", label=f"multiply-adds: {1e-9 * limits.multiply_adds:.3g} G/s")

    for number, (name, style) in enumerate(styles.items(), 1):
        of_stage = sorted((p for p in points if p.stage == name), key=lambda p: p.seconds)
        places = [(p.operations / p.bytes, p.operations / p.seconds) for p in of_stage]
        axes.plot(*zip(*places, strict=True), **style, linestyle="none", markersize=3, alpha=0.5)
        longest = of_stage[-1]
        skips = longest.counted == "brute force"
        share = f"{longest.bound_share:.1f} x brute force" if skips else f"{100 * longest.bound_share:.3g} %"
        axes.plot(
            *places[-1],
            **style,
            linestyle="none",
            markersize=9,
            markerfacecolor="white" if skips else style["color"],
            markeredgecolor=style["color"] if skips else "black",
            label=f"{number}  {name}, {_size(longest)}: {share}",
        )
        axes.annotate(str(number), places[-1], (6, 4), textcoords="offset points", fontsize=8)
    axes.legend(
        fontsize=8, loc="upper left", bbox_to_anchor=(1.01, 1), title="longest run: share of the limit that binds it"
    )
    return figure


def _size(point: StageMeasurement) -> str:
    parts = []
    if point.width:
        parts.append(f"{point.width} x {point.height}")
    if point.resolution:
        parts.append(f"R {point.resolution}")
    if point.N:
        parts.append(f"N {point.N}")
    return ", ".join(parts)


@plotting.plain()
def scaling(points: Sequence[StageMeasurement], title: str) -> Figure:
    """Time and peak memory against the size of the map, of the image, and N; fitted exponents in the legends."""
    styles = _styles(points)
    figure = Figure(figsize=(13, 10), layout="constrained")
    figure.suptitle(title, x=0.01, ha="left")
    grid = figure.subplots(3, len(AXES), squeeze=False, height_ratios=(3, 3, 1.6))
    for axis, (times, memories, legend) in zip(AXES, grid.T, strict=True):
        handles: list[Line2D] = []
        ticks: dict[float, str] = {}
        for name, line in lines(points, axis).items():
            sizes = [extent(p, axis) or 0 for p in line]
            ticks |= {size: _tick(p, axis) for size, p in zip(sizes, line, strict=True)}
            times.plot(sizes, [1e3 * p.seconds for p in line], **styles[name])
            known = [(s, p.peak_bytes / 2**20) for s, p in zip(sizes, line, strict=True) if p.peak_bytes]
            known = [(size, peak) for size, peak in known if peak >= LEAST_PEAK]
            memories.plot(*zip(*known, strict=True) if known else ((), ()), **styles[name])
            time = exponent(sizes, [p.seconds for p in line])
            memory = exponent(*zip(*known, strict=True)) if known else None
            label = f"{name}: {_power(time)}, {_power(memory)}"
            handles.append(Line2D([], [], **styles[name], label=label))
        if not any(len(line.get_xdata()) for line in memories.lines):
            memories.set_ylim(LEAST_PEAK, 1000 * LEAST_PEAK)  # a logarithmic axis needs limits
        for axes in (times, memories):
            axes.set_xscale("log")
            axes.set_yscale("log")
            axes.grid(True, alpha=0.25)
            axes.set_xticks(list(ticks), list(ticks.values()))
            axes.xaxis.set_minor_locator(NullLocator())
            axes.set_xlabel(AXIS_LABELS[axis])
        times.set_ylabel("device time, ms (median)")
        memories.set_ylabel(f"peak memory beside the input, MiB (from {LEAST_PEAK:g})")
        legend.axis("off")
        legend.legend(handles=handles, fontsize=8, loc="upper center", ncols=2, title="exponents of time, memory")
    return figure


def _tick(point: StageMeasurement, axis: str) -> str:
    return {
        "map": f"{point.width} x {point.height}",
        "resolution": f"{point.resolution} x {point.resolution}",
        "N": f"{point.N}",
    }[axis]


def _power(value: float | None) -> str:
    return "–" if value is None else f"{round(value, 2) + 0.0:.2f}"  # never -0.00
