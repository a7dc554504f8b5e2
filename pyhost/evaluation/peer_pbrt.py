"""PBRT as a peer: the scenes of :mod:`lightdome.pbrt.run`, timed as processes.

A run's time is that of PBRT's process and of reading its image, minus the program's start-up, which is the time that it
takes for an empty scene and is recorded separately. The rest has two stages. In ``scene``, PBRT reads the map from a
file and builds its distribution; this is the time for an image of one pixel and one sample. In ``render``, it renders
and writes the image. The clock resolves about 0.05 s. PBRT's own report of its rendering time is not used: with its
progress display on, it ends up to a second late.

The map is written beforehand (for PBRT-v4 as an equal-area square), which is not part of the time.
"""

from __future__ import annotations

import shutil
import statistics
import tempfile
import time
import weakref
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ..files import replacing
from ..maps.envmap import EnvironmentMap
from ..pbrt.run import Pbrt, find_pbrt, render_scene
from ..pbrt.scenes import Scene, scene_text, write_scenes

STARTS = 3


class PbrtPeer:
    """A PBRT program, and a folder with the map that is removed with the object.

    ``PbrtPeer(path, envmap)`` uses the program that :func:`lightdome.pbrt.find_pbrt` finds for ``path``, and raises the
    same errors.
    """

    def __init__(self, path: str | Path | None, envmap: EnvironmentMap) -> None:
        self.program: Pbrt = find_pbrt(path)
        self.startup_seconds: float = _median_seconds(lambda: find_pbrt(self.program.path))  # renders an empty scene
        self._folder = Path(tempfile.mkdtemp(prefix="lightdome-"))
        weakref.finalize(self, shutil.rmtree, self._folder, ignore_errors=True)
        (first,) = write_scenes(self._folder, envmap, [1], versions=[self.program.version])
        self._exponent = first.exponent
        self._scene_seconds = max(_median_seconds(lambda: self._process(1, 1, 0)) - self.startup_seconds, 0.0)

    def render(self, resolution: int, spp: int, seed: int) -> tuple[np.ndarray, dict[str, float]]:
        """The image (R, R, 3) float32 and the seconds of its stages, without start-up; version 3 ignores ``seed``.

        Raises :class:`LightdomeError` if PBRT fails.
        """
        start = time.perf_counter()
        image = self._process(resolution, spp, seed)
        seconds = max(time.perf_counter() - start - self.startup_seconds, 0.0)
        scene = min(self._scene_seconds, seconds)
        return image, {"scene": scene, "render": seconds - scene}

    def _process(self, resolution: int, spp: int, seed: int) -> np.ndarray:
        version = self.program.version
        scene = Scene(self._folder / "peer.pbrt", version, spp, resolution, self._exponent)
        text = scene_text(version, spp, resolution, seed=seed, exponent=self._exponent)
        with replacing(scene.path) as temporary:
            temporary.write_text(text, encoding="ascii")
        return render_scene(self.program, scene, quiet=True)


def _median_seconds(run: Callable[[], object]) -> float:
    """The median wall time of :data:`STARTS` runs, in seconds."""
    seconds = []
    for _ in range(STARTS):
        start = time.perf_counter()
        run()
        seconds.append(time.perf_counter() - start)
    return statistics.median(seconds)
