"""How a sampler stands cases that break samplers: what is measured, and what is asked of it.

Probabilities, sums, CDFs, draws and images of the device, in float32, are compared with the definitions in
float64. :mod:`lightdome.evaluation.stability_cases` has the cases,
:mod:`lightdome.evaluation.stability_plot` the picture,
:mod:`lightdome.evaluation.peer_mitsuba_distribution` Mitsuba's answer to the same maps.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
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

NORMAL = 2.0**-126  # float32's smallest normal number: below it digits go
QUANTUM = 2.0**-149  # and its smallest number
BLOCK = 2**20  # pixels, or samples, at a time
SHADED = 256  # samples of the shaded image


@dataclass(frozen=True)
class Column:
    """A figure of the table: it holds where it is at most ``goal``."""

    goal: float
    meaning: str


COLUMNS = {
    "p": Column(2e-6, "largest relative error of p(x, y), of all pixels where p >= 2^-126"),
    "tiny": Column(1, "largest error of the smaller p, in units of 2^-149, float32's smallest number"),
    "sum": Column(1e-6, "|sum of p - 1|"),
    "zero": Column(0, "draws of pixels of weight zero"),
    "cdf": Column(0, "steps of a CDF that go down, or up at a pixel of weight zero"),
    "drawn": Column(1, "total variation between what the CDFs draw and p, over its bound (W + H) 2^-31 + 5e-7"),
    "chi2": Column(5, "|chi-square of the draws against p|, in standard deviations"),
    "flux": Column(1e-6, "relative error of the total flux"),
    "image": Column(1e-5, "largest error of the shaded image, above 2^-149, over its maximum, front and back"),
    "wrong": Column(0, "results that have an exact value and miss it"),
    "fresnel": Column(3e-15, "relative error of R, for an angle within two units in its last place"),
    "nonfinite": Column(0, "values that are NaN or infinite"),
}
# Not judged: what cannot be had in float32, or in 32 bits of a CDF, and how much it is.
LIMITS = {
    "subnormal": "lit pixels with p < 2^-126",
    "undrawn": "lit pixels below the CDFs' steps, never drawn",
    "undrawn_flux": "their part of the flux",
}

Figures = dict[str, float]  # by the names in COLUMNS and LIMITS


@dataclass(frozen=True)
class Case:
    """``check(device, draws)`` yields the figures of the parts of a case; the worst of each counts.

    ``maps`` is there where the parts are maps that any sampler can be asked about. A ``large`` case takes many
    seconds, and gigabytes. ``needs`` is the size in bytes of the largest array on the device.
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
        """``holds``, ``FAILS``, ``skipped``; of a peer, which is not judged, ``measured``."""
        if self.skipped:
            return "skipped"
        return "measured" if not self.judged else "FAILS" if self.failures else "holds"

    @property
    def remark(self) -> str:
        """What misses a goal; where none can hold, why, and what holds instead."""
        remarks = [self.skipped] if self.skipped else []
        if self.failures:
            remarks.append("off: " + ", ".join(f"{name} {self.figures[name]:.2g}" for name in self.failures))
        if self.figures.get("subnormal") and "tiny" not in self.failures:
            remarks.append(f"up to {self.figures['subnormal']:.0f} pixels with p < 2^-126 are exact to 2^-149 instead")
        if self.figures.get("undrawn"):
            remarks.append(
                f"up to {self.figures['undrawn']:.0f} lit pixels, {self.figures['undrawn_flux']:.1g} of the flux,"
                " are below the CDFs' steps and never drawn"
            )
        return "; ".join(remarks)


class Sampler(Protocol):
    """What is measured on a map: lightdome or another program."""

    flux: float

    def probability(self, rows: slice) -> np.ndarray:
        """p(x, y) of whole rows, (n, W)."""

    def draw(self, count: int, seed: int) -> Samples:
        """``count`` samples; another ``seed``, others."""

    def image(self, samples: Samples, resolution: int) -> np.ndarray:
        """The sphere in the light of the samples."""


class Lightdome:
    """The device's answers. ``probability`` has the sampling kernel visit all pixels, also those never drawn."""

    def __init__(self, distribution: Distribution) -> None:
        self.distribution = distribution
        self.flux = distribution.flux
        device, height, width = distribution.device, distribution.envmap.height, distribution.envmap.width
        # CDFs of equal steps: the point ((x + 1/2) / W, (y + 1/2) / H) picks the pixel (x, y).
        steps = [np.arange(1, n + 1, dtype=np.uint32) for n in (width, height)]
        rows = memory.upload(device, np.tile(steps[0], (height, 1)))
        self._even = MapCDF(device, rows, memory.upload(device, steps[1]), distribution.total)

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
    """A map's p and flux by their definitions, in float64, a block of rows at a time so that large maps fit.

    Rows are summed pairwise, and their sums without error (``math.fsum``): 1e-14 is left.
    """

    def __init__(self, radiance: np.ndarray) -> None:
        self.radiance = radiance
        self.height, self.width = radiance.shape[:2]
        self.resolution = 33 if self.height * self.width <= 2**14 else 9  # of images, which are slow in float64
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
        """What the samples' pixels contribute to ``normals`` (M, 3) at their true densities, (M, 3)."""
        x, y = samples.pixel.T
        theta, phi = np.pi / self.height * (y + 0.5), 2 * np.pi / self.width * (x + 0.5)
        density = self.probability_of(samples) / self.solid_angle[y]
        return reference.shade(normals, directions(theta, phi), self.radiance[y, x].astype(np.float64), density)


def measure_sampler(sampler: Sampler, truth: Truth, draws: int) -> Figures:
    """The figures of ``sampler`` that any sampler has: ``p``, ``tiny``, ``sum``, ``zero``, ``chi2``, ``flux``,
    ``image`` of a few of its samples, ``nonfinite``."""
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
    """``cdf``, ``drawn`` and what is never drawn: what the CDFs make of the map, all points taken together."""
    device = distribution.device
    rows_cdf = memory.download(device, distribution.cdf.rows)
    marginal = memory.download(device, distribution.cdf.marginal).astype(np.int64)
    steps_y = np.diff(marginal, prepend=0)
    figures = {"cdf": float(np.count_nonzero(steps_y < 0)), "undrawn": 0.0, "undrawn_flux": 0.0}
    variation = 0.0
    for rows in truth.blocks():
        steps = np.diff(rows_cdf[rows].astype(np.int64), prepend=0, axis=1)
        p = truth.probability(rows)
        drawn = (steps_y[rows] / marginal[-1])[:, None] * (steps / np.maximum(rows_cdf[rows, -1:], 1))
        figures["cdf"] += np.count_nonzero((steps < 0) | ((steps > 0) & (p == 0)))
        figures["cdf"] += np.count_nonzero(steps_y[rows][~p.any(axis=1)])
        variation += np.abs(drawn - p).sum() / 2
        never = (p > 0) & (drawn == 0)
        figures["undrawn"] += np.count_nonzero(never)
        figures["undrawn_flux"] += p[never].sum()
    figures["drawn"] = variation / ((truth.width + truth.height) * 2.0**-31 + 5e-7)
    return figures


def image_figures(image: np.ndarray, expected: Callable[[np.ndarray], np.ndarray]) -> Figures:
    """``image``, ``wrong`` (pixels outside the disc that are not 0) and ``nonfinite`` of an image (R, R, 3).

    ``expected(normals)`` is the truth, (M, 3). Errors are relative to its maximum over the whole sphere, the side
    that the camera does not see included, lest light from behind be compared with a sliver at the rim; what
    exceeds float32's largest number has to be that number.
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
    """How many standard deviations chi-square is off (Wilson and Hilferty 1931); None with one bin only.

    Rare bins are pooled until each pool expects 10; infinite if anything impossible was counted.
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
    """Keep the larger of each figure; a NaN is larger than anything."""
    for name, value in more.items():
        figures[name] = float(np.maximum(figures.get(name, 0.0), value))


def _add(figures: Figures, more: Figures) -> None:
    """The same, but numbers of NaN and infinite values add up."""
    nonfinite = figures.get("nonfinite", 0.0) + more.get("nonfinite", 0.0)
    _worst(figures, more)
    figures["nonfinite"] = nonfinite


def run(case: Case, device: Device, draws: int) -> Result:
    """lightdome's figures on ``case``, with ``draws`` samples shared out among its parts."""
    # The host keeps the map, two CDFs, and where it is the device too, all of the device's.
    for where, room in (("device", device.handle.max_mem_alloc_size), ("host", _host_memory() / 3)):
        if case.needs > room:
            reason = (
                f"needs arrays of {case.needs / 2**30:.2g} GiB, and the {where} has room for {room / 2**30:.2g} GiB"
            )
            return Result("lightdome", case.group, case.name, skipped=reason)
    figures: Figures = {}
    for part in case.check(device, draws):
        _worst(figures, part)
    return Result("lightdome", case.group, case.name, figures)


def _host_memory() -> float:
    """Bytes of memory, as far as the system says."""
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") if hasattr(os, "sysconf") else math.inf


def run_peer(case: Case, name: str, sampler: Callable[[np.ndarray], Sampler], draws: int) -> Result:
    """A peer's figures on a case that has maps; what it fails at is said, not judged."""
    figures: Figures = {}
    parts = case.maps() if case.maps else []
    try:
        for radiance in parts:
            _worst(figures, measure_sampler(sampler(radiance), Truth(radiance), -(-draws // len(parts))))
    except LightdomeError as error:
        return Result(name, case.group, case.name, skipped=str(error), judged=False)
    figures.pop("wrong", None)  # the pixels outside the disc are not the peer's doing
    return Result(name, case.group, case.name, figures, judged=False)


def write_stability_csv(path: Path, results: Sequence[Result]) -> None:
    """A row for each program and case; blank where a figure does not apply."""
    names = [*COLUMNS, *LIMITS]
    rows = (
        [r.program, r.group, r.case, r.verdict, *(r.figures.get(name) for name in names), r.remark] for r in results
    )
    write_table(path, ["program", "group", "case", "verdict", *names, "remark"], rows)


def write_stability_json(path: Path, results: Sequence[Result], settings: Mapping[str, object]) -> None:
    """The settings, the columns with their goals, and all results; a number that is none is a text."""
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
    """A figure in a few characters: ``2e-7``, ``0.02``, ``1.7``, ``NaN``; blank where there is none."""
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
