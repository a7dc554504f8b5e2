"""A map on a device, uploaded once for everything that reads it there."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .. import checks
from ..maps.envmap import EnvironmentMap
from ..maps.geometry import column_angles, row_angles, sine_cosine, solid_angles
from ..opencl import memory
from ..opencl.device import Device
from ..opencl.memory import DeviceArray

BORDER = 2e-7  # radians between directions and the borders of their rows, which rounding to float32 could cross


@dataclass(frozen=True)
class DeviceMap:
    """``envmap`` on ``device``; each array is made when it is first asked for. :meth:`of` puts a whole map there.

    - ``scale``: a power of two that keeps sums over the map inside float32's range
    - ``row_angles``: polar angles of its rows, (H,) float64, radians; a band of a larger map has those of its own rows
    - ``row_angle``: the angle from one row to the next, radians
    """

    device: Device
    envmap: EnvironmentMap
    scale: float
    row_angles: np.ndarray
    row_angle: float

    @classmethod
    def of(cls, device: Device, envmap: EnvironmentMap | DeviceMap) -> DeviceMap:
        """The whole map on ``device``; a map that is already there is returned as it is.

        Raises :class:`LightdomeError` if an argument is of another type.
        """
        checks.instance("the device", device, Device)
        if isinstance(envmap, DeviceMap) and envmap.device is device:
            return envmap
        if isinstance(envmap, DeviceMap):
            envmap = envmap.envmap
        checks.instance("the map", envmap, EnvironmentMap)
        return cls(device, envmap, range_scale(envmap.peak), row_angles(envmap.height), np.pi / envmap.height)

    def upload(self) -> None:
        """Upload now what all samplers read, rather than with the first samples."""
        for name in ("radiance", "theta", "phi"):
            getattr(self, name)

    @property
    def height(self) -> int:
        """Rows."""
        return self.envmap.height

    @property
    def width(self) -> int:
        """Columns."""
        return self.envmap.width

    @property
    def is_grey(self) -> bool:
        """Whether the three channels are the same everywhere."""
        return self.envmap.is_grey

    @cached_property
    def radiance(self) -> DeviceArray:
        """(H, W, 3) float32."""
        return memory.upload(self.device, self.envmap.radiance)

    @cached_property
    def theta(self) -> DeviceArray:
        """(sin, cos) of every row's polar angle, (H, 2) float32."""
        return memory.upload(self.device, sine_cosine(self.row_angles))

    @cached_property
    def phi(self) -> DeviceArray:
        """(sin, cos) of every column's azimuth, (W, 2) float32."""
        return memory.upload(self.device, sine_cosine(column_angles(self.width)))

    @cached_property
    def row_versines(self) -> DeviceArray:
        """1 - cos of the polar angles between which each row's directions lie, (H, 2) uint64, in units of 2^-62."""
        half = self.row_angle / 2 - min(BORDER, self.row_angle / 8)
        return memory.upload(self.device, versines(self.row_angles[:, None] + np.array([-half, half])))

    @cached_property
    def edge(self) -> DeviceArray:
        """cos of the polar angles of the borders of a whole map's rows, (H + 1,) float32."""
        return memory.upload(self.device, np.cos(np.pi / self.height * np.arange(self.height + 1)).astype(np.float32))

    @cached_property
    def edge_sine(self) -> DeviceArray:
        """sin of the polar angles of the borders of a whole map's rows, (H + 1,) float32."""
        return upload_sines(self.device, np.pi * np.arange(self.height + 1) / self.height)

    @cached_property
    def sin_theta(self) -> DeviceArray:
        """sin of every row's polar angle, (H,) float32."""
        return upload_sines(self.device, self.row_angles)

    @cached_property
    def solid_angles(self) -> np.ndarray:
        """Solid angle of one pixel of each row of a whole map, (H,) float64, on the host."""
        return solid_angles(self.height, self.width)

    @cached_property
    def weight(self) -> DeviceArray:
        """``scale`` (R + G + B) of every pixel, (H, W) float32."""
        weight = memory.empty(self.device, (self.height, self.width), np.float32)
        self.device.launch(
            "sampling/map_weights",
            (self.height,),
            stage="weights",
            radiance=self.radiance,
            width=self.width,
            scale=self.scale,
            f=weight,
        )
        return weight


def upload_sines(device: Device, angles: np.ndarray) -> DeviceArray:
    """The sines of ``angles``, which are float64, as float32."""
    return memory.upload(device, np.sin(angles).astype(np.float32))


def versines(angles: np.ndarray) -> np.ndarray:
    """1 - cos(theta) of polar angles in units of 2^-62, uint64; precise near both poles, where cos would round."""
    of_nearer_pole = np.round(np.sin(np.minimum(angles, np.pi - angles) / 2) ** 2 * 2.0**63).astype(np.uint64)
    return np.where(angles <= np.pi / 2, of_nearer_pole, np.uint64(2**63) - of_nearer_pole)


def range_scale(peak: float) -> float:
    """A power of two by which a map with this peak is scaled, so that no sum over it leaves float32's range.

    Large peaks come down to 2^60 and no further: a smaller scale might be subnormal, and dim pixels with it.
    """
    if peak == 0 or 2.0**-60 <= peak <= 2.0**60:
        return 1.0
    exponent = math.frexp(peak)[1]
    return 2.0 ** (60 - exponent if peak > 1 else min(127, -exponent))
