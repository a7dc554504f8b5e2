"""The report's own figures: CDFs as pictures, and what tells bias from noise.

Lines differ in style as well as in colour, and colour maps run from dark to light, so that all can be told apart in
grey.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import cycle

import numpy as np

from .. import plotting  # first: it imports matplotlib

# isort: split
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from ..disc import disc_mask
from ..maps.images import auto_exposure, tone_map
from ..opencl import memory
from ..plotting import BLACK, BLUE, VERMILLION
from ..sampling.distribution import Distribution
from ..sampling.strips import strip_borders
from .metrics import left_after_averaging

LINES = [(BLACK, "-"), (BLUE, "--"), (VERMILLION, (0, (1.2, 1.2)))]
SIDES = (1, 2, 4, 8, 16, 32, 64)  # pixels
DPI = 300  # of the pictures inside; those of 511 pixels lose no sharpness


@plotting.plain()
def cdfs(distribution: Distribution) -> Figure:
    """The map beside the CDFs over its rows, and the CDFs of every row as a picture beside those of three as curves.

    There is a CDF over rows for each strip of columns, and every row has a CDF in each strip.
    """
    radiance = distribution.envmap.radiance
    height, width = radiance.shape[:2]
    rows = memory.download(distribution.device, distribution.cdf.rows)
    rows = np.concatenate([_unit(of_strip) for of_strip in np.split(rows, strip_borders(width)[1:-1], axis=1)], axis=1)
    marginal = _unit(memory.download(distribution.device, distribution.cdf.marginal))
    # The rows in which a quarter, half and three quarters of the light are reached; these are never black.
    chosen = np.searchsorted(np.cumsum(distribution.probability_image().sum(axis=1)), (0.25, 0.5, 0.75))

    figure = Figure(figsize=(9, 5.2), layout="constrained")
    grid = figure.subplots(2, 2, width_ratios=[2, 1.15])
    (picture, over_rows), (all_rows, some_rows) = grid
    picture.imshow(tone_map(radiance, auto_exposure(radiance)), aspect="auto")
    picture.set_title("the map, and three of its rows", loc="left")
    shown = all_rows.imshow(rows, cmap="cividis", vmin=0, vmax=1, aspect="auto")
    all_rows.set_title("P(x | y, s), every row's CDFs", loc="left")
    figure.colorbar(shown, ax=all_rows, location="bottom", shrink=0.6, aspect=40, label="P(x | y, s)")
    over_rows.plot(marginal.T, np.arange(height), color=BLACK, linewidth=0.8)
    over_rows.set_title("P(y | s), the CDFs over rows", loc="left")
    over_rows.set_ylim(height - 0.5, -0.5)  # like the map beside it
    for y, (colour, style) in zip(chosen, LINES, strict=True):
        picture.axhline(y, color="white", linewidth=2.4)
        for axes in (picture, over_rows):
            axes.axhline(y, color=colour, linestyle=style, linewidth=1.2)
        some_rows.plot(rows[y], color=colour, linestyle=style, label=f"y = {y}")
    some_rows.set_title("P(x | y, s) of the three rows", loc="left")
    some_rows.set_xlim(-0.5, width - 0.5)
    some_rows.set_xlabel("x, pixels")
    some_rows.legend(fontsize=8)
    for axes in (picture, over_rows, all_rows):
        axes.set_ylabel("y, pixels")
    for axes in (over_rows, some_rows):
        axes.grid(alpha=0.3)
    return figure


def _unit(cdf: np.ndarray) -> np.ndarray:
    """CDFs along the last axis, scaled from whole numbers to 0 .. 1; those of rows without light are 0."""
    return cdf / np.maximum(cdf[:, -1:], 1).astype(np.float64)


@plotting.plain()
def bias_and_noise(
    shared: tuple[str, np.ndarray],
    per_pixel: tuple[str, np.ndarray],
    exact: np.ndarray,
    exact_per_pixel: np.ndarray | None = None,
) -> Figure:
    """Two images of similar error: where each is too bright or too dark, and their middle rows beside the exact one.

    ``exact_per_pixel`` is the exact image for ``per_pixel``, if it is not ``exact``.
    """
    mask = disc_mask(len(exact))
    mean = exact[mask].mean(dtype=np.float64)
    own = exact if exact_per_pixel is None else exact_per_pixel
    signed = {name: _grey(image - e) / mean for (name, image), e in ((shared, exact), (per_pixel, own))}
    limit = max(np.percentile(np.abs(d[mask]), 98) for d in signed.values()) or 1.0
    norm = Normalize(-100 * limit, 100 * limit)

    figure = Figure(figsize=(9, 3.4), layout="compressed")
    *pictures, curves = figure.subplots(1, 3, width_ratios=[1, 1, 1.9])
    for axes, (name, difference) in zip(pictures, signed.items(), strict=True):
        shown = axes.imshow(np.where(mask, 100 * difference, np.nan), norm=norm, cmap="cividis")
        axes.set_title(name, fontsize=10)
        axes.axhline(len(exact) // 2, color="white", linewidth=0.6)
        axes.axis("off")
    figure.colorbar(shown, ax=pictures, label="error, % of the mean radiance", location="bottom", aspect=30)

    middle = len(exact) // 2
    x = np.flatnonzero(mask[middle])
    curves.plot(x, _grey(per_pixel[1][middle, x]), color="0.55", linewidth=0.6, label=per_pixel[0])
    curves.plot(x, _grey(exact[middle, x]), color=BLACK, linewidth=2, label="exact")
    curves.plot(x, _grey(shared[1][middle, x]), color=VERMILLION, linewidth=1.8, linestyle="--", label=shared[0])
    curves.set_xlabel("x on the middle row, pixels")
    curves.set_ylabel("radiance, mean of R, G, B")
    curves.set_ylim(bottom=0)
    curves.grid(alpha=0.3)
    curves.legend(fontsize=8)
    return figure


def _grey(pixels: np.ndarray) -> np.ndarray:
    return pixels.mean(axis=-1, dtype=np.float64)  # sums of three may leave float32's range


@plotting.plain()
def averaging(
    shared: Mapping[str, np.ndarray],
    per_pixel: Mapping[str, np.ndarray],
    exact: np.ndarray,
    exact_per_pixel: np.ndarray | None = None,
) -> Figure:
    """Log-log: the error left when images are averaged over squares, by side of the squares. Noise falls, bias stays.

    ``exact_per_pixel`` is the exact image for ``per_pixel``, if it is not ``exact``.
    """
    figure = Figure(figsize=(9, 3.8), layout="constrained")
    axes = figure.add_subplot()
    markers = cycle(plotting.MARKERS)
    own = exact if exact_per_pixel is None else exact_per_pixel
    for images, truth, colour, style in ((shared, exact, BLUE, "-"), (per_pixel, own, VERMILLION, "--")):
        for name, image in images.items():
            left = [100 * left_after_averaging(image, truth, side) for side in SIDES]
            axes.plot(SIDES, left, color=colour, linestyle=style, marker=next(markers), markersize=5, label=name)
    # How the error of independent pixels falls, starting where the last line starts.
    axes.plot(SIDES, [left[0] / side for side in SIDES], color="0.6", linestyle=":", label="1 / side")
    axes.set_xscale("log", base=2)
    axes.set_yscale("log")
    axes.set_xticks(SIDES, [str(side) for side in SIDES])
    axes.set_xlabel("side of the squares averaged over, pixels")
    axes.set_ylabel("relative RMSE left, %")
    axes.grid(True, which="both", alpha=0.25)
    axes.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.01, 1))
    return figure
