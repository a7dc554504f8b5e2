"""The two-dimensional CDF of a map: one over its rows, and one over the pixels of each row.

CDFs are integers, see ``clkernels/common/prefix_sum.clh``. Kernels: ``row_cdf.cl``, ``marginal_cdf.cl``.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..opencl import memory
from ..opencl.device import Device
from ..opencl.memory import DeviceArray
from .device_map import DeviceMap
from .guide import Guide, build_guide


@dataclass(frozen=True)
class MapCDF:
    """The CDFs that pick a pixel of a map: first a row, then a pixel in it.

    - ``rows``: the CDF of each row, (H, W) uint32
    - ``marginal``: the CDF over rows, (H,) uint32
    - ``total``: the sum over the map of all weights times sin(theta)
    """

    device: Device
    rows: DeviceArray
    marginal: DeviceArray
    total: float

    @cached_property
    def guide(self) -> Guide:
        """Tables that speed up the search for many samples, built when first asked for."""
        return build_guide(self.device, self.rows, self.marginal)


@dataclass(frozen=True)
class RowCDFs:
    """The CDFs of rows, (n, W) uint32, and the sums of their weights without sin(theta), (n, 2): n double words."""

    cdf: DeviceArray
    sums: DeviceArray


def build_cdf(of_map: DeviceMap, offset: float = 0.0) -> MapCDF:
    """The CDF of the weights max(0, scale (R + G + B) - offset) sin(theta)."""
    rows = build_row_cdfs(of_map, offset)
    marginal, total = build_marginal_cdf(of_map.device, rows.sums, of_map.sin_theta)
    return MapCDF(of_map.device, rows.cdf, marginal, total)


def build_row_cdfs(of_map: DeviceMap, offset: float = 0.0, out: RowCDFs | None = None) -> RowCDFs:
    """The CDFs of all rows; ``out`` holds arrays from an earlier call for the same map, to be overwritten."""
    device, shape = of_map.device, (of_map.height, of_map.width)
    out = out or RowCDFs(memory.empty(device, shape, np.uint32), memory.empty(device, (shape[0], 2), np.float32))
    radiance = of_map.radiance
    defines = {}
    if of_map.scale == 1 and offset == 0:
        defines["PLAIN"] = 1
        device.decisions.skip("scaling of weights", "their sums stay in float32's range")
    else:
        why = "their sums would leave float32's range" if of_map.scale != 1 else "only what is above the mean is drawn"
        device.decisions.use("scaling of weights", why)
    device.launch_rows(
        "sampling/row_cdf",
        of_map.height,
        group=128,
        stage="row cdf",
        defines=defines,
        radiance=radiance,
        width=of_map.width,
        scale=of_map.scale,
        offset=offset,
        cdf=out.cdf,
        row_sum=out.sums,
    )
    return out


def build_marginal_cdf(device: Device, row_sums: DeviceArray, sin_theta: DeviceArray) -> tuple[DeviceArray, float]:
    """The CDF over the rows of a map, and its total, from the sums of all of its rows, (H, 2)."""
    height = row_sums.shape[0]
    marginal = memory.empty(device, height, np.uint32)
    total = memory.empty(device, 2, np.float32)
    device.launch_rows(
        "sampling/marginal_cdf",
        1,
        stage="marginal cdf",
        row_sum=row_sums,
        sin_theta=sin_theta,
        height=height,
        cdf=marginal,
        total=total,
    )
    return marginal, float(memory.download(device, total).astype(np.float64).sum())
