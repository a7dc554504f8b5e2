"""How a sampler copes with cases that break samplers: what is measured, and the goals.

The device's probabilities, sums, CDFs, draws and images, in float32, are compared with their definitions in float64.
:mod:`lightdome.evaluation.stability_cases` has the cases, :mod:`lightdome.evaluation.stability_plot` the plot, and
:mod:`lightdome.evaluation.peer_mitsuba_distribution` Mitsuba's results on the same maps.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Protocol

import numpy as np

from .. import reference
from ..checks import made
from ..disc import disc_mask
from ..errors import LightdomeError
from ..files import write_json, write_table
from ..float_range import LARGEST
from ..lighting.exact import exact
from ..lighting.shade import shade_samples
from ..maps.envmap import EnvironmentMap
from ..maps.geometry import directions
from ..opencl import memory
from ..opencl.device import Device
from ..sampling.cdf import MapCDF
from ..sampling.distribution import Distribution, build_distribution
from ..sampling.draw import drawn, given_points
from ..sampling.samples import Samples
from ..sampling.strips import strip_borders, strip_table

NORMAL = 2.0**-126  # float32's smallest normal number, below which digits are lost
QUANTUM = 2.0**-149  # float32's smallest positive number
BLOCK = 2**20  # pixels, or samples, at a time
SHADED = 256  # samples in the shaded image


@dataclass(frozen=True)
class Column:
    """A figure of the table; it holds if it is at most ``goal``."""

    goal: float
    meaning: str


COLUMNS = {
    "p": Column(2e-6, "largest relative error of p(x, y), over all pixels with p >= 2^-126"),
    "tiny": Column(1, "largest error of the smaller p, in units of 2^-149, float32's smallest number"),
    "sum": Column(1e-6, "|sum of p - 1|"),
    "zero": Column(0, "pixels of weight zero that were drawn"),
    "cdf": Column(0, "steps of a CDF that go down, or up at a pixel of weight zero"),
    "drawn": Column(1, "total variation between the CDFs' probabilities and p, over its bound (W + H) 2^-31 + 5e-7"),
    "chi2": Column(5, "|chi-square of the draws against p|, in standard deviations"),
    "flux": Column(1e-6, "relative error of the total flux"),
    "image": Column(1e-5, "largest error of the shaded image beyond 2^-149, over its maximum, front and back"),
    "wrong": Column(0, "results that differ from their exact value"),
    "fresnel": Column(3e-15, "relative error of R, for an angle within two units in its last place"),
    "nonfinite": Column(0, "values that are NaN or infinite"),
}
# Not judged: what float32, or 32 bits of a CDF, cannot represent, and how much of it there is.
LIMITS = {
    "subnormal": "lit pixels with p < 2^-126",
    "undrawn": "lit pixels below the CDFs' steps, never drawn",
    "undrawn_flux": "their share of the flux",
}

Figures = dict[str, float]  # by names from COLUMNS and LIMITS


@dataclass(frozen=True)
class Case:
    """``check(device, draws)`` yields the figures of the parts of a case, of which the worst count.

    If the parts are maps, ``maps`` lets any sampler be tested on them. A ``large`` case takes many seconds, and
    gigabytes. ``needs`` is the size in bytes of the largest array on the device.
    """

    name: str
    group: str
    check: Callable[[Device, int], Iterable[Figures]]
    maps: Callable[[], Sequence[np.ndarray]] | None = None
    large: bool = False
    needs: int = 0


@dataclass(frozen=True)
class Result:
    """The figures of one program on one case, or why there are none."""

    program: str
    group: str
    case: str
    figures: Figures = field(default_factory=dict)
    skipped: str = ""
    judged: bool = True

    @property
    def failures(self) -> list[str]:
        """The columns that miss their goal; a NaN misses any."""
        return [name for name, value in self.figures.items() if name in COLUMNS and not value <= COLUMNS[name].goal]

    @property
    def verdict(self) -> str:
        """``holds``, ``FAILS`` or ``skipped``; for a peer, which is not judged, ``measured``."""
        if self.skipped:
            return "skipped"
        return "measured" if not self.judged else "FAILS" if self.failures else "holds"

    @property
    def remark(self) -> str:
        """Which goals are missed; and where a goal cannot hold, why, and what holds instead."""
        remarks = [self.skipped] if self.skipped else []
        if self.failures:
            remarks.append("off: " + ", ".join(f"{name} {self.figures[name]:.2g}" for name in self.failures))
        if self.figures.get("subnormal") and "tiny" not in self.failures:
            remarks.append(f"up to {self.figures['subnormal']:.0f} pixels with p < 2^-126 are exact only to 2^-149")
        if self.figures.get("undrawn"):
            remarks.append(
                f"up to {self.figures['undrawn']:.0f} lit pixels, {self.figures['undrawn_flux']:.1g} of the flux,"
                " are below the CDFs' steps and never drawn"
            )
        return "; ".join(remarks)


class Sampler(Protocol):
    """A sampler to measure on a map: lightdome's or another program's."""

    flux: float

    def probability(self, rows: slice) -> np.ndarray:
        """p(x, y) of whole rows, (n, W)."""

    def draw(self, count: int, seed: int) -> Samples:
        """``count`` samples, which depend on ``seed``."""

    def image(self, samples: Samples, resolution: int) -> np.ndarray:
        """The sphere lit by the samples."""


class Lightdome:
    """The device's sampler. For ``probability``, the sampling kernel visits all pixels, even those never drawn."""

    def __init__(self, distribution: Distribution) -> None:
        self.distribution = distribution
        self.flux = distribution.flux
        device, height, width = distribution.device, distribution.envmap.height, distribution.envmap.width
        # CDFs of equal steps, so that the point ((x + 1/2) / W, (y + 1/2) / H) picks the pixel (x, y).
        widths = np.diff(strip_borders(width))
        rows = np.tile(np.concatenate([np.arange(1, n + 1) for n in widths]), (height, 1))
        marginal = np.tile(np.arange(1, height + 1), (len(widths), 1))
        self._even = MapCDF(
            device,
            memory.upload(device, rows.astype(np.uint32)),
            memory.upload(device, marginal.astype(np.uint32)),
            memory.upload(device, strip_table(widths.astype(np.float64))),
            distribution.total,
        )

    def probability(self, rows: slice) -> np.ndarray:
        envmap = self.distribution.envmap
        y, x = np.mgrid[rows, 0 : envmap.width]
        points = np.stack([(x + 0.5) / envmap.width, (y + 0.5) / envmap.height], axis=-1)
        given = given_points(self.distribution.device, points.reshape(-1, 2))
        return drawn(self.distribution.map, self._even, given)["probability"].reshape(y.shape)

    def draw(self, count: int, seed: int) -> Samples:
        return self.distribution.sample(count, seed)

    def image(self, samples: Samples, resolution: int) -> np.ndarray:
        return shade_samples(self.distribution.device, samples, resolution)


class Truth:
    """A map's p and flux by definition, in float64, a block of rows at a time so that large maps fit in memory.

    Each row is summed pairwise, and the rows' sums without error (``math.fsum``), which leaves an error of 1e-14.
    """

    def __init__(self, radiance: np.ndarray) -> None:
        self.radiance = radiance
        self.height, self.width = radiance.shape[:2]
        self.resolution = 33 if self.height * self.width <= 2**14 else 9  # of images, small because float64 is slow
        self.sine = np.sin(np.pi / self.height * (np.arange(self.height) + 0.5))
        edge = np.cos(np.pi / self.height * np.arange(self.height + 1))
        self.solid_angle = (edge[:-1] - edge[1:]) * 2 * np.pi / self.width
        rows = radiance.sum(axis=(1, 2), dtype=np.float64)
        self.total = math.fsum(rows * self.sine)
        self.flux = math.fsum(rows / 3 * self.solid_angle)

    def blocks(self) -> Iterator[slice]:
        """All rows, in slices of about a million pixels."""
        step = max(1, BLOCK // self.width)
        return (slice(y, min(y + step, self.height)) for y in range(0, self.height, step))

    def probability(self, rows: slice) -> np.ndarray:
        """p(x, y) of whole rows, (n, W)."""
        return self.radiance[rows].sum(axis=2, dtype=np.float64) * (self.sine[rows] / self.total)[:, None]

    def probability_of(self, samples: Samples) -> np.ndarray:
        """p(x, y) of the samples' pixels, (N,)."""
        x, y = samples.pixel.T
        return self.radiance[y, x].sum(axis=1, dtype=np.float64) * (self.sine[y] / self.total)

    def image(self, samples: Samples, normals: np.ndarray) -> np.ndarray:
        """Radiance (M, 3) at ``normals`` (M, 3) from the samples' pixels, with their true densities."""
        x, y = samples.pixel.T
        theta, phi = np.pi / self.height * (y + 0.5), 2 * np.pi / self.width * (x + 0.5)
        density = self.probability_of(samples) / self.solid_angle[y]
        return reference.shade(normals, directions(theta, phi), self.radiance[y, x].astype(np.float64), density)


def measure_sampler(sampler: Sampler, truth: Truth, draws: int) -> Figures:
    """The figures that apply to any sampler.

    They are ``p``, ``tiny``, ``sum``, ``zero``, ``chi2``, ``flux``, ``nonfinite``, and ``image`` for a few samples.
    """
    height, width = truth.height, truth.width
    pixels_a_bin = -(-height * width // BLOCK)
    bins = -(-height * width // pixels_a_bin)
    expected, seen = np.zeros(bins), np.zeros(bins, np.int64)
    figures = dict.fromkeys(("p", "tiny", "sum", "zero", "nonfinite", "subnormal"), 0.0)

    def compare(p: np.ndarray, exact: np.ndarray) -> None:
        normal = exact >= NORMAL
        with np.errstate(all="ignore"):
            _worst(figures, {"p": np.abs(p[normal] / exact[normal] - 1).max(initial=0)})
            _worst(figures, {"tiny": np.abs(p[~normal] - exact[~normal]).max(initial=0) / QUANTUM})
        figures["nonfinite"] += np.count_nonzero(~np.isfinite(p))

    sums = []
    for rows in truth.blocks():
        p, exact_p = sampler.probability(rows).astype(np.float64), truth.probability(rows)
        compare(p, exact_p)
        sums.append(p.sum())
        figures["subnormal"] += np.count_nonzero((exact_p > 0) & (exact_p < NORMAL))
        index = np.arange(rows.start * width, rows.stop * width) // pixels_a_bin
        expected += np.bincount(index, exact_p.ravel(), bins)
    with np.errstate(all="ignore"):
        figures["sum"] = abs(float(np.sum(sums)) - 1)

    for seed, begin in enumerate(range(0, draws, BLOCK)):
        samples = sampler.draw(min(BLOCK, draws - begin), seed)
        compare(samples.probability.astype(np.float64), truth.probability_of(samples))
        figures["zero"] += np.count_nonzero(~samples.radiance.any(axis=1))
        index = samples.pixel[:, 1].astype(np.int64) * width + samples.pixel[:, 0]
        seen += np.bincount(index // pixels_a_bin, minlength=bins)
        if begin == 0:
            first = {n: getattr(samples, n)[:SHADED] for n in ("direction", "radiance", "probability", "pixel")}
            few = made(Samples, **{**vars(samples), **first})
    if (z := chi_square_z(seen, expected)) is not None:
        figures["chi2"] = abs(z)
    figures["flux"] = abs(sampler.flux / truth.flux - 1)
    with np.errstate(all="ignore"):
        image = sampler.image(few, truth.resolution)
        _add(figures, image_figures(image, lambda normals: truth.image(few, normals)))
    return figures


def measure_map(device: Device, radiance: np.ndarray, draws: int) -> Figures:
    """All figures of lightdome on one map."""
    truth = Truth(radiance)
    envmap = EnvironmentMap(radiance)
    distribution = build_distribution(device, envmap)
    figures = measure_sampler(Lightdome(distribution), truth, draws)
    _add(figures, cdf_figures(distribution, truth))
    if truth.height * truth.width <= 2**23:
        image = exact(device, distribution.map, truth.resolution)
        _add(figures, image_figures(image, lambda normals: reference.exact(radiance, normals)))
    return figures


def cdf_figures(distribution: Distribution, truth: Truth) -> Figures:
    """``cdf``, ``drawn`` and what is never drawn: properties of the CDFs, over all possible points."""
    device = distribution.device
    rows_cdf = memory.download(device, distribution.cdf.rows)
    marginal = memory.download(device, distribution.cdf.marginal).astype(np.int64)
    steps_y = np.diff(marginal, prepend=0, axis=1)
    share = np.zeros(len(marginal))  # of each strip
    table = memory.download(device, distribution.cdf.strips).astype(np.int64)
    np.add.at(share, table[:, 3], np.diff(table[:, 0], append=2**32) / 2**32)
    figures = {"cdf": float(np.count_nonzero(steps_y < 0)), "undrawn": 0.0, "undrawn_flux": 0.0}
    variation = 0.0
    for rows in truth.blocks():
        p_of_rows = truth.probability(rows)
        for strip, (begin, end) in enumerate(pairwise(strip_borders(truth.width))):
            cdf, p = rows_cdf[rows, begin:end].astype(np.int64), p_of_rows[:, begin:end]
            steps = np.diff(cdf, prepend=0, axis=1)
            p_row = share[strip] * steps_y[strip, rows] / max(marginal[strip, -1], 1)
            drawn = p_row[:, None] * (steps / np.maximum(cdf[:, -1:], 1))
            figures["cdf"] += np.count_nonzero((steps < 0) | ((steps > 0) & (p == 0)))
            figures["cdf"] += np.count_nonzero(p_row[~p.any(axis=1)])
            variation += np.abs(drawn - p).sum() / 2
            never = (p > 0) & (drawn == 0)
            figures["undrawn"] += np.count_nonzero(never)
            figures["undrawn_flux"] += p[never].sum()
    figures["drawn"] = variation / ((truth.width + truth.height) * 2.0**-31 + 5e-7)
    return figures


def image_figures(image: np.ndarray, expected: Callable[[np.ndarray], np.ndarray]) -> Figures:
    """``image``, ``wrong`` (pixels outside the disc that are not 0) and ``nonfinite`` for an image (R, R, 3).

    ``expected(normals)`` is the truth, (M, 3). Errors are relative to its maximum over the whole sphere, including the
    side that the camera does not see; otherwise, light from behind would be compared with a sliver at the rim. Where
    the truth exceeds float32's largest number, the image must have that number.
    """
    mask = disc_mask(len(image))
    normals = reference.normals(len(image))[mask]
    front, back = (np.minimum(expected(normals * (1, 1, side)), LARGEST) for side in (1, -1))
    error = np.maximum(np.abs(image[mask].astype(np.float64) - front).max() - QUANTUM, 0)
    largest = max(front.max(), back.max())
    return {
        "image": float(error / largest) if largest > 0 else float(error > 0),
        "wrong": float(np.count_nonzero(image[~mask])),
        "nonfinite": float(np.count_nonzero(~np.isfinite(image))),
    }


def chi_square_z(counts: np.ndarray, p: np.ndarray) -> float | None:
    """How many standard deviations chi-square is off (Wilson and Hilferty 1931); None if there is only one bin.

    Rare bins are pooled until each pool expects 10. Infinite if anything impossible was counted.
    """
    n = counts.sum()
    order = np.argsort(p, axis=None)
    expected, seen = n * p.ravel()[order], counts.ravel()[order]
    pool = np.floor(np.cumsum(expected) / 10).astype(np.int64)
    pool = np.unique(pool, return_inverse=True)[1]
    expected, seen = np.bincount(pool, expected), np.bincount(pool, seen)
    keep = expected > 0
    if seen[~keep].any():
        return math.inf
    k = np.count_nonzero(keep) - 1
    if k == 0:
        return None
    chi2 = ((seen - expected)[keep] ** 2 / expected[keep]).sum()
    return float(((chi2 / k) ** (1 / 3) - (1 - 2 / (9 * k))) / np.sqrt(2 / (9 * k)))


def _worst(figures: Figures, more: Figures) -> None:
    """Keep the larger of each figure; NaN counts as largest."""
    for name, value in more.items():
        figures[name] = float(np.maximum(figures.get(name, 0.0), value))


def _add(figures: Figures, more: Figures) -> None:
    """As :func:`_worst`, except that counts of NaN and infinite values add up."""
    nonfinite = figures.get("nonfinite", 0.0) + more.get("nonfinite", 0.0)
    _worst(figures, more)
    figures["nonfinite"] = nonfinite


def run(case: Case, device: Device, draws: int) -> Result:
    """lightdome's figures on ``case``, with ``draws`` samples divided among its parts."""
    # The host holds the map, two CDFs, and if it is also the device, all of the device's arrays.
    for where, room in (("device", device.handle.max_mem_alloc_size), ("host", _host_memory() / 3)):
        if case.needs > room:
            reason = (
                f"needs arrays of {case.needs / 2**30:.2g} GiB, but the {where} has room for {room / 2**30:.2g} GiB"
            )
            return Result("lightdome", case.group, case.name, skipped=reason)
    figures: Figures = {}
    for part in case.check(device, draws):
        _worst(figures, part)
    return Result("lightdome", case.group, case.name, figures)


def _host_memory() -> float:
    """Bytes of memory, if the system tells."""
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") if hasattr(os, "sysconf") else math.inf


def run_peer(case: Case, name: str, sampler: Callable[[np.ndarray], Sampler], draws: int) -> Result:
    """A peer's figures on a case that has maps; its failures are reported, not judged."""
    figures: Figures = {}
    parts = case.maps() if case.maps else []
    try:
        for radiance in parts:
            _worst(figures, measure_sampler(sampler(radiance), Truth(radiance), -(-draws // len(parts))))
    except LightdomeError as error:
        return Result(name, case.group, case.name, skipped=str(error), judged=False)
    figures.pop("wrong", None)  # pixels outside the disc do not come from the peer
    return Result(name, case.group, case.name, figures, judged=False)


def write_stability_csv(path: Path, results: Sequence[Result]) -> None:
    """A row per program and case; blank where a figure does not apply."""
    names = [*COLUMNS, *LIMITS]
    rows = (
        [r.program, r.group, r.case, r.verdict, *(r.figures.get(name) for name in names), r.remark] for r in results
    )
    write_table(path, ["program", "group", "case", "verdict", *names, "remark"], rows)


def write_stability_json(path: Path, results: Sequence[Result], settings: Mapping[str, object]) -> None:
    """The settings, the columns with their goals, and all results; NaN and infinity become text."""
    columns = {name: asdict(column) for name, column in COLUMNS.items()}
    cases = [
        {
            "program": r.program,
            "group": r.group,
            "case": r.case,
            "verdict": r.verdict,
            "figures": {n: v if math.isfinite(v) else str(v) for n, v in r.figures.items()},
            "remark": r.remark,
        }
        for r in results
    ]
    write_json(path, {**settings, "columns": columns, "limits": LIMITS, "cases": cases})


def text(value: float | None) -> str:
    """A figure in a few characters: ``2e-7``, ``0.02``, ``1.7``, ``NaN``; blank for None."""
    if value is None:
        return ""
    if not math.isfinite(value):
        return "NaN" if math.isnan(value) else "inf"
    if value == 0 or 0.01 <= value < 100:
        return f"{value:.2g}"
    if 100 <= value < 1000:
        return f"{value:.0f}"
    mantissa, exponent = f"{value:.0e}".split("e")
    return f"{mantissa}e{int(exponent)}"
