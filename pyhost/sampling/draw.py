"""Draw samples from a map by its CDF, at the points of a sequence or at given points.

Kernels: ``sample.cl``, ``sample_pixels.cl``, and each with guide tables.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from .. import checks
from ..opencl import memory
from ..opencl.device import Device
from ..opencl.memory import DeviceArray
from .cdf import MapCDF
from .device_map import DeviceMap
from .lattice import generator
from .samples import SEQUENCES

MAX_COUNT = 2**31 - 1
SAMPLES_PER_LAUNCH = 2**22  # between two updates of the progress line
SAMPLES_PER_BLOCK = 256  # that a work-item on a CPU draws side by side
SAMPLES_PER_PIXEL = 1 / 8  # samples per map pixel above which guide tables pay off
BLACK = "the map is black everywhere, so there is no light to sample; use another map"

# Outputs of a draw: shape per sample, and type.
OUTPUTS: dict[str, tuple[tuple[int, ...], type]] = {
    "direction": ((3,), np.float32),
    "radiance": ((3,), np.float32),
    "pixel": ((2,), np.int32),
    "probability": ((), np.float32),
}
PIXEL_OUTPUTS = ("pixel", "probability")  # the outputs of sample_pixels.cl


@dataclass(frozen=True)
class Points:
    """``count`` points in the unit square, from which samples are made.

    Kernels compute them from ``sequence`` and ``key``, a Philox key (:func:`sequence_points`), or read the ``given``
    ones, (count, 2) uint64 fractions of 2^64 (:func:`given_points`).
    """

    count: int
    sequence: str
    key: np.ndarray
    given: DeviceArray | None = None

    @property
    def defines(self) -> dict[str, int]:
        """The preprocessor defines that kernels are built with."""
        return {f"SEQUENCE_{self.sequence.upper()}": 1}

    @property
    def generator(self) -> int:
        """The generator of a lattice of ``count`` points; 0 for other sequences."""
        return generator(self.count) if self.sequence == "lattice" else 0


def sequence_points(count: int, seed: int, sequence: str) -> Points:
    """The points of a ``sequence``. Raises :class:`LightdomeError` for an invalid seed, sequence or count."""
    key = philox_key(seed)
    checks.choice("sequence", sequence, SEQUENCES)
    count = checks.whole("the number of samples", count, 1, MAX_COUNT)
    return Points(count, sequence, key)


def given_points(device: Device, points: np.ndarray) -> Points:
    """``points`` (N, 2): numbers in [0, 1), or uint64 fractions of 2^64."""
    if points.dtype != np.uint64:
        points = np.floor(points * 2.0**64).astype(np.uint64)
    return Points(len(points), "given", philox_key(0), memory.upload(device, points))


def philox_key(seed: int) -> np.ndarray:
    """A seed of 64 bits as the two words of a Philox key (an OpenCL ``uint2``)."""
    seed = checks.whole("a seed", seed, 0, 2**64 - 1)
    return np.array([seed & 0xFFFFFFFF, seed >> 32], dtype=np.uint32)


def is_guided(count: int, of_map: DeviceMap) -> bool:
    """Whether ``count`` samples of a map are enough for guide tables to pay for themselves."""
    return count >= of_map.width * of_map.height * SAMPLES_PER_PIXEL


def room_for(device: Device, count: int, outputs: Iterable[str] = OUTPUTS) -> dict[str, DeviceArray]:
    """Arrays for ``outputs`` of ``count`` samples."""
    kinds = {name: OUTPUTS[name] for name in outputs}
    return {name: memory.empty(device, (count, *shape), kind) for name, (shape, kind) in kinds.items()}


def draw(
    of_map: DeviceMap, cdf: MapCDF, points: Points, outputs: Mapping[str, DeviceArray], within: str = "centre"
) -> None:
    """Draw a sample at each of ``points``, and write ``outputs``: all of OUTPUTS, or PIXEL_OUTPUTS alone.

    ``within`` is one of :data:`lightdome.names.WITHIN`, as for :meth:`lightdome.Distribution.sample`.
    """
    device, count = of_map.device, points.count
    results: dict[str, Any] = {
        "sample_radiance" if name == "radiance" else name: array for name, array in outputs.items()
    }
    kernel = "sample" if "direction" in outputs else "sample_pixels"
    defines: dict[str, int] = {}
    angles: dict[str, Any] = {"theta": of_map.theta}
    if "direction" in outputs:
        angles |= {"phi": of_map.phi, "row_versines": None}
        if within == "pixel":
            defines["WITHIN_PIXEL"] = 1
            angles["row_versines"] = of_map.row_versines
    weights: dict[str, Any] = {"radiance": of_map.radiance, "scale": of_map.scale}
    guided: Mapping[str, Any] = {}
    if is_guided(count, of_map):
        many = f"{count} samples on {of_map.width} x {of_map.height} pixels are enough to pay for them"
        device.decisions.use("guide tables", many)
        if kernel == "sample_pixels":
            weights = {"f": of_map.weight}
        kernel, guided = f"{kernel}_guided", cdf.guide.arguments
    else:
        few = f"{count} samples are drawn faster than the tables for the map would be built"
        device.decisions.skip("guide tables", few)
    block = 1 if device.is_gpu else SAMPLES_PER_BLOCK
    device.launch(
        f"sampling/{kernel}",
        (-(-count // block),),
        stage="search",
        defines={"BLOCK": block, **points.defines, **defines},
        step=device.items_per_launch(SAMPLES_PER_LAUNCH, block),
        progress="sampling",
        **cdf.arguments,
        **weights,
        **guided,
        **angles,
        width=of_map.width,
        height=of_map.height,
        inverse_total=1 / cdf.total,
        count=count,
        seed=points.key,
        generator=points.generator,
        points=points.given,
        **results,
    )


def drawn(
    of_map: DeviceMap, cdf: MapCDF, points: Points, outputs: Iterable[str] = OUTPUTS, within: str = "centre"
) -> dict[str, np.ndarray]:
    """``outputs`` of the samples at ``points``, on the host."""
    arrays = room_for(of_map.device, points.count, outputs)
    draw(of_map, cdf, points, arrays, within)
    return dict(zip(arrays, memory.download_all(of_map.device, list(arrays.values())), strict=True))
