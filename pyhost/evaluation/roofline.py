"""Stages against the machine's own limits, measured in the same run.

A machine can move a certain number of bytes per second, and can multiply and add a certain number of float32 values per
second. Both are measured here by small kernels of our own (``copy.cl``, ``multiply_add.cl``; ``launch.cl`` does
nothing). A stage must move some bytes and perform some operations, so the machine cannot finish it before

    max(bytes / bandwidth, operations / multiply-adds per second)

The ratio of that time to the stage's own time tells how close it comes to the roof of Williams, Waterman, Patterson,
Roofline: An Insightful Visual Performance Model (2009). The bandwidth is that of a copy of as many bytes as the stage
moves, because small maps fit a cache and large ones do not. A stage that is little more than a copy is timed
alternately with that copy. See :mod:`lightdome.evaluation.roofline_stages` for what is counted, and
:mod:`lightdome.evaluation.roofline_plot` for the plots.
"""

from __future__ import annotations

import contextlib
import ctypes
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, astuple, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..files import write_json, write_table
from ..opencl import memory
from ..opencl.memory import DeviceArray
from .metrics import exponent, half_quartile_distance
from .roofline_stages import MADE, PAIR, Stage

if TYPE_CHECKING:
    from ..opencl.device import Device

COPY_BYTES = tuple(2**k for k in (21, 23, 25, 27, 29))  # read and written together, from cache sizes to main memory
COPY_BLOCK = 2048  # vectors of 4 floats that a CPU's work-item copies
COPY_UNIT = 16 * COPY_BLOCK  # bytes
CHAINS = 8  # vectors of 16 multiply-adds in flight in a CPU's work-item
ITEMS_PER_UNIT = 1024  # work-items of multiply_add.cl per compute unit
STEPS = 2**14  # the sums of the chains stay exact integers in float32
LIMIT_REPEATS = 9
LAUNCHES = 101
PATIENCE = 5.0  # seconds for the repeats of one stage; slower stages are repeated less often
TRANSFERS = ("upload", "download")
AXES = ("map", "resolution", "N")


@dataclass(frozen=True)
class Limits:
    """What the device can do at most.

    - ``copies``: bytes per second, read and written, by the number of bytes that a copy touches
    - ``multiply_adds``: float32 multiply-adds per second
    - ``launch_seconds``: wall time of an empty kernel, from the call until it is known to be done
    """

    copies: dict[int, float]
    multiply_adds: float
    launch_seconds: float

    def bandwidth(self, size: float) -> float:
        """Bytes per second of a copy that touches ``size`` bytes, interpolated between those measured."""
        return float(np.interp(np.log(max(size, 1.0)), np.log(list(self.copies)), list(self.copies.values())))

    def best(self, other: Limits) -> Limits:
        """The better of each limit, since other programs on the machine can only slow it down."""
        return Limits(
            {size: max(rate, other.copies[size]) for size, rate in self.copies.items()},
            max(self.multiply_adds, other.multiply_adds),
            min(self.launch_seconds, other.launch_seconds),
        )


@dataclass(frozen=True)
class Timing:
    """A stage's device time: median of several runs after a warm-up, and half the distance between the quartiles.

    Kernels that write freshly allocated memory, such as large results, also wait for the system to clear its pages.
    ``peak_bytes`` is the host memory that a run takes in addition to what was in use before, which is all of its memory
    on a device that shares the host's; None if the system does not report it. ``bandwidth`` is that of copies between
    the repeats, in bytes per second, for stages that have any.
    """

    stage: Stage
    seconds: float
    spread: float
    repeats: int
    peak_bytes: int | None
    bandwidth: float | None = None


@dataclass(frozen=True)
class StageMeasurement:
    """One stage at one size, compared with the limits."""

    stage: str
    map: str
    width: int | None
    height: int | None
    resolution: int | None
    N: int | None
    seconds: float
    spread: float
    repeats: int
    peak_bytes: int | None
    bytes: float
    operations: float
    counted: str  # "least", or "brute force" for the operations of a kernel that skips nothing
    bandwidth_share: float
    multiply_add_share: float
    bound: str
    bound_share: float
    rate: float
    unit: str
    brute_force_ratio: float | None  # how many times faster than the multiply-add rate allows a brute-force kernel

    @property
    def map_pixels(self) -> int | None:
        """Pixels of the map, or None for a stage without a map."""
        return self.width * self.height if self.width and self.height else None


def measure_limits(device: Device, copy_bytes: Sequence[int] = COPY_BYTES) -> Limits:
    """Measure the limits of ``device``: medians after a warm-up. Takes a few seconds."""
    copies = {size: size / copy(device, size // 2)[1] for size in copy_bytes}
    result, seconds = multiply_add(device, STEPS)
    return Limits(copies, result.size * _chains(device) * STEPS / seconds, launch(device))


def copy(device: Device, size: int) -> tuple[np.ndarray, float]:
    """Copy ``size`` bytes, a multiple of COPY_UNIT; returns the copy, float32, and the median seconds."""
    run, target = _copies(device, size)
    seconds = _warm_median(run)
    return memory.download(device, target), seconds


def _copies(device: Device, size: int) -> tuple[Callable[[], float], DeviceArray]:
    """A function that copies ``size`` bytes and returns the seconds, and the array that it copies to."""
    block = 1 if device.is_gpu else COPY_BLOCK
    source, target = (memory.full(device, size // 4, value, np.float32) for value in (1.5, 0.0))  # touches all pages
    arrays = {"from": source, "to": target}

    def run() -> float:
        return _seconds(device, "limits/copy", (size // (16 * block),), {"VECTORS": block}, **arrays)

    return run, target


def multiply_add(device: Device, steps: int) -> tuple[np.ndarray, float]:
    """Count to ``steps`` in many chains; returns the lanes' sums, (items, 16) float32, and the median seconds."""
    result = memory.empty(device, (device.handle.max_compute_units * ITEMS_PER_UNIT, 16), np.float32)
    arguments = {"factor": 1, "term": 1, "steps": steps, "result": result}
    chains = {"CHAINS": _chains(device)}
    seconds = _warm_median(lambda: _seconds(device, "limits/multiply_add", result.shape[:1], chains, **arguments))
    return memory.download(device, result), seconds


def launch(device: Device) -> float:
    """Median wall seconds of an empty kernel, from the call until it is known to be done."""
    device.launch("limits/launch", (1,))  # builds it
    walls = []
    for _ in range(LAUNCHES):
        start = time.perf_counter()
        device.launch("limits/launch", (1,))
        device.wait()
        walls.append(time.perf_counter() - start)
    return statistics.median(walls)


def _chains(device: Device) -> int:
    return 1 if device.is_gpu else CHAINS


def _warm_median(run: Callable[[], float]) -> float:
    """The median of the seconds that ``run`` returns, after a warm-up."""
    run()
    return statistics.median(run() for _ in range(LIMIT_REPEATS))


def _seconds(device: Device, name: str, size: tuple[int, ...], defines: dict[str, int], **arguments: Any) -> float:
    """Run one kernel alone; returns its seconds on the device."""
    device.profile.clear()
    device.launch(name, size, stage="limit", defines=defines, **arguments)
    return device.profile.seconds()["limit"]


def time_stage(device: Device, stage: Stage, repeats: int) -> Timing:
    """Run ``stage`` once to warm up, then ``repeats`` times, or fewer if that would take too long."""
    stage.run()
    half = max(1, round(stage.work.bytes / 2 / COPY_UNIT)) * COPY_UNIT
    copy_beside = _copies(device, half)[0] if stage.beside_copy else None
    seconds: list[float] = []
    bandwidths: list[float] = []
    begin = time.monotonic()
    while len(seconds) < repeats and (not seconds or time.monotonic() - begin < PATIENCE):
        if copy_beside:
            bandwidths.append(2 * half / copy_beside())
        device.profile.clear()
        stage.run()
        timed = device.profile.seconds()
        of_stage = timed.keys() - TRANSFERS if stage.events is None else stage.events
        seconds.append(sum(timed[event] for event in of_stage))
    device.profile.clear()
    before = _reset_peak()  # outside the timed runs: pages returned to the system have to be cleared again
    stage.run()
    peak = _memory("VmHWM") - before if before else None
    return Timing(
        stage,
        statistics.median(seconds),
        half_quartile_distance(seconds),
        len(seconds),
        peak,
        statistics.median(bandwidths) if bandwidths else None,
    )


def _reset_peak() -> int:
    """Reset this process's peak resident memory; returns its current bytes, 0 if the system does not tell."""
    with contextlib.suppress(AttributeError):  # only glibc has this; without it, reusing freed memory would not show
        ctypes.CDLL(None).malloc_trim(0)
    try:
        Path("/proc/self/clear_refs").write_text("5")
        return _memory("VmRSS")
    except OSError:
        return 0


def _memory(name: str) -> int:
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(name):
            return 1024 * int(line.split()[1])
    return 0


def rated(timing: Timing, limits: Limits) -> StageMeasurement:
    """``timing`` compared with ``limits``."""
    stage, work, seconds = timing.stage, timing.stage.work, timing.seconds
    bandwidth = work.bytes / (timing.bandwidth or limits.bandwidth(work.bytes)) / seconds
    arithmetic = work.operations / limits.multiply_adds / seconds
    return StageMeasurement(
        stage=stage.name,
        map=stage.map,
        width=stage.map_shape and stage.map_shape[1],
        height=stage.map_shape and stage.map_shape[0],
        resolution=stage.resolution,
        N=stage.N,
        seconds=seconds,
        spread=timing.spread,
        repeats=timing.repeats,
        peak_bytes=timing.peak_bytes,
        bytes=work.bytes,
        operations=work.operations,
        counted="brute force" if work.skips else "least",
        bandwidth_share=bandwidth,
        multiply_add_share=arithmetic,
        bound="bandwidth" if bandwidth > arithmetic else "multiply-add",
        bound_share=max(bandwidth, arithmetic),
        rate=work.amount / seconds,
        unit=work.unit,
        brute_force_ratio=work.pairs * PAIR / limits.multiply_adds / seconds if work.pairs else None,
    )


def lines(points: Sequence[StageMeasurement], axis: str) -> dict[str, list[StageMeasurement]]:
    """Each stage's measurements along ``axis`` (``map``, ``resolution`` or ``N``), with everything else equal.

    Along ``map``, only maps made for the measurement count. If a stage has several lines, the longest is taken.
    """
    found: dict[tuple[str, tuple[object, ...]], list[StageMeasurement]] = {}
    for p in points:
        if extent(p, axis) and (axis != "map" or p.map == MADE):
            rest: list[object] = [(p.map, p.map_pixels), p.resolution, p.N]
            rest[AXES.index(axis)] = None
            found.setdefault((p.stage, tuple(rest)), []).append(p)
    result: dict[str, list[StageMeasurement]] = {}
    for (stage, _), line in found.items():
        if len(line) > max(1, len(result.get(stage, ()))):
            result[stage] = sorted(line, key=lambda p: extent(p, axis) or 0)
    return result


def extent(point: StageMeasurement, axis: str) -> int | None:
    """How large a measurement's problem is along ``axis``: pixels of the map, pixels of the image, or N."""
    return {"map": point.map_pixels, "resolution": point.resolution and point.resolution**2, "N": point.N}[axis]


def exponents(points: Sequence[StageMeasurement]) -> dict[str, dict[str, float | None]]:
    """The exponents b of time ~ size^b, by axis and stage."""
    return {
        axis: {
            name: exponent([extent(p, axis) or 0 for p in line], [p.seconds for p in line])
            for name, line in lines(points, axis).items()
        }
        for axis in AXES
    }


def write_stage_csv(path: Path, points: Sequence[StageMeasurement]) -> None:
    """A row per measurement and a column per figure, in seconds, bytes, and amounts per second."""
    write_table(path, [f.name for f in fields(StageMeasurement)], map(astuple, points))


def write_stage_json(path: Path, points: Sequence[StageMeasurement], settings: Mapping[str, object]) -> None:
    """Write the settings and all measurements."""
    write_json(path, {**settings, "measurements": [asdict(p) for p in points]}, allow_nan=True)
