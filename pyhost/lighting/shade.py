"""The diffuse unit sphere, seen by an orthographic camera along omega_o = (0, 0, 1), under directional lights.

Pixel (i, j) of an R x R image has n_x = (2i + 1 - R) / R, n_y = (R - 2j - 1) / R and
n_z = sqrt(1 - n_x^2 - n_y^2); image x to the right is +x, image y upward is +y. The surface is
convex, so visibility is 1 and no ray is traced. Kernels: ``shade_tiles.cl`` with ``light_groups.cl`` on a CPU,
``shade_grouped.cl`` on a GPU; ``shade.cl`` is a CPU's brute force.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, Protocol

import numpy as np

from .. import checks
from ..disc import check_resolution, disc_tiles, note_tiles
from ..errors import LightdomeError
from ..float_range import LARGEST, light_exponent, to_float32
from ..maps.envmap import EnvironmentMap
from ..maps.geometry import solid_angles
from ..opencl import memory
from ..opencl.device import Device
from ..sampling.samples import Samples
from .exact import exact

LANES = 16  # pixels across a tile, and lights in a vector, see clkernels/lighting/shade_tiles.cl
TILE_ROWS = 16
GPU_TILE = 8, 32  # pixels across and down that a group of work-items shares, see clkernels/lighting/shade_grouped.cl
PAIRS_PER_LAUNCH = 2**33  # pixels x lights between two updates of the progress line
SAMPLES_PER_ROW = 320  # samples per map row above which shading the summed map is faster

_tiles = lru_cache(maxsize=1)(disc_tiles)  # successive images usually share them


class HasLights(Protocol):
    """Anything with a ``direction`` and a ``flux`` for each of N lights: :class:`Lights`, :class:`Samples`."""

    @property
    def direction(self) -> np.ndarray:
        """(N, 3) unit vectors towards the lights."""

    @property
    def flux(self) -> np.ndarray:
        """(N, 3), radiance x steradian."""


def shade(
    device: Device,
    direction: np.ndarray | HasLights,
    flux: np.ndarray | None = None,
    resolution: int = 511,
    albedo: float = 1.0,
    brute_force: bool = False,
) -> np.ndarray:
    """Light the sphere with N directional lights: the image is (R, R, 3) float32, radiance.

    - ``direction``: (N, 3) unit vectors towards the lights; or lights, which have both directions and fluxes
    - ``flux``: (N, 3) radiance x steradian, of each light; left out if ``direction`` is lights
    - ``brute_force``: evaluate every pair of pixel and light, for comparison; the image is the same up to rounding

    A pixel is albedo / pi times the sum of flux max(0, n . direction); outside the disc it is 0. Values above float32's
    largest number become that number.
    Raises :class:`LightdomeError` for a resolution outside 1 to 16384, an albedo that is negative or not finite,
    directions that are not unit vectors, fluxes that are negative or not finite, and a flux given as well as lights.
    """
    checks.instance("the device", device, Device)
    resolution, albedo = check_resolution(resolution), checks.albedo(albedo)
    brute_force = checks.flag("brute_force", brute_force)
    has_lights = hasattr(direction, "direction") and hasattr(direction, "flux")
    if has_lights and flux is not None:
        raise LightdomeError(
            f"lights have fluxes already, got {checks.told(flux)} too; name other arguments, as in resolution=255"
        )
    if flux is None and not has_lights:
        raise LightdomeError(f"expected lights, or directions and fluxes, got {checks.told(direction)} alone")
    of_lights = checks.lights(
        *(getattr(direction, name) for name in ("direction", "flux")) if has_lights else (direction, flux)
    )
    return _shade(device, *of_lights, resolution, albedo, brute_force)


def _shade(
    device: Device,
    direction: np.ndarray,
    flux: np.ndarray,
    resolution: int,
    albedo: float,
    brute_force: bool = False,
) -> np.ndarray:
    if len(direction) == 0:
        return np.zeros((resolution, resolution, 3), np.float32)
    # Whole channels, (3, N): numpy is slow on rows of three numbers.
    reflected = np.multiply(flux.T, albedo / np.pi, order="C")
    exponent = light_exponent(reflected.sum(axis=1).max())
    if exponent:
        reflected = np.ldexp(reflected, -exponent)
    defines = {}
    lights: dict[str, Any]
    if (reflected[1:] == reflected[0]).all():
        reflected = reflected[:1]
        device.decisions.skip("separate channels", "the lights are grey")
        defines["GREY"] = 1
    else:
        device.decisions.use("separate channels", "the lights are in colour")
    light = np.concatenate([direction.T, reflected], dtype=np.float32, casting="same_kind")
    # Allocated first, as the largest: if the device has no room for it, this fails at once.
    image = memory.zeros(device, (resolution, resolution, 3), np.float32)
    # A CPU skips pairs of pixel and light tile by tile; a GPU evaluates all of them.
    if brute_force or device.is_gpu:
        kernel, lights = "lighting/shade", {"light_count": len(direction)}
        if device.is_gpu:
            pixels, rows = GPU_TILE
            lights["lights"] = memory.upload(device, _padded(light.T))
        else:
            pixels, rows = LANES, 1
            defines = {"WIDTH": pixels, "ROWS": rows, **defines}
            lights["lights"] = memory.upload(device, light.T)
        why = "it was asked for" if brute_force else "a GPU's work-items share every light that they read"
        device.decisions.use("brute force over pairs of pixel and light", why)
    else:
        pixels, rows = LANES, TILE_ROWS
        lights = _grouped(device, light, defines)
        kernel, defines = "lighting/shade_tiles", {"ROWS": rows, **defines}
        why = "lights far from a tile's horizon are one matrix, or light nothing there"
        device.decisions.skip("brute force over pairs of pixel and light", why)
    tiles = _tiles(resolution, pixels, rows)
    note_tiles(device.decisions, tiles, resolution, pixels, rows)
    device.launch_rows(
        kernel,
        len(tiles),
        stage="shade",
        defines=defines,
        step=device.items_per_launch(PAIRS_PER_LAUNCH, len(direction) * pixels * rows),
        progress="shading the sphere",
        tiles=memory.upload(device, tiles),
        **lights,
        resolution=resolution,
        image=image,
    )
    result = memory.download(device, image)
    return to_float32(result, exponent) if exponent else result


def _padded(light: np.ndarray) -> np.ndarray:
    """Lights (N, 6), grey ones (N, 4), as ``shade_grouped.cl`` takes them: in vectors of 4 floats."""
    if light.shape[1] == 4:
        return light
    padded = np.zeros((len(light), 8), np.float32)
    padded[:, :3], padded[:, 4:7] = light[:, :3], light[:, 3:]
    return padded


def _grouped(device: Device, light: np.ndarray, defines: dict[str, int]) -> dict[str, Any]:
    """Lights (6, N), grey ones (4, N), as ``shade_tiles.cl`` takes them: sorted, with groups' bounds and matrices."""
    # The lower bits hold the light's index, so all keys differ, and every version of numpy gives the same order. numpy
    # sorts keys several times as fast as it finds their order.
    order = np.sort(_places(light[:3]) << 32 | np.arange(light.shape[1], dtype=np.int64)) & 0xFFFFFFFF
    count = -(-len(order) // LANES) * LANES
    rows = np.zeros((len(light), count), np.float32)
    rows[:, : len(order)] = np.take(light, order, axis=1)
    rows[:3, len(order) :] = light[:3, order[-1:]]  # padding: no flux, in the direction of the last light
    lights = memory.upload(device, rows)
    bounds = memory.empty(device, (count // LANES, 4), np.float32)
    groups = memory.empty(device, (count // LANES, 16), np.float32)
    device.launch(
        "lighting/light_groups",
        (count // LANES,),
        stage="light groups",
        defines=defines,
        lights=lights,
        stride=count,
        bounds=bounds,
        matrix=groups,
    )
    return {"lights": lights, "stride": count, "bounds": bounds, "groups": groups}


def _places(direction: np.ndarray) -> np.ndarray:
    """Keys (N,) that sort directions (3, N) along a curve through an octahedral map: neighbours stay together.

    Keys are int64, below 2^20.
    """
    x, up, y = direction
    length = np.abs(x) + np.abs(up) + np.abs(y)
    x, y, folded = x / length, y / length, up < 0
    x, y = (
        np.where(folded, (1 - np.abs(y)) * np.copysign(1, x), x),
        np.where(folded, (1 - np.abs(x)) * np.copysign(1, y), y),
    )
    across, down = (_SPREAD[((axis + 1) * 511.5).astype(np.int64)] for axis in (x, y))
    return across | down << 1


def _spread() -> np.ndarray:
    """Numbers of 10 bits with a zero before each bit, (1024,) int64."""
    bits = np.arange(1024, dtype=np.int64)
    for step, mask in ((8, 0x00FF00FF), (4, 0x0F0F0F0F), (2, 0x33333333), (1, 0x55555555)):
        bits = (bits | bits << step) & mask
    return bits


_SPREAD = _spread()


def shade_samples(device: Device, samples: Samples, resolution: int = 511, albedo: float = 1.0) -> np.ndarray:
    """Light the sphere with one set of samples for all pixels: unbiased, with an error that varies smoothly over it.

    With more than a few hundred samples per row of the map, most share a pixel with others. Samples at centres are then
    summed into a map, and the image is that map's :func:`exact` one. See :func:`shade` for the image and the errors
    raised.
    """
    checks.instance("the device", device, Device)
    checks.instance("samples", samples, Samples)
    resolution, albedo = check_resolution(resolution), checks.albedo(albedo)
    height, width = samples.map_shape
    a_light_each, why = "a light for each sample", f"there are fewer than {SAMPLES_PER_ROW} per row of the map"
    if samples.within == "pixel":
        why = "they lie anywhere in their pixels"
    elif len(samples) >= SAMPLES_PER_ROW * height:
        index = samples.pixel[:, 1].astype(np.int64) * width + samples.pixel[:, 0]
        flux = np.stack([np.bincount(index, of_channel, height * width) for of_channel in samples.flux.T], axis=1)
        radiance = flux.reshape(height, width, 3) / solid_angles(height, width)[:, None, None]
        if radiance.max() <= LARGEST:
            device.decisions.skip(a_light_each, "samples that share a pixel are summed on a map")
            radiance = radiance.astype(np.float32)
            envmap = checks.made(EnvironmentMap, radiance=radiance, peak=float(radiance.max()), replaced=None, notes=())
            return exact(device, envmap, resolution, albedo)
        why = "their sums on a map would leave float32's range"
    device.decisions.use(a_light_each, why)
    return _shade(device, samples.direction, samples.flux, resolution, albedo)
