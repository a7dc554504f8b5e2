"""Computes what a page shows. A single thread owns an :class:`Engine` and its device.

Shared samples, median cut and harmonics are computed for the map as stored in its file. Turning the light rotates only
their directions; nothing is resampled. Their exact image sums all pixels of the map as lights, rotated in the same way.
Estimators with samples for every pixel need tables of the turned map, :meth:`lightdome.EnvironmentMap.rotated`, and are
compared with that map's exact image. While the user drags, harmonics approximate the exact image.
"""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Generator, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import LightdomeError
from ..evaluation.metrics import exponent, relative_rmse
from ..lighting.exact import exact
from ..lighting.harmonics import Harmonics, project, shade_harmonics
from ..lighting.lights import Lights
from ..lighting.median_cut import median_cut, regions
from ..lighting.shade import shade
from ..maps.envmap import EnvironmentMap
from ..maps.geometry import column_angles, directions, row_angles, solid_angles
from ..maps.images import auto_exposure
from ..maps.rotation import rotation_matrix
from ..opencl.device import Device
from ..rendering.per_pixel import render
from ..sampling.distribution import Distribution, build_distribution
from .fallback import pictures_of
from .messages import CUT, HARMONICS, SHARED, Setting, halved, packed

STAND_IN = 12  # order of the harmonics that approximate the exact image
# Turns that bring +z, -z, +x, -x, +y and -y to the front. From these six images, a page can look up the approximation
# for any turn.
SIX_TURNS = ((0, 0), (180, 0), (-90, 0), (90, 0), (0, 90), (0, -90))
SIX_RESOLUTION = 127
KEPT_BYTES = 2**26  # of exact images
LIGHTS_AT_ONCE = 2**16  # pixels of a map, summed as lights in one step; other requests come in between steps
SHOWN_WIDTH = 2048  # widest map sent to a page, in pixels
MOST_REGIONS = 1024  # with more regions, outlines are not shown
# Counts for the plot of error against count.
COUNTS = {SHARED: (16, 64, 256, 1024, 4096, 16384), CUT: (16, 64, 256, 1024, 4096), HARMONICS: (1, 2, 4, 8, 12, 18, 24)}
SPP = (1, 2, 4, 8, 16, 32, 64)


class Kept:
    """Arrays by key, up to ``room`` bytes; the least recently used are dropped first."""

    def __init__(self, room: int) -> None:
        self.room, self.bytes = room, 0
        self._arrays: OrderedDict[object, np.ndarray] = OrderedDict()

    def get(self, key: object) -> np.ndarray | None:
        """The array of ``key``, now the most recently used, or None."""
        if key in self._arrays:
            self._arrays.move_to_end(key)
        return self._arrays.get(key)

    def put(self, key: object, array: np.ndarray) -> None:
        """Keep an array, and drop others if there is no room."""
        self.bytes += array.nbytes - (self._arrays[key].nbytes if key in self._arrays else 0)
        self._arrays[key] = array
        while self.bytes > self.room and len(self._arrays) > 1:
            self.bytes -= self._arrays.popitem(last=False)[1].nbytes


@dataclass(frozen=True, eq=False)
class Scene:
    """A map that a page may choose."""

    name: str
    arguments: str  # what follows --map on a command line
    distribution: Distribution
    harmonics: Harmonics
    exposures: tuple[float, float]  # automatic exposures of the map and of the sphere

    @property
    def envmap(self) -> EnvironmentMap:
        return self.distribution.envmap


@dataclass
class Sent:
    """What has already been sent to a page, by key."""

    lights: object = None
    reference: object = None
    followed: object = None
    is_exact: bool = False  # the last picture was compared with the exact image


@dataclass(frozen=True, eq=False)
class Image:
    """A method's image, its time in total and on the device, and its lights if all pixels share them."""

    pixels: np.ndarray
    seconds: float
    device_seconds: float
    lights: Lights | None


class Engine:
    """Answers the pages' requests about some maps, on one device."""

    def __init__(self, device: Device, maps: list[tuple[str, str, EnvironmentMap]]) -> None:
        self.device = device
        self.exact_images = Kept(KEPT_BYTES)
        self._turned: tuple[object, Distribution] | None = None
        self._lights: tuple[object, Lights | Harmonics] | None = None
        self.scenes = [self._scene(*each) for each in maps]

    def _scene(self, name: str, arguments: str, envmap: EnvironmentMap) -> Scene:
        distribution = build_distribution(self.device, envmap)
        harmonics = project(self.device, distribution.map, STAND_IN)
        of_sphere = np.maximum(shade_harmonics(self.device, harmonics, 63), 0)
        return Scene(
            name, arguments, distribution, harmonics, (auto_exposure(envmap.radiance), auto_exposure(of_sphere))
        )

    # ---- answers ----

    def map(self, number: int) -> bytes:
        """A map for a page to draw: half floats, reduced if it is wider than SHOWN_WIDTH."""
        scene = self.scenes[number]
        envmap = scene.envmap
        step = -(-envmap.width // SHOWN_WIDTH)
        shown = envmap.radiance
        if step > 1:
            across = np.add.reduceat(shown, np.arange(0, envmap.width, step), axis=1, dtype=np.float32)
            shown = np.add.reduceat(across, np.arange(0, envmap.height, step), axis=0, dtype=np.float32) / step**2
        header = {
            "kind": "map",
            "map": number,
            "name": scene.name,
            "width": envmap.width,
            "height": envmap.height,
            "peak": envmap.peak,
            "exposures": scene.exposures,
            "notes": [note for note in (*envmap.notes, envmap.shape_note) if note],
        }
        turned = (scene.harmonics.rotated(*angles) for angles in SIX_TURNS)
        six = [np.maximum(shade_harmonics(self.device, each, SIX_RESOLUTION), 0) for each in turned]
        return packed(header, {"map": halved(shown), "six": halved(np.concatenate(six, axis=1))})

    def frame(self, setting: Setting, sent: Sent) -> bytes:
        """The picture of a setting: a method's image, and the exact image unless the page already has it."""
        begin = time.perf_counter()
        image = self._image(setting)
        key = _exact_key(setting)
        exact_image = self.exact_images.get(key)
        reference = self._stand_in(setting) if exact_image is None else exact_image
        sent.is_exact = exact_image is not None
        header: dict[str, Any] = {
            "kind": "frame",
            "is_exact": sent.is_exact,
            "numbers": self._numbers(setting, image.pixels, reference),
            "method_ms": 1e3 * image.seconds,
            "device_ms": 1e3 * image.device_seconds,
        }
        arrays: dict[str, Any] = {}
        if setting.pictures:
            scene = self.scenes[setting.map]
            truth = reference * np.float32(setting.albedo)
            arrays = pictures_of(scene.envmap, scene.exposures, setting, image.pixels, truth, image.lights)
        else:
            arrays["image"] = halved(image.pixels) if setting.is_moving else image.pixels
            if exact_image is not None and key != sent.reference:
                arrays["reference"] = exact_image
                sent.reference = key
            lights_key = (setting.map, setting.method, setting.sequence, setting.count, setting.seed)
            if lights_key != sent.lights:
                arrays |= self._marks(setting, image.lights)
            sent.lights = lights_key
        header["server_ms"] = 1e3 * (time.perf_counter() - begin)
        return packed(header, arrays)

    def rest(self, setting: Setting, sent: Sent) -> Generator[bytes | None, None, None]:
        """What follows when the user stops moving: the exact image, then the error by count.

        The work may be abandoned after any step. A step without an answer yields None.
        """
        key = _exact_key(setting)
        reference = self.exact_images.get(key)
        if reference is None:
            for reference in self._exact_steps(setting):  # noqa: B007
                yield None
            assert reference is not None
            self.exact_images.put(key, reference)
        if setting.pictures and not sent.is_exact:
            yield self.frame(setting, sent)
        elif not sent.is_exact:
            image = self._image(setting)
            header = {
                "kind": "exact",
                "numbers": self._numbers(setting, image.pixels, reference),
                "method_ms": 1e3 * image.seconds,
                "device_ms": 1e3 * image.device_seconds,
            }
            sent.reference, sent.is_exact = key, True
            yield packed(header, {"reference": reference})
        followed = (key, setting.method, setting.sequence, setting.seed)
        if sent.followed != followed:
            points: list[tuple[int, float]] = []
            for count, rmse in self._errors(setting, reference):
                points.append((count, rmse))
                yield None
            sent.followed = followed
            counts, errors = [count for count, _ in points], [rmse for _, rmse in points]
            slope = None if setting.method == HARMONICS else exponent(counts, errors)
            yield packed({"kind": "followed", "counts": counts, "rmse": errors, "slope": slope}, {})

    # ---- images ----

    def _image(self, setting: Setting) -> Image:
        if setting.is_per_pixel:
            self._distribution(setting)  # turning the map must not count as the method's time
        while True:
            built = len(self.device.programs.built)
            self.device.profile.clear()
            begin = time.perf_counter()
            lights: Lights | None = None
            if setting.is_per_pixel:
                pixels = self._rendered(setting, setting.count)
            else:
                made = self._made(setting)
                turned = made.rotated(*setting.angles)
                if isinstance(turned, Harmonics):
                    pixels = shade_harmonics(self.device, turned, setting.resolution, setting.albedo)
                else:
                    pixels = shade(self.device, turned, resolution=setting.resolution, albedo=setting.albedo)
                    lights = made if isinstance(made, Lights) else None
            seconds = time.perf_counter() - begin
            stages = self.device.profile.seconds()
            if len(self.device.programs.built) == built:  # otherwise the time includes the compiler's, so measure again
                break
        self.device.decisions.take()
        on_device = sum(time for stage, time in stages.items() if stage not in ("upload", "download"))
        return Image(pixels, seconds, on_device, lights)

    def _made(self, setting: Setting) -> Lights | Harmonics:
        """The lights or harmonics of a setting, unturned; the last are kept while the user drags."""
        key = (setting.map, setting.method, setting.sequence, setting.count, setting.seed)
        if setting.is_moving and self._lights and self._lights[0] == key:
            return self._lights[1]
        distribution = self.scenes[setting.map].distribution
        made: Lights | Harmonics
        if setting.method == HARMONICS:
            made = project(self.device, distribution.map, setting.count)
        elif setting.method == CUT:
            made = median_cut(distribution, setting.count)
        else:
            made = Lights.of(distribution.sample(setting.count, setting.seed, setting.sequence))
        self._lights = key, made
        return made

    def _distribution(self, setting: Setting) -> Distribution:
        """The distribution of the turned map."""
        key = setting.map, setting.angles
        if self._turned is None or self._turned[0] != key:
            of_map = self.scenes[setting.map].distribution
            turned = of_map.envmap.rotated(*setting.angles)
            self._turned = key, of_map if turned is of_map.envmap else build_distribution(self.device, turned)
        return self._turned[1]

    def _rendered(self, setting: Setting, spp: int) -> np.ndarray:
        ((_, pixels),) = render(
            self._distribution(setting),
            [spp],
            setting.resolution,
            setting.albedo,
            setting.seed,
            setting.method,
            setting.sequence,
        )
        return pixels

    def _stand_in(self, setting: Setting) -> np.ndarray:
        turned = self.scenes[setting.map].harmonics.rotated(*setting.angles)
        return np.maximum(shade_harmonics(self.device, turned, setting.resolution), 0)

    def _exact_steps(self, setting: Setting) -> Iterator[np.ndarray | None]:
        """Yield None after each step of the work, then the exact image with albedo 1."""
        if setting.is_per_pixel:
            of_map = self._distribution(setting).map
            yield exact(self.device, of_map, setting.resolution, pixels=setting.pixels)  # type: ignore[arg-type]
            return
        envmap = self.scenes[setting.map].envmap
        total = np.zeros((setting.resolution, setting.resolution, 3))
        for direction, flux in pixel_lights(envmap, setting.angles):
            total += shade(self.device, direction, flux, setting.resolution)
            yield None
        yield total.astype(np.float32)

    def _errors(self, setting: Setting, reference: np.ndarray) -> Iterator[tuple[int, float]]:
        """Each count, and the relative RMSE of the setting's method with it."""
        if setting.is_per_pixel:
            images = render(
                self._distribution(setting),
                SPP,
                setting.resolution,
                1.0,
                setting.seed,
                setting.method,
                setting.sequence,
            )
            for spp, image in images:
                yield spp, relative_rmse(image, reference)
            return
        distribution = self.scenes[setting.map].distribution
        for count in COUNTS[setting.method]:
            if setting.method == HARMONICS:
                harmonics = project(self.device, distribution.map, count).rotated(*setting.angles)
                image = shade_harmonics(self.device, harmonics, setting.resolution)
            else:
                lights = (
                    median_cut(distribution, count)
                    if setting.method == CUT
                    else Lights.of(distribution.sample(count, setting.seed, setting.sequence))
                )
                image = shade(self.device, lights.rotated(*setting.angles), resolution=setting.resolution)
            yield count, relative_rmse(image, reference)

    # ---- the rest of an answer ----

    @staticmethod
    def _numbers(setting: Setting, image: np.ndarray, reference: np.ndarray) -> dict[str, float | None]:
        truth = reference if setting.albedo == 1 else reference * np.float32(setting.albedo)
        difference, brightest = image - truth, float(truth.max())
        return {
            "rmse": relative_rmse(image, truth) if brightest > 0 else None,
            "largest": float(max(difference.max(), -difference.min())),
            "brightest": brightest,
        }

    def _marks(self, setting: Setting, lights: Lights | None) -> dict[str, np.ndarray]:
        """Directions, before the turn, and sizes of the marks on the map, and outlines of regions."""
        arrays: dict[str, np.ndarray] = {"direction": np.zeros((0, 3), np.float32), "size": np.zeros(0, np.float32)}
        if lights is not None:
            light = lights.flux.sum(axis=1)
            mean = light.mean()
            arrays = {
                "direction": lights.direction,
                "size": np.sqrt(light / mean if mean > 0 else light).astype(np.float32),
            }
        arrays["regions"] = np.zeros((0, 4), np.int32)
        if setting.method == CUT and setting.count <= MOST_REGIONS:
            arrays["regions"] = regions(self.scenes[setting.map].distribution, setting.count).astype(np.int32)
        return arrays

    def lights(self, setting: Setting) -> Lights:
        """The lights of a setting, turned; raises :class:`LightdomeError` for a method that has none."""
        if setting.is_per_pixel or setting.method == HARMONICS:
            raise LightdomeError("this method has no lights shared by all pixels; choose shared samples or median cut")
        made = self._made(setting)
        assert isinstance(made, Lights)
        return made.rotated(*setting.angles)


def _exact_key(setting: Setting) -> object:
    return "exact", setting.map, setting.angles, setting.resolution, setting.is_per_pixel and setting.pixels


def pixel_lights(envmap: EnvironmentMap, angles: tuple[float, float, float]) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Every pixel that is not black, as a light turned by ``angles``: directions and fluxes (N, 3), in batches."""
    matrix = rotation_matrix(*angles)
    theta, phi = row_angles(envmap.height), column_angles(envmap.width)
    area = solid_angles(envmap.height, envmap.width)
    rows = max(1, LIGHTS_AT_ONCE // envmap.width)
    for first in range(0, envmap.height, rows):
        part = slice(first, first + rows)
        direction = directions(theta[part, None], phi) @ matrix.T
        flux = envmap.radiance[part] * area[part, None, None]
        lit = flux.any(axis=2)
        yield direction[lit].astype(np.float32), flux[lit]
