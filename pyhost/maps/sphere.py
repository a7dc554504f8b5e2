"""A white diffuse sphere under a map, on the host: coarse, and so without a device.

The map is averaged over cells; the camera is that of :mod:`lightdome.lighting.shade`.
"""

from __future__ import annotations

import numpy as np

from ..disc import disc_mask
from .envmap import EnvironmentMap
from .geometry import directions, solid_angles
from .images import auto_exposure

RESOLUTION, CELLS = 32, 64  # of the image that an exposure is taken from, and rows of cells for it


def sphere_exposure(envmap: EnvironmentMap, albedo: float = 1.0) -> float:
    """The :func:`auto_exposure` of the exact image of a sphere of ``albedo``, within 1 %.

    The map alone decides it, so all pictures of the sphere under one map have the same, whatever drew them.
    """
    n = (2.0 * np.arange(RESOLUTION) + 1 - RESOLUTION) / RESOLUTION
    nx, ny = (axis[disc_mask(RESOLUTION)] for axis in np.meshgrid(n, -n))
    normals = np.stack([nx, ny, np.sqrt(1 - nx**2 - ny**2)], axis=1)
    return auto_exposure(albedo * reflected(envmap, normals, CELLS))


def reflected(envmap: EnvironmentMap, normals: np.ndarray, cells: int = 256) -> np.ndarray:
    """Radiance of a white diffuse surface with each of ``normals``, (N, 3), under the map: (N, 3) float64.

    The map is averaged to at most ``cells`` rows, and twice as many columns.
    """
    height, width = envmap.height, envmap.width
    rows = np.arange(0, height, -(-height // cells))
    columns = np.arange(0, width, -(-width // (2 * cells)))
    of_rows = [
        weight * np.add.reduceat(row, columns, axis=0, dtype=np.float64)
        for row, weight in zip(envmap.radiance, solid_angles(height, width), strict=True)
    ]
    flux = np.add.reduceat(np.stack(of_rows), rows, axis=0)
    theta = (np.pi / height) * (rows + np.append(rows[1:], height)) / 2
    phi = (np.pi / width) * (columns + np.append(columns[1:], width))
    result = np.zeros((len(normals), 3))
    for of_row, row in zip(directions(theta[:, None], phi), flux, strict=True):
        result += np.maximum(normals @ of_row.T, 0) @ row
    return result / np.pi
