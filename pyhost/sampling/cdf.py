"""The CDFs of a map: over its strips, over the rows of each strip, and over the pixels of each row in a strip.

CDFs are integers, see ``clkernels/common/prefix_sum.clh``. Kernels: ``row_cdf.cl``, ``marginal_cdf.cl``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ..opencl import memory
from ..opencl.device import Device
from ..opencl.memory import DeviceArray
from .device_map import DeviceMap
from .guide import Guide, build_guide
from .strips import strip_bits, strip_table


@dataclass(frozen=True)
class MapCDF:
    """The CDFs that pick a pixel of a map: first a strip of columns, then a row, then a pixel of the row in the strip.

    - ``rows``: the CDFs of each row, (H, W) uint32; a new one begins with each of the S strips
    - ``marginal``: the CDF over rows of each strip, (S, H) uint32
    - ``strips``: the table from which a strip is picked, (S, 4) uint32, see :func:`strip_table`
    - ``total``: the sum over the map of all weights times sin(theta)
    """

    device: Device
    rows: DeviceArray
    marginal: DeviceArray
    strips: DeviceArray
    total: float

    @property
    def arguments(self) -> dict[str, Any]:
        """The arguments of kernels that search these CDFs."""
        return {
            "row_cdf": self.rows,
            "marginal_cdf": self.marginal,
            "strips": self.strips,
            "strip_bits": strip_bits(self.rows.shape[1]),
        }

    @cached_property
    def guide(self) -> Guide:
        """Tables that speed up the search for many samples, built when first asked for."""
        return build_guide(self.device, self.rows, self.marginal)


@dataclass(frozen=True)
class RowCDFs:
    """The CDFs of rows, (n, W) uint32, and the sums of their weights without sin(theta), (S, n, 2): S x n double words.

    S is the number of strips.
    """

    cdf: DeviceArray
    sums: DeviceArray


def build_cdf(of_map: DeviceMap, offset: float = 0.0) -> MapCDF:
    """The CDF of the weights max(0, scale (R + G + B) - offset) sin(theta)."""
    rows = build_row_cdfs(of_map, offset)
    return MapCDF(of_map.device, rows.cdf, *build_marginal_cdfs(of_map.device, rows.sums, of_map.sin_theta))


def build_row_cdfs(of_map: DeviceMap, offset: float = 0.0, out: RowCDFs | None = None) -> RowCDFs:
    """The CDFs of all rows; ``out`` holds arrays from an earlier call for the same map, to be overwritten."""
    device, height, width = of_map.device, of_map.height, of_map.width
    bits = strip_bits(width)
    out = out or RowCDFs(
        memory.empty(device, (height, width), np.uint32), memory.empty(device, (1 << bits, height, 2), np.float32)
    )
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
        height,
        group=128,
        stage="row cdf",
        defines=defines,
        radiance=radiance,
        width=width,
        height=height,
        scale=of_map.scale,
        offset=offset,
        strip_bits=bits,
        cdf=out.cdf,
        row_sum=out.sums,
    )
    return out


def build_marginal_cdfs(
    device: Device, row_sums: DeviceArray, sin_theta: DeviceArray
) -> tuple[DeviceArray, DeviceArray, float]:
    """``marginal``, ``strips`` and ``total`` of a :class:`MapCDF`, from the sums of all rows of a map, (S, H, 2)."""
    strips, height, _ = row_sums.shape
    marginal = memory.empty(device, (strips, height), np.uint32)
    total = memory.empty(device, (strips, 2), np.float32)
    device.launch_rows(
        "sampling/marginal_cdf",
        strips,
        stage="marginal cdf",
        row_sum=row_sums,
        sin_theta=sin_theta,
        height=height,
        cdf=marginal,
        total=total,
    )
    weights = memory.download(device, total).astype(np.float64).sum(axis=1)
    return marginal, memory.upload(device, strip_table(weights)), math.fsum(weights)
