"""Are samples of a map what they say, and are their pixels drawn with the right probabilities?

First the convention of the directions is found. Then each sample is looked at alone, without statistics: its radiance
must be that of the pixel in its direction, its probability I sin(theta) over the sum of that. Then all together: how
often rows, columns, levels of brightness and cells of the unit square occur is compared by chi-square with how often
they should. It alarms beyond 5 standard deviations; points that are more even than chance never do. If it alarms, the
known mistake under which these pixels are likeliest is named.

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
    verdict_of,
)

LIMIT = 5.0  # standard deviations, from which on pixels are drawn wrongly
LEAST = 5.0  # samples that a bin of chi-square expects
CLOSE = 5e-3  # relative, of probabilities
UNIT = 1e-3  # how far the length of a direction may be from 1

CAUSES_OF_SAMPLES = (
    *CAUSES_OF_PLACES,
    Cause(
        "rows drawn evenly",
        "every row is drawn as often as every other, and only the column by its CDF",
        "too much light from dark rows' lamps, and too little from bright ones",
        "where the row is drawn: it needs the CDF of the rows' sums",
    ),
    Cause(
        "columns drawn evenly",
        "the row is drawn by its CDF, and the column evenly",
        "lamps are spread along their rows",
        "where the column is drawn: it needs the CDF of its row",
    ),
    Cause(
        "pixels drawn evenly",
        "every pixel is drawn as often as every other",
        "much noise; too much light from the poles of the map if the density says otherwise",
        "where the random numbers become a pixel",
    ),
    Cause(
        "directions drawn evenly",
        "directions are drawn evenly over the sphere, and not by the map",
        "much noise",
        "where the random numbers become a direction",
    ),
    Cause(
        "column found one too far",
        "the search in a row's CDF returns a neighbouring column",
        "dark pixels beside lamps are drawn",
        "where the search in the row's CDF ends: the first entry above the random number",
    ),
    Cause(
        "one channel for the mean",
        "pixels are drawn by one channel, and not by (R + G + B) / 3",
        "coloured lamps are too bright or too dark",
        "where the luminance is made",
    ),
    Cause(
        "largest channel for the mean",
        "pixels are drawn by their largest channel, and not by (R + G + B) / 3",
        "coloured lamps are too bright or too dark",
        "where the luminance is made",
    ),
    Cause(
        "density for probability",
        "the probability is divided by the pixel's solid angle already: it is a density per steradian",
        "far too dark if it is divided once more",
        "where the probability is written",
    ),
    Cause(
        "solid angle missing",
        "the density is the probability of the pixel, and not divided by the pixel's solid angle",
        "thousands of times too bright, and too much light from straight up and straight down",
        "where the density is made: p(x, y) / solid angle of the pixel",
    ),
    Cause(
        "density over the map",
        "the density is one over the map's unit square or over (theta, phi), and not per steradian",
        "too much light from the poles of the map, and a wrong brightness",
        "where the density is made: it needs 1 / (2 pi^2 sin(theta)) for the unit square, 1 / sin(theta) for angles",
    ),
    Cause(
        "probability of the row alone",
        "the probability is p(y), without the column's p(x | y)",
        "far too dark",
        "where p(y) and p(x | y) are multiplied",
    ),
    Cause(
        "probability of the column alone",
        "the probability is p(x | y), without the row's p(y)",
        "far too dark, by another factor for each row",
        "where p(y) and p(x | y) are multiplied",
    ),
    Cause(
        "not normalised",
        "the values are proportional to the right ones, but their sum is not 1",
        "the image is too bright or too dark by a factor",
        "where I sin(theta) is divided by its sum over the map",
    ),
    Cause(
        "zero-weight pixels drawn",
        "pixels of weight 0 are drawn, which have no probability",
        "divisions by zero: NaN or infinity in the image",
        "where the search in a CDF ends: the first entry above the random number, > and not >=",
    ),
    Cause(
        "samples repeated",
        "the same samples occur again and again",
        "the error falls more slowly than it should with the number of samples",
        "where random numbers are seeded: once, and not for each batch or thread",
    ),
    Cause(
        "pixel of another convention",
        "the pixel (x, y) is not the one that the direction lies in",
        "nothing, as long as nobody uses the pixel",
        "where the pixel is written: x is the column, y the row from the top",
    ),
    Cause(
        "drawn by no known law",
        "the pixels are not drawn in proportion to I sin(theta), for no reason that is known here",
        "bias: some lamps are too bright",
        "where the CDFs are built and searched",
    ),
)


def read_samples(
    path: str | Path,
) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | None, np.ndarray | None, np.ndarray | None]:
    """The arguments of :func:`check_samples` after the map, from a CSV or NPZ file.

    See :mod:`lightdome.checking.tables`. Raises :class:`LightdomeError` for a file that cannot be read, or has
    no directions.
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
    """Compare samples of ``envmap`` with what they should be; all but ``direction`` may be left out.

    - ``direction``: (N, 3), towards the light
    - ``radiance``: (N, 3), of the chosen pixels
    - ``probability``: (N,), of the chosen pixels
    - ``pixel``: (N, 2), x and y
    - ``pdf``: (N,), density per steradian

    Raises :class:`LightdomeError` for arrays of other shapes, values that are not finite, and for a black map.
    """
    return Located(envmap, direction, radiance, probability, pixel, pdf).result(drawn=True)


class Located:
    """Directions with what belongs to them, and where in the map they lie."""

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
            raise LightdomeError("the map is black: nothing can be drawn from it, and there is nothing to check")
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
        """By the radiance; without it by the density, by the pixels, or by where most directions point."""
        if self.radiance is not None:
            return find_fit(self.map, self.direction, self.radiance)
        if self.pdf is not None:
            area = solid_angles(self.height, self.width)[:, None]
            return find_fit((self.p / area)[..., None], self.direction, self.pdf[:, None])
        return Fit(likeliest(luminance(self.map), self.direction), fitting=1.0)

    def _add(self, name: str, more: str = "") -> None:
        if all(cause.name != name for cause, _ in self.found):  # probabilities and densities may have the same mistake
            self.found.append((cause_named(name, CAUSES_OF_SAMPLES), more))

    def result(self, drawn: bool) -> TableCheck:
        """The verdict; ``drawn`` says that the directions were drawn in proportion to the light."""
        if self.off_unit > UNIT:
            self._add("directions not normalised", f"one is off by {self.off_unit:.2g}")
        orientation = str(self.fit.turn)
        wrongly_turned = bool(orientation) and self.fit.turn.preset is None
        if self.geometry.name:
            self._add(self.geometry.name)
        self._compare_radiance()
        self.details["within"] = self.geometry.name or ("centre" if self.at_centres else "pixel")
        if not wrongly_turned:  # or the pixels are those of another map
            self._compare_pixels()
        mistaken = any(cause.name == "values of other pixels" for cause, _ in self.found)
        if not mistaken:
            self._compare_probabilities()
            if drawn:
                self._compare_drawing()
        if not self.found and not wrongly_turned:
            return TableCheck(True, self._agreement(drawn, orientation), None, orientation, self.details)
        cause = self.found[0][0] if self.found else None
        verdict = verdict_of(self.found, orientation if wrongly_turned else "")
        return TableCheck(False, verdict, cause, orientation, self.details)

    def _agreement(self, drawn: bool, orientation: str) -> str:
        what = [
            name for name in ("radiance", "probability", "pixel", "pdf") if getattr(self, name, None) is not None
        ] or ["direction"]
        said = f"agrees: {', '.join(what)} of all {self.count} samples"
        if drawn:
            off = self.details["chi_square_deviations"]
            said += (
                f", drawn as the light is ({off:.1f} standard deviations, up to {LIMIT:g} are chance)"
                if isinstance(off, float) and math.isfinite(off)
                else "; too few to say whether they are drawn as the light is"
            )
        return said + (f"; {orientation}" if orientation else "")

    def _compare_radiance(self) -> None:
        if self.radiance is None:
            return
        self.details["radiance_of_their_pixels_share"] = self.fit.fitting
        if not self.fit.fitting:
            self._add("values of other pixels")
            return
        pixels = self.map[self.y, self.x]
        factor = self.fit.factor
        seen = [("", _alike(self.radiance, pixels * factor))]
        seen += [("channels swapped", _alike(self.radiance[:, ::-1], pixels * factor))]
        seen += [(name, _alike(self.radiance, change(pixels))) for name, change in CHANGES.items()]
        name, same = max(seen, key=lambda pair: pair[1].mean())  # the first of those that fit alike
        self.details["radiance_of_their_pixels_share"] = float(same.mean())
        if same.mean() < 0.95:
            self._add("values of other pixels")
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
        # A program with a map that is turned counts its own pixels.
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
        """The mistake in the probabilities or densities, and a remark; "" for none."""
        p = self.p[self.y, self.x]
        per = {"probability": np.ones_like(area), "pdf": area}[what]
        other = {"probability": area, "pdf": np.ones_like(area)}[what]
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
        else:  # the density of pixels without sin(theta), over pixels of the right size, and the like
            named += [(name, q[self.y, self.x] / other) for name, q in laws(self.map)]
        exact = max(((agreeing(values, q), -n) for n, (_, q) in enumerate(named)))
        self.details[f"{what}_right_share"] = agreeing(values, named[0][1])
        if exact[0] > 0.95:
            return named[-exact[1]][0], ""
        # Proportional to one of them? Those with only few different values prove nothing.
        free = []
        for n, (_, q) in enumerate(named):
            lit = (q > 0) & (values > 0)
            if lit.mean() > 0.5:
                factor = float(np.exp(np.median(np.log(values[lit]) - np.log(q[lit]))))
                free.append((agreeing(values, q * factor), -n, factor))
        share, n, factor = max(free, default=(0.0, 0, 1.0))
        if share > 0.95:
            name = named[-n][0]
            more = f"{what} {factor:.5g} times too large"
            more += factor_named(self.map, factor, self.count) if not name else ""
            return name or "not normalised", more
        rough = np.abs(np.log(np.maximum(values, 1e-300) / np.maximum(p / per, 1e-300)))
        if np.median(rough) < 0.02:  # as differences of single-precision CDFs are
            self.details[f"{what}_largest_relative_error"] = float(np.expm1(rough.max()))
            return "", ""
        return "not normalised", f"the {what} is that of no law that is known here"

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
        if self.found:  # a mistake that is told already may have this effect
            return
        # As likely as can be, but for a hundredth that may come from anywhere.
        floor = 0.01 / self.p.size
        logs = [("", (drawn * np.log(self.p * 0.99 + floor)).sum())]
        candidates = [("", self.p), *laws(self.map)]
        logs += [(name, (drawn * np.log(q * 0.99 + floor)).sum()) for name, q in candidates[1:]]
        best = max(range(len(logs)), key=lambda n: logs[n][1])
        name, law = candidates[best]
        worst = max(off.values(), default=0.0)
        if name and logs[best][1] > logs[0][1] + 8:
            under = max(deviations(law, drawn).values(), default=0.0)
            if under < max(LIMIT, 0.25 * worst):
                self._add(name, f"the pixels are drawn so, {worst:.0f} standard deviations from right")
                return
        if black:
            self._add("zero-weight pixels drawn", f"{black} samples")
        elif distinct:
            self._add("samples repeated", distinct)
        else:
            self._add("drawn by no known law", f"{worst:.0f} standard deviations")

    def _repeated(self, drawn: np.ndarray) -> str:
        """A remark if samples occur too often, else ""."""
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
    """Why probabilities may be so many times too large, ": " and a remark, or ""."""
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
    """Which rows are the same but for printed digits."""
    return np.abs(values - expected).max(axis=1) <= 2e-3 * np.abs(expected).max(axis=1)


def agreeing(values: np.ndarray, expected: np.ndarray) -> float:
    """The share of ``values`` that are the ``expected`` ones but for rounding."""
    return float((np.abs(values - expected) <= CLOSE * expected).mean())


def deviations(p: np.ndarray, drawn: np.ndarray) -> dict[str, float]:
    """Of rows, columns, brightness and cells: by how many standard deviations chi-square is too large.

    ``p`` (H, W) are the probabilities, ``drawn`` how often each pixel was. What has fewer than two bins is left out.
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
    """Standard deviations that a normal number would be off to be as unlikely; neighbours make bins large enough."""
    sums = np.cumsum(expected)
    label = np.minimum((sums - expected / 2) // LEAST, max(0, sums[-1] // LEAST - 1)).astype(int)
    _, label = np.unique(label, return_inverse=True)
    expected, seen = np.bincount(label, expected), np.bincount(label, seen)
    order = np.argsort(
        expected
    )  # beside a pixel that has many bins' share there are small ones, which are put together
    small = int(np.searchsorted(np.cumsum(expected[order]), LEAST)) + 1
    if small > 1:
        label = np.maximum(np.argsort(order) - small + 1, 0)
        expected, seen = np.bincount(label, expected), np.bincount(label, seen)
    freedom = len(expected) - 1
    if freedom < 1 or expected.min() < LEAST / 2:
        return math.nan
    share = float(((seen - expected) ** 2 / expected).sum()) / freedom
    return (share ** (1 / 3) - (1 - 2 / (9 * freedom))) / math.sqrt(2 / (9 * freedom))
