"""The image of the diffuse sphere under a whole map: every pixel of the map counts once, as its centre or as an area.

The conventions of camera and image are those of :mod:`lightdome.lighting.shade`. Kernels: ``arc_sums.cl`` with
``exact.cl`` or ``exact_areas.cl``.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from .. import __version__, checks
from ..cache import key_of, remembered
from ..disc import check_resolution, disc_tiles, note_tiles
from ..float_range import to_float32
from ..maps.envmap import EnvironmentMap
from ..names import PIXELS
from ..opencl import memory
from ..opencl.device import Device
from ..progress import Progress
from ..sampling.device_map import DeviceMap
from .horizon import LEAST_SHAPE, area_moments, horizon_tables

# The image is summed over bands of map rows: at most 64 rows in single precision, and the bands' sums in double words.
ARCS_ROWS = 64  # most in a band, except for centres on a GPU
ARCS_BYTES = 2**24  # most for a band's prefix sums: less than most third-level caches
GPU_ARCS_BYTES = 2**26  # the same on a GPU
GPU_PATCH = 16, 16  # pixels of a group, see clkernels/lighting/sphere.clh
# Part of the key of kept images: change it when the camera or a map's orientation changes.
CONVENTION = "row 0 up, phi from +x to +z, camera along -z"
KERNELS = {"centres": "lighting/exact", "areas": "lighting/exact_areas"}  # they sum over the arcs of rows


def exact_kept(
    device: Device, envmap: EnvironmentMap, resolution: int = 511, pixels: Literal["centres", "areas"] = "centres"
) -> np.ndarray:
    """:func:`exact` with albedo 1; read from the disk cache if the same kernels have summed the same map before."""
    checks.instance("the device", device, Device)
    checks.instance("the map", envmap, EnvironmentMap)
    resolution = check_resolution(resolution)
    checks.choice("pixels", pixels, PIXELS)
    arcs = "lighting/arc_sums_grouped" if device.is_gpu else "lighting/arc_sums"
    kernels = [device.programs.text(name) for name in (arcs, KERNELS[pixels])]
    of_map = str(envmap.radiance.shape), envmap.radiance.data
    key = key_of(CONVENTION, __version__, *kernels, pixels, str(resolution), *of_map)
    shape = (resolution, resolution, 3)
    return remembered("exact", key, lambda: exact(device, envmap, resolution, pixels=pixels), shape)


def exact(
    device: Device,
    envmap: EnvironmentMap | DeviceMap,
    resolution: int = 511,
    albedo: float = 1.0,
    pixels: Literal["centres", "areas"] = "centres",
) -> np.ndarray:
    """The image that estimators converge to, by one of two integrals over all pixels of the map.

    - ``centres``: a pixel of the map is the direction of its centre, weighted by its solid angle. Samples, lights,
      harmonics, and the estimators ``light`` and ``product`` converge to it.
    - ``areas``: a pixel of the map is an area of constant radiance, which the horizon may cut. The estimators ``bsdf``
      and ``mis`` converge to it, and the others with ``within="pixel"``. About three times the work.

    The two differ, with both signs, by a fraction of the image's maximum that falls as 1 / H, where H is the map's
    height: by about 5 % under one lamp on 16 x 8 pixels. For an R x R image the time grows with R^2 H, or R^2 (H + W)
    for ``areas``, plus the map's pixels, rather than with R^2 times the map's pixels. A map that is already on the
    device, such as ``Distribution.map``, is not uploaded again. See :func:`shade` for the image. Raises
    :class:`LightdomeError` for a resolution outside 1 to 16384, and for any other ``pixels``.
    """
    of_map = DeviceMap.of(device, envmap)
    resolution, albedo = check_resolution(resolution), checks.albedo(albedo)
    checks.choice("pixels", pixels, PIXELS)
    areas = pixels == "areas"
    if areas:
        of_map = _split(of_map)
    height, width, scale = of_map.height, of_map.width, of_map.scale
    rows = memory.upload(device, area_moments(height, width)) if areas else of_map.theta
    row_weight = memory.upload(device, (scale / np.pi * of_map.solid_angles).astype(np.float32))
    half_arc = None if areas else memory.upload(device, _half_arcs(of_map.row_angles, width, resolution))
    lanes = device.vector_width
    pixels_across, pixels_down = GPU_PATCH if device.is_gpu else (lanes, 1)
    tiles = disc_tiles(resolution, pixels_across, pixels_down)
    tile_buffer = memory.upload(device, tiles)
    line = (width + 1) // 2 + width + 1
    grey = of_map.is_grey
    if grey:
        device.decisions.skip("separate channels", "the map is grey")
    else:
        device.decisions.use("separate channels", "the map is in colour")
    note_tiles(device.decisions, tiles, resolution, pixels_across, pixels_down)
    word = 4 if grey else 12 if device.is_gpu else 16  # floats
    most = GPU_ARCS_BYTES if device.is_gpu else ARCS_BYTES
    band = max(2, min(height, height if device.is_gpu and not areas else ARCS_ROWS, most // (8 * word * line)))
    arcs = memory.empty(device, (band, line, 2, word), np.float32)
    total = memory.zeros(device, (2, resolution, resolution, 3), np.float32)

    defines = {"GREY": 1} if grey else {}
    with Progress("summing the map") as progress:
        for first in range(0, height, band):
            count = min(band, height - first)
            device.launch_rows(
                "lighting/arc_sums",
                count,
                stage="arc sums",
                defines=defines,
                radiance=of_map.radiance,
                theta=rows,
                phi=of_map.phi,
                row_weight=row_weight,
                width=width,
                first=first,
                arcs=arcs,
            )
            of_rows: dict[str, Any]
            if half_arc is None:
                tables = horizon_tables(resolution, height, width, first, count)
                bounds, start, polynomials = (memory.upload(device, table) for table in tables)
                of_rows = {
                    "radiance": of_map.radiance,
                    "scale": scale,
                    "bounds": bounds,
                    "start": start,
                    "polynomials": polynomials,
                }
            else:
                of_rows = {"half_arc": half_arc, "height": height}
            device.launch(
                KERNELS[pixels],
                (len(tiles) * (pixels_across * pixels_down // lanes),),
                group=pixels_across * pixels_down if device.is_gpu else None,
                stage="exact",
                defines={"WIDTH": lanes, **defines},
                arcs=arcs,
                width=width,
                first=first,
                rows=count,
                resolution=resolution,
                tiles=tile_buffer,
                sum=total,
                **of_rows,
            )
            device.wait()
            progress.update((first + count) / height)
    image = np.add(*memory.download(device, total), dtype=np.float64)
    image *= albedo / scale
    return to_float32(image)


def _split(of_map: DeviceMap) -> DeviceMap:
    """The same light on at least LEAST_SHAPE pixels: a pixel is split into parts that have its radiance."""
    envmap, values = of_map.envmap, of_map.envmap.radiance
    for axis, least in enumerate(LEAST_SHAPE):
        if values.shape[axis] < least:
            values = np.repeat(values, -(-least // values.shape[axis]), axis=axis)
    if values is envmap.radiance:
        return of_map
    split = checks.made(EnvironmentMap, radiance=values, peak=envmap.peak, replaced=None, notes=())
    return DeviceMap.of(of_map.device, split)


def _half_arcs(theta: np.ndarray, width: int, resolution: int) -> np.ndarray:
    """Half the arc of each map row above the horizon of an image row's normals, in columns: (R, H) float32."""
    n_y = (resolution - 2.0 * np.arange(resolution) - 1) / resolution
    q = -(n_y / np.sqrt(1 - n_y**2))[:, None] / np.tan(theta)
    return (np.arccos(np.clip(q, -1, 1)) * (width / (2 * np.pi))).astype(np.float32)
