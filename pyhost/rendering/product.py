"""Sampling the product of light and cosine: coarse CDFs for every tile of the sphere's image.

The map is cut into cells and the image into tiles. A tile picks a cell by the cell's light times an estimate of the
cosine between the tile's normals and the cell's directions. The cell then picks one of its pixels by the pixel's light.
So hardly any direction is drawn below the horizon. From each sample, a control variate is subtracted: the same sample
if its cell had one colour and one direction. The known mean of that is added back. Kernels: ``cells.cl``,
``product_cdf.cl``, ``render_product.cl``. Source: Cline, Egbert, Talbot, Cardon, Two Stage Importance Sampling for
Direct Lighting (2006); Clarberg, Jarosz, Akenine-Möller, Jensen, Wavelet Importance Sampling (2005); Owen, Monte Carlo
theory, methods and examples (2013), 8.9, on control variates.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .. import checks
from ..disc import check_resolution
from ..opencl import memory
from ..opencl.device import Device
from ..opencl.memory import DeviceArray
from ..sampling.device_map import DeviceMap
from ..sampling.distribution import Distribution

CELLS = (128, 64)  # most cells across and down the map
TILES = 32  # most tiles across and down the image
ENTRIES = 2**22  # most tiles x cells, or building the tables would take longer than a few samples per pixel
VECTOR = 16  # cells that a kernel reads at a time


@dataclass(frozen=True)
class ProductCDFs:
    """The CDFs of all tiles over the cells of a map, and of all cells over their pixels."""

    tile_size: int
    tile_row_cdf: DeviceArray  # (T, T, cells down, cells across) uint32
    tile_marginal_cdf: DeviceArray  # (T, T, cells down) uint32
    tile_cones: DeviceArray  # (T, T, 4) float32, mean normal and reach
    tile_total: DeviceArray  # (T, T) float32
    cells: tuple[int, int]  # across and down
    cell_size: tuple[int, int]  # pixels across and down
    cell_row_cdf: DeviceArray  # (H, W) uint32
    cell_marginal_cdf: DeviceArray  # (cells across, H) uint32
    cell_cones: DeviceArray  # for every cell, by rows, (mean direction, reach); float32, and zeros after the last
    cell_colours: DeviceArray  # likewise, the channels' shares of its flux; unused if the map is grey
    tile_moments: DeviceArray  # (T, T, 3, or 1 if the map is grey, 4) float32, sums for the means of control variates

    def lit(self, device: Device, disc: np.ndarray) -> np.ndarray:
        """The pixels (x, y) of ``disc`` whose tile sees light, sorted by tile, since those of a tile share its CDFs."""
        total = memory.download(device, self.tile_total)
        x, y = disc.T // self.tile_size
        tile = (y * len(total) + x).astype(np.uint16)  # numpy sorts 16 bits by radix
        order = np.argsort(tile, kind="stable")
        return disc.take(order[total.ravel()[tile[order]] > 0], axis=0)


def build_product_cdfs(distribution: Distribution, resolution: int, areas: bool = False) -> ProductCDFs:
    """The CDFs for the image of ``resolution`` x ``resolution`` pixels under a map that is not black.

    With ``areas``, a cell's cone covers all directions within its pixels, otherwise only their centres.
    Raises :class:`LightdomeError` for a resolution outside 1 to 16384.
    """
    checks.instance("the distribution", distribution, Distribution)
    resolution = check_resolution(resolution)
    device, of_map = distribution.device, distribution.map
    cell_size = -(-of_map.width // CELLS[0]), -(-of_map.height // CELLS[1])
    across, down = -(-of_map.width // cell_size[0]), -(-of_map.height // cell_size[1])
    cell_row_cdf = memory.empty(device, (of_map.height, of_map.width), np.uint32)
    cell_marginal_cdf = memory.empty(device, (across, of_map.height), np.uint32)
    padded = down * across + VECTOR - 1
    flux = memory.zeros(device, (padded,), np.float32)
    cell_cones = memory.zeros(device, (padded, 4), np.float32)
    cell_colours = memory.zeros(device, (1 if of_map.is_grey else padded, 4), np.float32)
    defines = {"GREY": 1} if of_map.is_grey else {}
    device.launch_rows(
        "rendering/cells",
        (across, down),
        defines=defines,
        radiance=of_map.radiance,
        theta=of_map.theta,
        phi=of_map.phi,
        spread=memory.upload(device, _spread(of_map) if areas else np.zeros(of_map.height, np.float32)),
        width=of_map.width,
        height=of_map.height,
        size=cell_size,
        scale=of_map.scale,
        cell_row_cdf=cell_row_cdf,
        cell_marginal_cdf=cell_marginal_cdf,
        flux=flux,
        cell_cones=cell_cones,
        cell_colours=cell_colours,
    )

    tile_size = -(-resolution // min(TILES, math.isqrt(ENTRIES // (across * down))))
    count = -(-resolution // tile_size)
    tile_cones = memory.empty(device, (count, count, 4), np.float32)
    tile_total = memory.zeros(device, (count, count), np.float32)
    tile_row_cdf = memory.empty(device, (count, count, down, across), np.uint32)
    tile_marginal_cdf = memory.empty(device, (count, count, down), np.uint32)
    tile_moments = memory.empty(device, (count, count, 1 if of_map.is_grey else 3, 4), np.float32)
    device.launch_rows(
        "rendering/product_cdf",
        (count, count),
        stage="product cdf",
        defines=defines,
        flux=flux,
        cell_cones=cell_cones,
        cell_colours=cell_colours,
        cells=(across, down),
        tile_size=tile_size,
        resolution=resolution,
        tile_cones=tile_cones,
        total=tile_total,
        tile_row_cdf=tile_row_cdf,
        tile_marginal_cdf=tile_marginal_cdf,
        tile_moments=tile_moments,
    )
    return ProductCDFs(
        tile_size=tile_size,
        tile_row_cdf=tile_row_cdf,
        tile_marginal_cdf=tile_marginal_cdf,
        tile_cones=tile_cones,
        tile_total=tile_total,
        cells=(across, down),
        cell_size=cell_size,
        cell_row_cdf=cell_row_cdf,
        cell_marginal_cdf=cell_marginal_cdf,
        cell_cones=cell_cones,
        cell_colours=cell_colours,
        tile_moments=tile_moments,
    )


def _spread(of_map: DeviceMap) -> np.ndarray:
    """A bound, for each row, on the distance from a pixel's centre to any direction in it, (H,) float32.

    The square of a chord between angles d_theta and d_phi apart is 4 sin(d_theta / 2)^2 and 4 sin(theta) sin(theta')
    sin(d_phi / 2)^2. The borders of rows are those of ``edge``, which are rounded to float32.
    """
    theta, border = of_map.row_angles, np.arccos(memory.download(of_map.device, of_map.edge).astype(np.float64))
    half = np.maximum(theta - border[:-1], border[1:] - theta)
    sines = np.sin(theta) * np.sin(np.clip(np.pi / 2, border[:-1], border[1:]))
    chord2 = np.sin(half / 2) ** 2 + sines * np.sin(np.pi / 2 / of_map.width) ** 2
    return (2 * np.sqrt(chord2)).astype(np.float32)
