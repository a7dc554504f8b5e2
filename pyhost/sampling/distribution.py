"""The distribution of light over an environment map, and samples drawn from it.

Luminance is I = (R + G + B) / 3; a pixel is drawn with probability p(x, y) = p(y) p(x | y)
proportional to I sin(theta), the light that comes from it. Kernels: ``row_cdf.cl``,
``marginal_cdf.cl``, ``sample.cl`` and its variants. Source: Pharr, Jakob, Humphreys, Physically
Based Rendering, 4th ed., A.4, A.5 and 12.5.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pyopencl as cl

from .. import __version__, checks
from ..errors import LightdomeError
from ..maps.envmap import EnvironmentMap
from ..maps.geometry import column_angles, row_angles, sine_cosine, solid_angles
from ..opencl import memory
from ..opencl.device import Device
from ..opencl.memory import DeviceArray
from ..progress import Progress
from .guide import Guide, build_guide
from .samples import SEQUENCES, Samples

MAX_COUNT = 2**31 - 1
SAMPLES_A_LAUNCH = 2**22  # between two updates of the progress line
SAMPLES_A_BLOCK = 256  # that a work-item of a CPU draws side by side
SAMPLES_A_PIXEL = 1 / 8  # of the map, from which on a guide pays for itself
BLACK = "the map is black everywhere, so there is no light to sample; use another map"


@dataclass(frozen=True)
class Distribution:
    """p(x, y) of one map on one device; build with :func:`build_distribution`.

    ``total`` is the sum over the map of ``scale`` (R + G + B) sin(theta), float64.
    """

    device: Device
    envmap: EnvironmentMap
    radiance: DeviceArray  # (H, W, 3) float32
    row_cdf: DeviceArray  # (H, W) uint32, see clkernels/prefix_sum.clh
    marginal_cdf: DeviceArray  # (H,) uint32
    theta: DeviceArray  # (H, 2) float32: sin, cos
    phi: DeviceArray  # (W, 2) float32: sin, cos
    scale: float
    total: float

    @property
    def flux(self) -> float:
        """Phi, the integral of I over the sphere of directions: radiance x steradian."""
        height, width = self.envmap.height, self.envmap.width
        per_sine = solid_angles(height, width)[0] / np.sin(row_angles(height)[0])
        return self.total / self.scale / 3 * per_sine

    def sample(self, count: int, seed: int = 0, sequence: str = "independent") -> Samples:
        """Draw ``count`` samples. The same ``seed`` gives the same samples on every device.

        ``sequence`` is what the points are (``clkernels/sequence.clh``): ``independent``, ``stratified``
        in cells of equal area for any count, ``sobol`` with Owen's scramble, or the lattice ``r2``. The
        first n of more samples are the samples of n, except for ``stratified``.

        Raises :class:`LightdomeError` if the map is black, or for a count, a seed or a sequence that there is not.
        """
        return self._sample(count, philox_key(seed), sequence_define(count, sequence), sequence, seed)

    def sample_pixels(
        self,
        count: int,
        seed: int = 0,
        sequence: str = "independent",
        out: tuple[np.ndarray, np.ndarray] | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """The ``pixel`` (N, 2) int32 and ``probability`` (N,) float32 of :meth:`sample` alone, in half the time.

        ``out`` is what an earlier call returned, to be written over: new memory costs as much as the random numbers.
        Raises :class:`LightdomeError` as :meth:`sample` does, and for ``out`` of other shapes or types.
        """
        if out is not None and not (isinstance(out, tuple) and [type(a) for a in out] == [np.ndarray] * 2):
            raise LightdomeError(f"out must be the two arrays that an earlier call returned, got {checks.told(out)}")
        defines = sequence_define(count, sequence)
        pixel, probability = self._draw("sample_pixels", count, philox_key(seed), defines, out or (None, None))
        return pixel, probability

    def sample_at(self, points: np.ndarray) -> Samples:
        """The samples at given ``points``, (N, 2) in [0, 1): column 0 picks x within a row, column 1 picks y.

        Points are used to 32 bits. Raises :class:`LightdomeError` for points outside [0, 1).
        """
        points = checks.array("points", points, ("N", 2), np.float64)
        if len(points) == 0:
            raise LightdomeError("points must have shape (N, 2) with N at least 1, got (0, 2)")
        if not ((points >= 0) & (points < 1)).all():
            raise LightdomeError("points must lie in [0, 1)")
        bits = np.floor(points * 2.0**32).astype(np.uint32)
        given = memory.upload(self.device, bits).buffer
        return self._sample(len(bits), given, {}, "given", 0)

    @cached_property
    def guide(self) -> Guide:
        """Tables that speed up the search for many samples, built when first asked for."""
        return build_guide(self.device, self.row_cdf, self.marginal_cdf)

    @cached_property
    def weight(self) -> DeviceArray:
        """``scale`` (R + G + B) of every pixel, (H, W) float32, made when first asked for."""
        height, width = self.envmap.height, self.envmap.width
        weight = memory.empty(self.device, (height, width), np.float32)
        event = self.device.kernel("sampling/map_weights")(
            self.device.queue,
            (height,),
            self.device.one_by_one(),
            self.radiance.buffer,
            np.uint32(width),
            np.float32(self.scale),
            weight.buffer,
        )
        self.device.profile.record("weights", event).wait()
        return weight

    def _sample(
        self, count: int, points: np.ndarray | cl.Buffer, defines: dict[str, int], sequence: str, seed: int
    ) -> Samples:
        name = "sample_at" if sequence == "given" else "sample"
        direction, radiance, pixel, probability = self._draw(name, count, points, defines, (None,) * 4)
        return checks.made(
            Samples,
            direction=direction,
            radiance=radiance,
            probability=probability,
            pixel=pixel,
            map_shape=(self.envmap.height, self.envmap.width),
            sequence=sequence,
            seed=seed,
            version=__version__,
        )

    def _draw(
        self,
        name: str,
        count: int,
        points: np.ndarray | cl.Buffer,
        defines: dict[str, int],
        out: tuple[np.ndarray | None, ...],
    ) -> list[np.ndarray]:
        """Direction, radiance, pixel, probability, or the last two, as many as ``out`` has; in its arrays, if any."""
        if self.total == 0:
            raise LightdomeError(BLACK)
        device = self.device
        kinds = [((count, 3), np.float32), ((count, 3), np.float32), ((count, 2), np.int32), ((count,), np.float32)]
        results = [memory.empty(device, *kind, array) for kind, array in zip(kinds[-len(out) :], out, strict=True)]
        guided: tuple[object, ...] = ()
        radiance, scale = self.radiance, (np.float32(self.scale),)
        angles = (self.theta.buffer,) if name == "sample_pixels" else (self.theta.buffer, self.phi.buffer)
        if is_guided(count, self.envmap):
            many = f"{count} samples on {self.envmap.width} x {self.envmap.height} pixels are enough to pay for them"
            self.device.decisions.use("guide tables", many)
            if name == "sample_pixels":
                radiance, scale = self.weight, ()
            name, guided = f"{name}_guided", self.guide.arguments
        else:
            few = f"{count} samples are drawn faster than the tables for the map would be built"
            device.decisions.skip("guide tables", few)
        block = 1 if device.is_gpu else SAMPLES_A_BLOCK
        kernel = device.kernel(f"sampling/{name}", BLOCK=block, **defines)
        blocks, step = -(-count // block), device.items_a_launch(SAMPLES_A_LAUNCH, block)
        with Progress("sampling") as progress:
            for begin in range(0, blocks, step):
                event = kernel(
                    device.queue,
                    (min(step, blocks - begin),),
                    device.one_by_one(),
                    self.row_cdf.buffer,
                    self.marginal_cdf.buffer,
                    radiance.buffer,
                    *guided,
                    *angles,
                    np.uint32(self.envmap.width),
                    np.uint32(self.envmap.height),
                    *scale,
                    np.float32(1 / self.total),
                    np.uint32(count),
                    points,
                    *(result.buffer for result in results),
                    global_offset=(begin,),
                )
                device.profile.record("search", event)
                if blocks > step:
                    event.wait()
                    progress.update(min(1.0, (begin + step) / blocks))
        return [memory.download(device, result) for result in results]


def is_guided(count: int, envmap: EnvironmentMap) -> bool:
    """Whether ``count`` samples of a map are so many that guide tables pay for themselves."""
    return count >= envmap.width * envmap.height * SAMPLES_A_PIXEL


def sequence_define(count: int, sequence: str) -> dict[str, int]:
    """What kernels that draw ``count`` points of a ``sequence`` are built with; refuses what there is not."""
    checks.choice("sequence", sequence, SEQUENCES)
    checks.whole("the number of samples", count, 1, MAX_COUNT)
    return {f"SEQUENCE_{sequence.upper()}": 1}


def philox_key(seed: int) -> np.ndarray:
    """A seed of 64 bits as the two words of a Philox key (an OpenCL ``uint2``)."""
    seed = checks.whole("a seed", seed, 0, 2**64 - 1)
    return np.array([seed & 0xFFFFFFFF, seed >> 32], dtype=np.uint32)


def build_distribution(device: Device, envmap: EnvironmentMap) -> Distribution:
    """Build the CDF of every row and the CDF over rows of ``envmap`` on ``device``.

    Raises :class:`LightdomeError` where the device has not the room, or one argument is of another type.
    """
    checks.instance("the device", device, Device)
    checks.instance("the map", envmap, EnvironmentMap)
    height, width = envmap.height, envmap.width
    radiance = memory.upload(device, envmap.radiance)
    theta = memory.upload(device, sine_cosine(row_angles(height)))
    phi = memory.upload(device, sine_cosine(column_angles(width)))
    scale = range_scale(envmap.peak)
    row_cdf, marginal_cdf, total = build_cdfs(device, radiance, scale)
    return Distribution(
        device=device,
        envmap=envmap,
        radiance=radiance,
        row_cdf=row_cdf,
        marginal_cdf=marginal_cdf,
        theta=theta,
        phi=phi,
        scale=scale,
        total=total,
    )


def build_cdfs(
    device: Device, radiance: DeviceArray, scale: float, offset: float = 0.0
) -> tuple[DeviceArray, DeviceArray, float]:
    """The CDF of every row, the CDF over rows, and the total, of max(0, scale (R + G + B) - offset) sin(theta)."""
    row_cdf, row_sum = build_row_cdfs(device, radiance, scale, offset)
    return row_cdf, *build_marginal_cdf(device, row_sum)


def build_row_cdfs(
    device: Device,
    radiance: DeviceArray,
    scale: float,
    offset: float = 0.0,
    out: tuple[DeviceArray, DeviceArray] | None = None,
) -> tuple[DeviceArray, DeviceArray]:
    """The CDFs of the rows in ``radiance`` (n, W, 3), and their sums, n double words, without sin(theta).

    Keep both until the device is done: where it shares the host's memory it writes into theirs. ``out`` is what an
    earlier call for as many pixels returned, to be written over.
    """
    height, width = radiance.shape[:2]
    row_cdf, row_sum = out or (
        memory.empty(device, (height, width), np.uint32),
        memory.empty(device, (height, 2), np.float32),
    )
    defines = {}
    if scale == 1 and offset == 0:
        defines["PLAIN"] = 1
        device.decisions.skip("scaling of weights", "their sums stay in float32's range")
    else:
        why = "their sums would leave float32's range" if scale != 1 else "only what is above the mean is drawn"
        device.decisions.use("scaling of weights", why)
    event = device.kernel("sampling/row_cdf", **defines)(
        device.queue,
        (height,),
        device.one_by_one(),
        radiance.buffer,
        np.uint32(width),
        np.float32(scale),
        np.float32(offset),
        row_cdf.buffer,
        row_sum.buffer,
    )
    device.profile.record("row cdf", event)
    return row_cdf, row_sum


def build_marginal_cdf(device: Device, row_sum: DeviceArray) -> tuple[DeviceArray, float]:
    """The CDF over the rows of a map, and its total, from the sums of all of its rows, (H, 2)."""
    height = row_sum.shape[0]
    sin_theta = memory.upload(device, np.sin(row_angles(height)).astype(np.float32))
    marginal_cdf = memory.empty(device, height, np.uint32)
    total = memory.empty(device, 2, np.float32)
    event = device.kernel("sampling/marginal_cdf")(
        device.queue,
        (1,),
        (1,),
        row_sum.buffer,
        sin_theta.buffer,
        np.uint32(height),
        marginal_cdf.buffer,
        total.buffer,
    )
    device.profile.record("marginal cdf", event)
    return marginal_cdf, float(memory.download(device, total).astype(np.float64).sum())


def range_scale(peak: float) -> float:
    """A power of two that brings a map's peak to where no sum over a map can leave float32's range.

    Large peaks come down to 2^60 and no further: the scale would be subnormal itself, and dim pixels with it.
    """
    if peak == 0 or 2.0**-60 <= peak <= 2.0**60:
        return 1.0
    exponent = math.frexp(peak)[1]
    return 2.0 ** (60 - exponent if peak > 1 else min(127, -exponent))
