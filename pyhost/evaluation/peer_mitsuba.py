"""Mitsuba 3 as a peer: the same sphere, rendered in a separate process (:mod:`lightdome.evaluation.mitsuba_process`).

The map. In Mitsuba +y is up, as in lightdome, but column 0 looks along -z instead of +x: a quarter turn,
``rotate([0, 1, 0], -90)``, and no mirror. Mitsuba interpolates between the centres of columns, as expected, but spreads
the rows from pole to pole: row y of H is at theta = pi y / (H - 1), where lightdome's is at pi (y + 1/2) / H. So it is
given 2 H + 1 rows, which lie on the centres and edges of all our rows. Each edge row is the mean of its two neighbours,
so interpolation between Mitsuba's rows equals interpolation between ours.

The camera. Mitsuba spreads a pixel's samples over the whole pixel, so at the rim some miss the sphere and darken the
pixel: about 2 % relative RMSE at 127 x 127, however many samples. A larger sphere far behind catches them, with normals
that continue beyond the sphere's rim.

The integrator is ``direct`` with one light sample and one BSDF sample. The sampler is ``multijitter``, on Grace the
best of Mitsuba's for its number of samples: at 64 its relative RMSE is 5.6 %, compared with 13.1 % for ``independent``.
It rounds up counts that it cannot arrange, such as 32 to 35. Time and error are those of the samples it took, and
``about`` records their number.

Sources: https://mitsuba.readthedocs.io, plug-ins ``envmap``, ``orthographic``, ``direct``, ``multijitter``.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from ..disc import disc_mask
from .mitsuba_process import MitsubaProcess, use_variant

VARIANTS = ("scalar_rgb", "llvm_ad_rgb")
FAR_BEHIND = 100.0


def between_poles(radiance: np.ndarray) -> np.ndarray:
    """The map (H, W, 3) as the (2 H + 1, W, 3) rows that Mitsuba spreads from pole to pole; W is at least 2."""
    height = len(radiance)
    rows = np.empty((2 * height + 1, *radiance.shape[1:]), np.float32)
    rows[1::2] = radiance
    rows[2:-1:2] = radiance[:-1] / 2 + radiance[1:] / 2
    rows[0], rows[-1] = radiance[0], radiance[-1]
    return np.repeat(rows, 2, axis=1) if radiance.shape[1] < 2 else rows


class MitsubaRenderer:
    """Mitsuba with a map, which renders the sphere under it with one of :data:`VARIANTS`.

    ``MitsubaRenderer(variant, radiance)`` raises :class:`LightdomeError` if Mitsuba is missing or does not work, and
    for ``llvm_ad_rgb`` also without LLVM 17 or newer. Its process ends with the object. ``about`` describes what runs:
    the version, LLVM, threads, the seconds of its start (including a first, small image), and for each number of
    samples requested, how many were taken per pixel.
    """

    def __init__(self, variant: str, radiance: np.ndarray) -> None:
        self.variant = variant
        start = time.perf_counter()
        self._process = MitsubaProcess(SphereWorker, variant, between_poles(radiance))
        self._taken: dict[int, int] = {}
        self.about: dict[str, object] = {
            **self._process.about,
            "start-up seconds": time.perf_counter() - start,
            "samples per pixel": self._taken,
        }

    def render(self, resolution: int, spp: int, seed: int) -> tuple[np.ndarray, dict[str, float]]:
        """The image (R, R, 3) float32, 0 outside the disc, and the seconds of its stages by the process's clock.

        The stage ``scene`` goes from the map in memory to the scene with the map's distribution; ``render`` goes on to
        the image in memory. Transfers of the image between processes are not included. Raises :class:`LightdomeError`
        if Mitsuba fails, ends, or takes several hundred times as long as expected.
        """
        timeout = 300 + 2e-3 * spp * resolution**2
        image, stages, self._taken[spp] = self._process.call("draw", resolution, spp, seed, timeout=timeout)
        image[~disc_mask(resolution)] = 0
        return image, stages


# ---- in the process ----


class SphereWorker:
    """The map as Mitsuba's bitmap; renders a small image before it is ready."""

    def __init__(self, variant: str, rows: np.ndarray) -> None:
        self.about = use_variant(variant)
        import drjit
        import mitsuba

        self.about["threads"] = drjit.thread_count()
        self._bitmap = mitsuba.Bitmap(rows)
        self.draw(8, 1, 0)

    def draw(self, resolution: int, spp: int, seed: int) -> tuple[np.ndarray, dict[str, float], int]:
        """The image, the seconds of its stages, and the number of samples taken per pixel."""
        import mitsuba

        start = time.perf_counter()
        scene = mitsuba.load_dict(_scene(mitsuba, self._bitmap, resolution, spp))
        loaded = time.perf_counter()
        image = np.array(mitsuba.render(scene, seed=seed % 2**32), dtype=np.float32)
        stages = {"scene": loaded - start, "render": time.perf_counter() - loaded}
        return image, stages, scene.sensors()[0].sampler().sample_count()


def _scene(mitsuba: Any, bitmap: Any, resolution: int, spp: int) -> dict[str, object]:
    """The scene for ``mitsuba.load_dict``; ``bitmap`` holds the rows of :func:`between_poles`."""
    transform = mitsuba.ScalarTransform4f()
    white = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 1.0}}
    return {
        "type": "scene",
        "integrator": {"type": "direct", "emitter_samples": 1, "bsdf_samples": 1, "hide_emitters": True},
        "sensor": {
            "type": "orthographic",
            "to_world": transform.look_at(origin=[0, 0, 10], target=[0, 0, 0], up=[0, 1, 0]),
            "film": {
                "type": "hdrfilm",
                "width": resolution,
                "height": resolution,
                "rfilter": {"type": "box"},
                "pixel_format": "rgb",
                "component_format": "float32",
            },
            "sampler": {"type": "multijitter", "sample_count": spp},
        },
        "map": {"type": "envmap", "bitmap": bitmap, "to_world": transform.rotate([0, 1, 0], -90)},
        "sphere": {"type": "sphere", "bsdf": white},
        "rim": {"type": "sphere", "center": [0, 0, -FAR_BEHIND], "radius": 1 + 2 / resolution, "bsdf": white},
    }
