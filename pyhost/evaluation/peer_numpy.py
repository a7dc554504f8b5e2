"""numpy as a peer: what a careful user would write without OpenCL, with samples shared by all pixels.

The map's two-level CDF is two cumulative sums in float64, and N samples take two ``searchsorted`` calls. Shading is a
matrix product, a maximum and another matrix product (BLAS, float32), over chunks of pixels whose cosines stay in the
cache, with one thread per core. It shares no code with lightdome's kernels.
"""

from __future__ import annotations

import os
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from .. import reference
from ..disc import disc_mask
from ..maps.geometry import directions

PAIRS_PER_CHUNK = 2**18  # 1 MB of cosines; for much larger products BLAS starts its own threads


def draw(radiance: np.ndarray, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Draw ``count`` pixels of ``radiance`` (H, W, 3): (direction (N, 3), flux (N, 3)), float64.

    Samples are independent: the row by p(y), the column by p(x | y), with p proportional to (R+G+B)/3 sin(theta). A
    sample's flux is its radiance / (N density), so the irradiance at a normal n is the sum of flux max(0, n . w).
    """
    height, width = radiance.shape[:2]
    theta, phi = reference.angles(height, width)
    light = radiance / np.float64(radiance.max())
    weight = light.sum(axis=2) * np.sin(theta)
    along = weight.cumsum(axis=1)
    total = along[:, -1].copy()
    rows = total.cumsum()

    u = np.random.default_rng(seed).random((count, 2))
    y = np.searchsorted(rows, np.minimum(u[:, 1] * rows[-1], np.nextafter(rows[-1], 0)), side="right")
    # A single search for all rows: the CDF of row y runs from y to y + 1, and rounding must not reach y + 1.
    along /= np.where(total > 0, total, 1)[:, None]
    along += np.arange(height)[:, None]
    x = np.searchsorted(along.ravel(), np.minimum(y + u[:, 0], np.nextafter(y + 1.0, 0)), side="right") - y * width

    probability = weight[y, x] / rows[-1]
    solid_angle = reference.pixel_solid_angles(height, width)[y, x]
    direction = directions(theta[y, x], phi[y, x])
    return direction, radiance[y, x] * (solid_angle / (count * probability))[:, None]


def shade(direction: np.ndarray, flux: np.ndarray, resolution: int) -> np.ndarray:
    """The sphere under N directional lights of ``flux`` (N, 3): (R, R, 3) float32, 0 outside the disc."""
    mask = disc_mask(resolution)
    normal = reference.normals(resolution)[mask].astype(np.float32)
    towards = np.ascontiguousarray(direction.T, dtype=np.float32)
    flux = (flux / np.pi).astype(np.float32)
    pixels = np.empty((len(normal), 3), np.float32)
    step = max(16, PAIRS_PER_CHUNK // len(direction))

    def part(begin: int) -> None:
        cosine = normal[begin : begin + step] @ towards
        np.maximum(cosine, 0, out=cosine)
        pixels[begin : begin + step] = cosine @ flux

    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    with ThreadPoolExecutor(cores) as pool:
        list(pool.map(part, range(0, len(normal), step)))
    image = np.zeros((resolution, resolution, 3), np.float32)
    image[mask] = pixels
    return image


def draw_and_shade(radiance: np.ndarray, resolution: int, count: int, seed: int) -> tuple[np.ndarray, dict[str, float]]:
    """The image from ``count`` shared samples, and the seconds of its stages."""
    start = time.perf_counter()
    direction, flux = draw(radiance, count, seed)
    drawn = time.perf_counter()
    image = shade(direction, flux, resolution)
    return image, {"draw": drawn - start, "shade": time.perf_counter() - drawn}
