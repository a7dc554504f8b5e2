"""Guide tables: searches of a map's CDFs that begin where they nearly end.

Worth their while for many samples only. Kernel: ``guide.cl``; ``guided.clh`` is what searches.
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
BUCKETS_A_PIXEL = 1.0


@dataclass(frozen=True)
class Guide:
    """Where the searches of the CDF over rows and of those of the rows begin and end.

    - ``marginal``, ``rows``: the tables, (2^32 >> shift) + 1 indices a CDF
    - ``row_total``: the last entry of each row's CDF, (H,) uint32
    """

    marginal: DeviceArray
    rows: DeviceArray
    row_total: DeviceArray
    marginal_shift: int
    row_shift: int

    @property
    def defines(self) -> dict[str, int]:
        """What kernels that search with this guide are built with."""
        return {"GUIDED": 1, **_wide(self.rows.dtype)}

    @property
    def arguments(self) -> tuple[object, ...]:
        """The arguments of kernels that search with this guide."""
        tables = (self.marginal.buffer, self.rows.buffer, self.row_total.buffer)
        return (*tables, np.uint32(self.marginal_shift), np.uint32(self.row_shift))


def build_guide(device: Device, row_cdf: DeviceArray, marginal_cdf: DeviceArray) -> Guide:
    """Guide tables for a map's CDFs (H, W) and (H,), see :func:`lightdome.distribution.build_cdfs`."""
    height, width = row_cdf.shape
    index = np.dtype(np.uint16 if max(height, width) <= 2**16 else np.uint32)

    def table(cdf: DeviceArray, count: int, n: int, buckets: float) -> tuple[DeviceArray, DeviceArray, int]:
        bits = max(1, math.ceil(math.log2(n * buckets)))
        guide = buffers.empty(device, (count, 2**bits + 1), index.type)
        total = buffers.empty(device, count, np.uint32)
        event = device.kernel("guide", **_wide(index))(
            device.queue, (count,), (1,), cdf.buffer, np.uint32(n), np.uint32(32 - bits), guide.buffer, total.buffer
        )
        device.profile.record("guide", event)
        return guide, total, 32 - bits

    marginal, _, marginal_shift = table(marginal_cdf, 1, height, BUCKETS_A_ROW)
    rows, row_total, row_shift = table(row_cdf, height, width, BUCKETS_A_PIXEL)
    device.queue.finish()  # where the memory is the host's, it may be freed from here on
    return Guide(marginal, rows, row_total, marginal_shift, row_shift)


def _wide(index: np.dtype) -> dict[str, int]:
    return {"WIDE": 1} if index == np.uint32 else {}
