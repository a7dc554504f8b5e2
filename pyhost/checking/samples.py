"""Are the values of samples right, and were their pixels drawn with the right probabilities?

The convention of the directions is found first. Then each sample is checked by itself, without statistics: its radiance
must be that of the pixel in its direction, and its probability must be that pixel's share of the sum of I sin(theta).
Then all samples are checked together: a chi-square test compares how often rows, columns, levels of brightness and
cells of the unit square occur with how often they should. It rejects samples that are off by more than 5 standard
deviations, and never rejects points that are more even than chance. If it rejects them, the verdict names the known
mistake that makes these pixels likeliest.

Sources: Pharr, Jakob, Humphreys, Physically Based Rendering, 4th ed., A.5 and 12.5; Wilson and Hilferty (1931) for the
tail of chi-square.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from .. import checks
from ..errors import LightdomeError
from ..maps.envmap import EnvironmentMap
from ..maps.geometry import solid_angles
from .causes import Cause
from .laws import CHANGES, laws, luminance, right
from .places import (
    CAUSES_OF_PLACES,
    LATTICES,
    RIGHT,
    Fit,
    at_centres,
    find_fit,
    likeliest,
    on_lattice,
    places,
)
from .tables import (
    PIXELS,
    TableCheck,
    cause_named,
    colours_of,
    column,
    columns,
    directions_of,
    read_table,
    unit,
)

LIMIT = 5.0  # standard deviations beyond which pixels are drawn wrongly
LEAST = 5.0  # expected samples in a bin of the chi-square test
CLOSE = 5e-3  # allowed relative error of probabilities
UNIT = 1e-3  # allowed difference of a direction's length from 1

CAUSES_OF_SAMPLES = (
    *CAUSES_OF_PLACES,
    Cause(
        "rows drawn evenly",
        "all rows are equally likely; only the column is drawn from a CDF",
        "too much light from the dark rows of the map, and too little from the bright ones",
        "where the row is drawn: it needs the CDF of the sums of the rows",
    ),
    Cause(
        "columns drawn evenly",
        "the row is drawn from its CDF, but all columns are equally likely",
        "lamps are spread out along their rows",
        "where the column is drawn: it needs the CDF of its row",
    ),
    Cause(
        "pixels drawn evenly",
        "all pixels are equally likely",
        "much noise; with the wrong density also too much light from the poles of the map",
        "where random numbers become a pixel",
    ),
    Cause(
        "directions drawn evenly",
        "directions are drawn evenly over the sphere instead of by the map",
        "much noise",
        "where random numbers become a direction",
    ),
    Cause(
        "column found one too far",
        "the search in the CDF of a row returns a neighbouring column",
        "dark pixels next to lamps are drawn",
        "where the search in the CDF of the row ends: at the first entry above the random number",
    ),
    Cause(
        "one channel for the mean",
        "pixels are drawn by one channel instead of (R + G + B) / 3",
        "coloured lamps are too bright or too dark",
        "where luminance is computed",
    ),
    Cause(
        "largest channel for the mean",
        "pixels are drawn by their largest channel instead of (R + G + B) / 3",
        "coloured lamps are too bright or too dark",
        "where luminance is computed",
    ),
    Cause(
        "density for probability",
        "the probability is already divided by the pixel's solid angle, so it is a density per steradian",
        "far too dark if it is divided again",
        "where the probability is written",
    ),
    Cause(
        "solid angle missing",
        "the density is the probability of the pixel, without the division by its solid angle",
        "thousands of times too bright, with too much light from straight up and straight down",
        "where the density is computed: p(x, y) / solid angle of the pixel",
    ),
    Cause(
        "density over the map",
        "the density is per area of the map's unit square or of (theta, phi) instead of per steradian",
        "too much light from the poles of the map, and the wrong brightness",
        "where the density is computed: divide by 2 pi^2 sin(theta) for the unit square, by sin(theta) for angles",
    ),
    Cause(
        "probability of the row alone",
        "the probability is p(y), without p(x | y) of the column",
        "far too dark",
        "where p(y) and p(x | y) are multiplied",
    ),
    Cause(
        "probability of the column alone",
        "the probability is p(x | y), without p(y) of the row",
        "far too dark, by a different factor for each row",
        "where p(y) and p(x | y) are multiplied",
    ),
    Cause(
        "not normalised",
        "the values are proportional to the right ones, but do not sum to 1",
        "the image is too bright or too dark by a factor",
        "where I sin(theta) is divided by its sum over the map",
    ),
    Cause(
        "zero-weight pixels drawn",
        "pixels with weight 0 are drawn, whose probability is 0",
        "NaN or infinity in the image, from divisions by zero",
        "where the search in a CDF ends: at the first entry above the random number, > instead of >=",
    ),
    Cause(
        "samples repeated",
        "the same samples occur many times",
        "the error falls more slowly with the number of samples than it should",
        "where random numbers are seeded: all batches and threads must get different ones",
    ),
    Cause(
        "pixel of another convention",
        "the pixel (x, y) is not the one in the sample's direction",
        "nothing, unless a program uses the pixel",
        "where the pixel is written: x is the column, y the row from the top",
    ),
    Cause(
        "drawn by an unknown law",
        "the pixels are not drawn in proportion to I sin(theta), and no known mistake explains it",
        "some lamps are too bright, others too dark",
        "where the CDFs are built and searched",
    ),
)


def read_samples(
    path: str | Path,
) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | None, np.ndarray | None, np.ndarray | None]:
    """The arguments of :func:`check_samples` after the map, from a CSV or NPZ file.

    See :mod:`lightdome.checking.tables`. Raises :class:`LightdomeError` for a file that cannot be read, or lacks
    directions.
    """
    table = read_table(path)
    return (
        directions_of(table, path),
        colours_of(table),
        column(table, "probability", "prob", "p"),
        columns(table, ("pixel", "pixels", "xy"), PIXELS),
        column(table, "pdf", "density"),
    )


def check_samples(
    envmap: EnvironmentMap,
    direction: np.ndarray,
    radiance: np.ndarray | None = None,
    probability: np.ndarray | None = None,
    pixel: np.ndarray | None = None,
    pdf: np.ndarray | None = None,
) -> TableCheck:
    """Check samples of ``envmap``; everything but ``direction`` may be left out.

    - ``direction``: (N, 3), towards the light
    - ``radiance``: (N, 3), of the pixels
    - ``probability``: (N,), of the pixels
    - ``pixel``: (N, 2), their x and y
    - ``pdf``: (N,), density per steradian

    Raises :class:`LightdomeError` for arrays of other shapes, for values that are not finite, and for a black map.
    """
    return Located(envmap, direction, radiance, probability, pixel, pdf).result(drawn=True)


class Located:
    """Directions with the values that belong to them, and their pixels in the map."""

    def __init__(
        self,
        envmap: EnvironmentMap,
        direction: np.ndarray,
        radiance: np.ndarray | None = None,
        probability: np.ndarray | None = None,
        pixel: np.ndarray | None = None,
        pdf: np.ndarray | None = None,
    ) -> None:
        checks.instance("the map", envmap, EnvironmentMap)
        if not envmap.peak > 0:
            raise LightdomeError("the map is black: nothing can be drawn from it")
        self.map = envmap.radiance.astype(np.float64)
        self.height, self.width = self.map.shape[:2]
        count = len(checks.array("direction", direction, ("N", 3)))
        if count == 0:
            raise LightdomeError("there must be at least one direction, got none")
        self.direction, self.off_unit = unit(np.asarray(direction))
        self.radiance = _given("radiance", radiance, (count, 3))
        self.probability, self.pdf = _given("probability", probability, (count,)), _given("pdf", pdf, (count,))
        self.pixel = _given("pixel", pixel, (count, 2))
        self.count = count
        weight = right(self.map)
        self.p = weight / weight.sum()
        self.details: dict[str, object] = {"samples": count}
        self.found: list[tuple[Cause, str]] = []
        self.fit = self._fit()
        self.v, self.u = places(self.direction @ self.fit.turn.matrix.T, self.height, self.width)
        self.at_centres = at_centres(self.v, self.u, self.height, self.width)
        self.geometry = self.fit.geometry
        if self.geometry is RIGHT and not self.at_centres and min(self.height, self.width) > 1:
            made_by = (g for g in LATTICES if on_lattice(g, self.v, self.u, self.height, self.width))
            self.geometry = next(made_by, RIGHT)
        self.y, self.x = self.geometry.pixels(self.v, self.u, self.height, self.width)

    def _fit(self) -> Fit:
        """Found by the radiance, else by the density, else by where most directions point."""
        if self.radiance is not None:
            return find_fit(self.map, self.direction, self.radiance)
        if self.pdf is not None:
            area = solid_angles(self.height, self.width)[:, None]
            return find_fit((self.p / area)[..., None], self.direction, self.pdf[:, None])
        return Fit(likeliest(luminance(self.map), self.direction), fitting=1.0)

    def _add(self, name: str, remark: str = "") -> None:
        if all(cause.name != name for cause, _ in self.found):  # probabilities and densities may have the same mistake
            self.found.append((cause_named(name, CAUSES_OF_SAMPLES), remark))

    def result(self, drawn: bool) -> TableCheck:
        """Check everything that was given, and how the directions were drawn if they are samples, ``drawn``."""
        if self.off_unit > UNIT:
            self._add("directions not normalised", f"by up to {self.off_unit:.2g}")
        turn = self.fit.turn
        if self.geometry.name:
            self._add(self.geometry.name)
        self._compare_radiance()
        self.details["within"] = self.geometry.name or ("centre" if self.at_centres else "pixel")
        if not turn.is_wrong:  # else the pixels belong to a turned map
            self._compare_pixels()
        mistaken = any(cause.name == "radiance of other pixels" for cause, _ in self.found)
        if not mistaken:
            self._compare_probabilities()
            if drawn:
                self._compare_drawing()
        return TableCheck.of(self.found, self.details, self._agreement(drawn), str(turn), turn.is_wrong)

    def _agreement(self, drawn: bool) -> str:
        what = [name for name in ("radiance", "probability", "pixel", "pdf") if getattr(self, name) is not None]
        said = f"agrees: {', '.join(what or ['direction'])} of all {self.count} samples"
        if drawn:
            off = self.details.get("chi_square_deviations")
            said += (
                f", drawn in proportion to the light ({off:.1f} standard deviations; up to {LIMIT:g} is chance)"
                if isinstance(off, float) and math.isfinite(off)
                else "; too few to say whether they are drawn in proportion to the light"
            )
        return said

    def _compare_radiance(self) -> None:
        if self.radiance is None:
            return
        self.details["radiance_of_their_pixels_share"] = self.fit.fitting
        if not self.fit.fitting:
            self._add("radiance of other pixels")
            return
        pixels = self.map[self.y, self.x]
        factor = self.fit.factor
        seen = [("", _alike(self.radiance, pixels * factor))]
        seen += [("channels swapped", _alike(self.radiance[:, ::-1], pixels * factor))]
        seen += [(name, _alike(self.radiance, change(pixels))) for name, change in CHANGES.items()]
        name, same = max(seen, key=lambda pair: pair[1].mean())  # on a tie, the first
        self.details["radiance_of_their_pixels_share"] = float(same.mean())
        if same.mean() < 0.95:
            self._add("radiance of other pixels")
        elif name:
            self._add(name)
        elif abs(math.log(factor)) > 2e-3:
            self._add("radiance scaled", f"by {factor:.5g}")
        elif not same.all():
            self.details["first_sample_of_another_radiance"] = int(same.argmin())

    def _compare_pixels(self) -> None:
        if self.pixel is None:
            return
        x, y = np.round(self.pixel).astype(np.int64).T
        same = (x == self.x) & (y == self.y)
        self.details["pixels_of_their_directions_share"] = float(same.mean())
        if same.mean() > 0.95:
            return
        # A program with another convention may count pixels in its own map.
        own_v, own_u = places(self.direction, self.height, self.width)
        others = {
            "x and y exchanged": (y == self.x) & (x == self.y),
            "rows counted from the bottom": (x == self.x) & (y == self.height - 1 - self.y),
            "columns counted from the right": (x == self.width - 1 - self.x) & (y == self.y),
            "counted from 1": (x == self.x + 1) & (y == self.y + 1),
            "of the direction in lightdome's convention": (x == np.floor(own_u)) & (y == np.floor(own_v)),
        }
        name, share = max(((name, same.mean()) for name, same in others.items()), key=lambda pair: pair[1])
        self._add("pixel of another convention", name if share > 0.95 else f"{1 - same.mean():.0%} of them")

    def _compare_probabilities(self) -> None:
        area = solid_angles(self.height, self.width)[self.y]
        for values, what in (self.probability, "probability"), (self.pdf, "pdf"):
            if values is not None:
                name, more = self._law(values, area, what)
                if name:
                    self._add(name, more)

    def _law(self, values: np.ndarray, area: np.ndarray, what: str) -> tuple[str, str]:
        """The mistake in the probabilities or densities, "" for none, and a remark."""
        p = self.p[self.y, self.x]
        one = np.ones_like(area)
        per, other = (one, area) if what == "probability" else (area, one)
        rows = self.p.sum(axis=1)[self.y]
        square = np.full_like(area, 1 / (self.width * self.height))
        named = [("", p / per)]
        named += [("density for probability" if what == "probability" else "solid angle missing", p / other)]
        named += [(name, q[self.y, self.x] / per) for name, q in laws(self.map)]
        named += [("density over the map", p / square), ("density over the map", p / (square * 2 * np.pi**2))]
        if what == "probability":
            named += [
                ("probability of the row alone", rows),
                ("probability of the column alone", np.divide(p, rows, out=np.zeros_like(p), where=rows > 0)),
            ]
        else:  # a mistake in the probabilities, and none of them divided by the solid angle
            named += [(name, q[self.y, self.x] / other) for name, q in laws(self.map)]
        exact = max(((agreeing(values, q), -n) for n, (_, q) in enumerate(named)))
        self.details[f"{what}_right_share"] = agreeing(values, named[0][1])
        if exact[0] > 0.95:
            return named[-exact[1]][0], ""
        # None of them fits as it is: is one proportional to the values?
        free = []
        for n, (_, q) in enumerate(named):
            lit = (q > 0) & (values > 0)
            if lit.mean() > 0.5:
                factor = float(np.exp(np.median(np.log(values[lit]) - np.log(q[lit]))))
                free.append((agreeing(values, q * factor), -n, factor))
        share, n, factor = max(free, default=(0.0, 0, 1.0))
        if share > 0.95:
            name = named[-n][0]
            remark = f"{what} {factor:.5g} times too large"
            remark += factor_named(self.map, factor, self.count) if not name else ""
            return name or "not normalised", remark
        rough = np.abs(np.log(np.maximum(values, 1e-300) / np.maximum(p / per, 1e-300)))
        if np.median(rough) < 0.02:  # typical of differences between entries of single-precision CDFs
            self.details[f"{what}_largest_relative_error"] = float(np.expm1(rough.max()))
            return "", ""
        return "not normalised", f"no known mistake explains the {what}"

    def _compare_drawing(self) -> None:
        drawn = np.bincount(self.y * self.width + self.x, minlength=self.p.size).reshape(self.p.shape)
        off = deviations(self.p, drawn)
        self.details["chi_square_deviations"] = max(off.values(), default=math.nan)
        self.details["chi_square_deviations_by"] = off
        black = int(drawn[self.p == 0].sum())
        self.details["samples_of_black_pixels"] = black
        distinct = self._repeated(drawn)
        if max(off.values(), default=0.0) < LIMIT and not black and not distinct:
            return
        if self.found:  # a mistake that was found already may have this effect
            return
        candidates = [("", self.p), *laws(self.map)]
        # One sample in a hundred may come from anywhere, so that a single one does not rule out a law.
        logs = [(drawn * np.log(q * 0.99 + 0.01 / self.p.size)).sum() for _, q in candidates]
        best = int(np.argmax(logs))
        name, law = candidates[best]
        worst = max(off.values(), default=0.0)
        if name and logs[best] > logs[0] + 8:
            under = max(deviations(law, drawn).values(), default=0.0)
            if under < max(LIMIT, 0.25 * worst):
                self._add(name, f"this is how the pixels are drawn, {worst:.0f} standard deviations off")
                return
        if black:
            self._add("zero-weight pixels drawn", f"{black} samples")
        elif distinct:
            self._add("samples repeated", distinct)
        else:
            self._add("drawn by an unknown law", f"{worst:.0f} standard deviations")

    def _repeated(self, drawn: np.ndarray) -> str:
        """A remark if samples are repeated too often, else ""."""
        if self.count < 16:
            return ""
        if self.details["within"] == "pixel":
            unique = len(np.unique(self.direction, axis=0))
            self.details["distinct_directions"] = unique
            return f"{unique} of {self.count} are distinct" if unique < 0.95 * self.count else ""
        missed = np.exp(self.count * np.log1p(-np.minimum(self.p, 1 - 1e-12)))
        spread = math.sqrt(max(float((missed * (1 - missed)).sum()), 1.0))
        expected, distinct = float((1 - missed).sum()), int((drawn > 0).sum())
        self.details["distinct_pixels"], self.details["distinct_pixels_expected"] = distinct, expected
        if distinct < expected - 6 * spread:
            return f"{distinct} distinct pixels, expected {expected:.0f}"
        return ""


def factor_named(radiance: np.ndarray, factor: float, count: int | None = None) -> str:
    """ ": " and why probabilities may be too large by this factor, or ""."""
    weight = right(radiance)
    flux = float((luminance(radiance) * solid_angles(*radiance.shape[:2])[:, None]).sum())
    names = {
        float(weight.sum()): "not divided by the sum of I sin(theta)",
        float(3 * weight.sum()): "not divided by the sum of (R + G + B) sin(theta)",
        flux: "not divided by the total flux",
        float(weight.sum() / luminance(radiance).sum()): "divided by the sum of I without sin(theta)",
        float(weight.size): "multiplied by the number of pixels",
        4 * math.pi: "multiplied by 4 pi",
    }
    if count:
        names |= {float(count): "multiplied by the number of samples", 1 / count: "divided by the number of samples"}
    near = min(names, key=lambda value: abs(math.log(factor / value)))
    return f": {names[near]}" if abs(math.log(factor / near)) < CLOSE else ""


def _given(what: str, value: np.ndarray | None, shape: tuple[int, ...]) -> np.ndarray | None:
    if value is None:
        return None
    array = checks.array(what, value, shape, np.float64)
    if not np.isfinite(array).all():
        n = int(np.argmin(np.isfinite(array).reshape(len(array), -1).all(axis=1)))
        raise LightdomeError(f"{what} must be finite, got {checks.told(array[n].tolist())} (sample {n})")
    return array


def _alike(values: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """Which rows are equal, apart from the rounding of printed digits."""
    return np.abs(values - expected).max(axis=1) <= 2e-3 * np.abs(expected).max(axis=1)


def agreeing(values: np.ndarray, expected: np.ndarray) -> float:
    """The share of the ``values`` that are as ``expected``, apart from rounding."""
    return float((np.abs(values - expected) <= CLOSE * expected).mean())


def deviations(p: np.ndarray, drawn: np.ndarray) -> dict[str, float]:
    """By how many standard deviations chi-square is too large for rows, columns, levels of brightness, and cells.

    ``p`` (H, W) are the probabilities of the pixels, ``drawn`` how often each was drawn. A test with fewer than two
    bins is left out.
    """
    count = int(drawn.sum())
    rows = p.sum(axis=1)
    down = np.cumsum(rows) - rows / 2
    across = np.cumsum(p, axis=1) - p / 2
    across = np.divide(across, rows[:, None], out=np.zeros_like(p), where=rows[:, None] > 0)
    cells = max(1, min(16, int(math.sqrt(count / 10))))
    cell = np.minimum((down[:, None] * cells).astype(int), cells - 1) * cells
    cell = cell + np.minimum((across * cells).astype(int), cells - 1)
    order = np.argsort(p, axis=None)
    bright = np.empty(p.size)
    bright[order] = np.cumsum(p.reshape(-1)[order])
    level = np.minimum((bright * 32).astype(int), 31)

    def binned(label: np.ndarray, values: np.ndarray) -> np.ndarray:
        return np.bincount(label.reshape(-1), values.reshape(-1))

    groups = {
        "rows": (count * rows, drawn.sum(axis=1)),
        "columns": (count * p.sum(axis=0), drawn.sum(axis=0)),
        "brightness": (count * binned(level, p), binned(level, drawn)),
        "cells": (count * binned(cell, p), binned(cell, drawn)),
    }
    result = {}
    for name, (expected, seen) in groups.items():
        off = _chi_square(expected, seen.astype(float))
        if not math.isnan(off):
            result[name] = off
    return result


def _chi_square(expected: np.ndarray, seen: np.ndarray) -> float:
    """Chi-square, in standard deviations of an equally unlikely normal number; small bins are merged first."""
    sums = np.cumsum(expected)
    label = np.minimum((sums - expected / 2) // LEAST, max(0, sums[-1] // LEAST - 1)).astype(int)
    _, label = np.unique(label, return_inverse=True)
    expected, seen = np.bincount(label, expected), np.bincount(label, seen)
    order = np.argsort(expected)  # the bins next to a very likely pixel may still be small: merge the smallest
    small = int(np.searchsorted(np.cumsum(expected[order]), LEAST)) + 1
    if small > 1:
        label = np.maximum(np.argsort(order) - small + 1, 0)
        expected, seen = np.bincount(label, expected), np.bincount(label, seen)
    freedom = len(expected) - 1
    if freedom < 1 or expected.min() < LEAST / 2:
        return math.nan
    share = float(((seen - expected) ** 2 / expected).sum()) / freedom
    return (share ** (1 / 3) - (1 - 2 / (9 * freedom))) / math.sqrt(2 / (9 * freedom))
