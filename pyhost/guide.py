"""Guide tables: searches of a map's CDFs that begin where they nearly end.

Worth their while for many samples only. Kernels: ``guide.cl``, ``records.cl``; ``guided.clh`` searches.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from . import buffers
from .buffers import DeviceArray

if TYPE_CHECKING:
    from .device import Device

BUCKETS_A_ROW = 4.0  # one table for all rows: it fits a first-level cache
BUCKETS_A_PIXEL = 0.25
RECORDS_BYTES = 2**28  # a map whose records are larger keeps CDFs and radiance apart: memory counts more there


@dataclass(frozen=True)
class Guide:
    """Where to begin searches of the CDF over rows and of those of the rows.

    ``marginal``, ``rows``  the tables, 2^32 >> shift indices a CDF
    ``row_total``           the last entry of each row's CDF, (H,) uint32
    ``records``             (CDF, R, G, B) of every pixel, (H, W, 4) uint32; None where CDFs and radiance stay apart
    """

    marginal: DeviceArray
    marginal_shift: int
    rows: DeviceArray
    row_shift: int
    row_total: DeviceArray
    records: DeviceArray | None

    @property
    def defines(self) -> dict[str, int]:
        """What kernels that search with this guide are built with."""
        result = {"GUIDED": 1}
        if self.marginal.dtype == np.uint32:
            result["WIDE"] = 1
        if self.records is not None:
            result["RECORDS"] = 1
        return result

    @property
    def arguments(self) -> tuple[object, ...]:
        """The arguments of kernels that search with this guide."""
        return (
            self.marginal.buffer,
            np.uint32(self.marginal_shift),
            self.rows.buffer,
            np.uint32(self.row_shift),
            self.row_total.buffer,
            None if self.records is None else self.records.buffer,
        )


def build_guide(device: Device, radiance: DeviceArray, row_cdf: DeviceArray, marginal_cdf: DeviceArray) -> Guide:
    """Guide tables for a map's ``radiance`` (H, W, 3) and its CDFs, see :func:`lightdome.distribution.build_cdfs`."""
    height, width = radiance.shape[:2]
    index = np.dtype(np.uint16 if max(height, width) <= 2**16 else np.uint32)
    defines = {"WIDE": 1} if index == np.uint32 else {}

    def table(cdf: DeviceArray, count: int, n: int, buckets: float) -> tuple[DeviceArray, int, DeviceArray]:
        bits = max(1, math.ceil(math.log2(n * buckets)))
        guide = buffers.empty(device, (count, 2**bits), index.type)
        total = buffers.empty(device, count, np.uint32)
        event = device.kernel("guide", **defines)(
            device.queue, (count,), (1,), cdf.buffer, np.uint32(n), np.uint32(32 - bits), guide.buffer, total.buffer
        )
        device.profile.record("guide", event)
        return guide, 32 - bits, total

    marginal, marginal_shift, _ = table(marginal_cdf, 1, height, BUCKETS_A_ROW)
    rows, row_shift, row_total = table(row_cdf, height, width, BUCKETS_A_PIXEL)
    records = None
    if 16 * height * width <= RECORDS_BYTES:
        records = buffers.empty(device, (height, width, 4), np.uint32)
        event = device.kernel("records")(
            device.queue, (height,), (1,), row_cdf.buffer, radiance.buffer, np.uint32(width), records.buffer
        )
        device.profile.record("guide", event)
    return Guide(marginal, marginal_shift, rows, row_shift, row_total, records)
