"""Guide tables, which let the searches of a map's CDFs start close to where they end.

They pay off only for many samples. ``guide.cl`` builds them, and ``guided.clh`` searches with them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..opencl import memory
from ..opencl.memory import DeviceArray
from .strips import strip_bits

if TYPE_CHECKING:
    from ..opencl.device import Device

BUCKETS_PER_ROW = 4.0  # in the tables for the CDFs over rows
BUCKETS_PER_PIXEL = 1.0
MAX_BUCKETS = 2**26  # of all rows together: half a gibibyte


@dataclass(frozen=True)
class Guide:
    """The guide tables of the CDFs of a map's strips over rows, and of the CDFs of its rows.

    - ``marginal``, ``rows``: the tables, 2^32 >> shift records per CDF, (count, records, 2) uint32
    - ``row_total``: the last entry of each row's CDFs, (H S,) uint32
    """

    marginal: DeviceArray
    rows: DeviceArray
    row_total: DeviceArray
    marginal_shift: int
    row_shift: int

    @property
    def arguments(self) -> dict[str, DeviceArray | int]:
        """The arguments of kernels that search with this guide."""
        return {
            "marginal_guide": self.marginal,
            "row_guide": self.rows,
            "row_total": self.row_total,
            "marginal_shift": self.marginal_shift,
            "row_shift": self.row_shift,
        }


def build_guide(
    device: Device, row_cdf: DeviceArray, marginal_cdf: DeviceArray, max_buckets: int = MAX_BUCKETS
) -> Guide:
    """Guide tables for a map's CDFs (H, W) and (S, H), see :class:`lightdome.sampling.cdf.MapCDF`."""

    def table(cdf: DeviceArray, bits_per_row: int, buckets: float) -> tuple[DeviceArray, DeviceArray, int]:
        rows, width = cdf.shape
        count = rows << bits_per_row
        bits = max(1, math.ceil(math.log2(min(rows * width * buckets, max_buckets) / count)))
        guide = memory.empty(device, (count, 2**bits, 2), np.uint32)
        total = memory.empty(device, count, np.uint32)
        shift = 32 - bits
        kernel, size = ("guide_buckets", (2**bits, count)) if device.is_gpu else ("guide", (count,))
        device.launch(
            f"sampling/{kernel}",
            size,
            stage="guide",
            cdf=cdf,
            width=width,
            strip_bits=bits_per_row,
            shift=shift,
            guide=guide,
            total=total,
        )
        return guide, total, shift

    marginal, _, marginal_shift = table(marginal_cdf, 0, BUCKETS_PER_ROW)
    rows, row_total, row_shift = table(row_cdf, strip_bits(row_cdf.shape[1]), BUCKETS_PER_PIXEL)
    return Guide(marginal, rows, row_total, marginal_shift, row_shift)
