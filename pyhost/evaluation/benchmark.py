"""Error against run time: every method at every count, each against the exact image it converges to, in one run.

A method's time is the wall time from the map in the host's memory to the image in the host's memory, the median of
several runs after a warm-up. Programs are built beforehand, and their build time is recorded separately. The error is
measured over several seeds. :mod:`lightdome.evaluation.benchmark_plot` makes the plots.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np

from ..disc import disc_mask
from ..files import write_json, write_table
from ..lighting.exact import exact
from ..lighting.harmonics import project, shade_harmonics
from ..lighting.median_cut import median_cut
from ..lighting.shade import shade, shade_samples
from ..maps.envmap import EnvironmentMap
from ..names import ESTIMATORS, PIXEL_SEQUENCES, SEQUENCES
from ..names import per_pixel as per_pixel_name
from ..opencl.device import Device
from ..rendering.estimate import Spread
from ..rendering.per_pixel import render
from ..sampling.distribution import build_distribution
from .metrics import half_quartile_distance, relative_rmse

ORDERS = (1, 2, 4, 6, 8, 10, 12, 16, 18, 24, 32)  # odd orders above 1 add nothing to irradiance

Run = Callable[[int, int], np.ndarray]  # (count, seed) -> image


@dataclass(frozen=True)
class Method:
    """A way to compute the image.

    ``kind`` says what a count means: ``shared`` samples or lights for all pixels, samples ``per pixel``, or the
    ``order`` of an analytic method. A method that is not ``random`` needs only one seed. A method with its own
    ``counts`` is measured at those. ``pixels`` says which exact image it converges to, see :func:`lightdome.exact`. Its
    stages are timed on ``device``. A ``peer`` is another program, see :mod:`lightdome.evaluation.peers`; its ``clock``
    returns the seconds of each stage of its last run, which add up to its time.
    """

    name: str
    kind: str
    run: Run
    random: bool = True
    counts: tuple[int, ...] | None = None
    pixels: Literal["centres", "areas"] = "centres"
    device: Device | None = None
    peer: bool = False
    clock: Callable[[], dict[str, float]] | None = None


@dataclass(frozen=True)
class MethodMeasurement:
    """One method at one count. The RMSE is relative to the exact image's root mean square over the disc."""

    method: str
    kind: str
    count: int
    seeds: int
    rmse: float
    rmse_spread: float  # standard deviation over the seeds
    largest_error: float  # largest absolute error / exact image's maximum, mean over the seeds
    bias: float  # mean error over pixels and seeds / exact image's mean
    wall_seconds: float
    wall_spread: float  # half the distance between the quartiles
    first_seconds: float  # the first run, including the build of its programs
    pixels: str = "centres"  # how the exact image used for the errors treats the map's pixels
    peer: bool = False
    estimated: float | None = None  # the RMSE as the spread of independent pixels over the seeds tells it
    stages: dict[str, float] = field(
        default_factory=dict
    )  # seconds by stage of the median run, on the device or in the peer


def methods(device: Device, envmap: EnvironmentMap, resolution: int) -> dict[str, Method]:
    """All of lightdome's own methods, by name: :data:`lightdome.names.METHODS`."""

    def shared(sequence: str) -> Run:
        def run(count: int, seed: int) -> np.ndarray:
            samples = build_distribution(device, envmap).sample(count, seed, sequence)
            return shade_samples(device, samples, resolution)

        return run

    def per_pixel(estimator: str, sequence: str, compensation: bool = False) -> Run:
        def run(count: int, seed: int) -> np.ndarray:
            distribution = build_distribution(device, envmap)
            ((_, image),) = render(distribution, [count], resolution, 1.0, seed, estimator, sequence, compensation)
            return image

        return run

    def cut(count: int, seed: int) -> np.ndarray:
        lights = median_cut(build_distribution(device, envmap), count)
        return shade(device, lights, resolution=resolution)

    def harmonics(order: int, seed: int) -> np.ndarray:
        return shade_harmonics(device, project(device, envmap, order), resolution)

    def whole(pixels: Literal["centres", "areas"], count: int, seed: int) -> np.ndarray:
        return exact(device, envmap, resolution, pixels=pixels)

    result = [Method(sequence, "shared", shared(sequence), device=device) for sequence in SEQUENCES]
    result.append(Method("median-cut", "shared", cut, random=False, device=device))
    for estimator in ESTIMATORS:
        for sequence in PIXEL_SEQUENCES:
            name = per_pixel_name(estimator, sequence)
            run = per_pixel(estimator, sequence)
            result.append(Method(name, "per pixel", run, pixels=ESTIMATORS[estimator].pixels, device=device))
    run = per_pixel("mis", "sobol", True)
    result.append(Method("mis-compensated-sobol", "per pixel", run, pixels=ESTIMATORS["mis"].pixels, device=device))
    result.append(Method("harmonics", "order", harmonics, random=False, counts=ORDERS, device=device))
    whole_maps: tuple[tuple[str, Literal["centres", "areas"]], ...] = ("exact", "centres"), ("exact-areas", "areas")
    for name, pixels in whole_maps:
        run = partial(whole, pixels)
        result.append(Method(name, "order", run, random=False, counts=(1,), pixels=pixels, device=device))
    return {method.name: method for method in result}


def measure_method(method: Method, count: int, seeds: int, repeats: int, reference: np.ndarray) -> MethodMeasurement:
    """Run ``method`` at ``count``, over ``seeds`` seeds for its error and ``repeats`` times for its time.

    ``reference`` is the exact image that it converges to, according to ``method.pixels``.
    """
    mask = disc_mask(len(reference))
    truth = reference[mask].astype(np.float64)

    errors, largest, means = [], [], []
    spread = Spread(truth.shape)

    def judge(image: np.ndarray) -> None:  # and drop the image, so that many seeds need no more memory than one
        if method.kind == "per pixel":
            spread.add(image[mask])
        difference = image[mask] - truth
        errors.append(relative_rmse(image[mask], truth))
        largest.append(np.abs(difference).max())
        means.append(difference.mean())

    start = time.perf_counter()
    image = method.run(count, 0)
    first = time.perf_counter() - start
    judge(image)

    walls, stages = [], []
    for _ in range(repeats):
        if method.device:
            method.device.profile.clear()
        start = time.perf_counter()
        method.run(count, 0)
        wall = time.perf_counter() - start
        timed = method.clock() if method.clock else method.device.profile.seconds() if method.device else {}
        walls.append(sum(timed.values()) if method.clock else wall)
        stages.append(timed)
    median = statistics.median_low(walls)

    for seed in range(1, seeds if method.random else 1):
        judge(method.run(count, seed))
    return MethodMeasurement(
        method=method.name,
        kind=method.kind,
        count=count,
        seeds=len(errors),
        rmse=statistics.fmean(errors),
        rmse_spread=statistics.stdev(errors) if len(errors) > 1 else 0.0,
        largest_error=float(np.mean(largest) / truth.max()),
        bias=float(np.mean(means) / truth.mean()),
        wall_seconds=median,
        wall_spread=half_quartile_distance(walls),
        first_seconds=first,
        pixels=method.pixels,
        peer=method.peer,
        estimated=spread.of_one(),
        stages=stages[walls.index(median)],
    )


def write_method_csv(path: Path, points: Sequence[MethodMeasurement]) -> None:
    """A row per measurement and a column per figure; columns ``stage <name>`` are in seconds."""
    names = list(dict.fromkeys(stage for p in points for stage in p.stages))
    columns = [f.name for f in fields(MethodMeasurement) if f.name != "stages"]
    rows = ([*(getattr(p, c) for c in columns), *(p.stages.get(name) for name in names)] for p in points)
    write_table(path, [*columns, *(f"stage {name}" for name in names)], rows)


def write_method_json(path: Path, points: Sequence[MethodMeasurement], settings: Mapping[str, object]) -> None:
    """Write the settings and all measurements."""
    write_json(path, {**settings, "measurements": [asdict(p) for p in points]}, allow_nan=True)
