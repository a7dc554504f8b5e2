"""Mitsuba 3 as a peer: the same sphere, drawn in a process of its own.

The map. Mitsuba's +y is up like ours, but column 0 looks along -z where ours looks along +x: a quarter
turn, ``rotate([0, 1, 0], -90)``, and no mirror. It interpolates between the centres of columns, as one
would, but spreads the rows from pole to pole: row y of H lies at theta = pi y / (H - 1), ours at
pi (y + 1/2) / H. So it gets 2 H + 1 rows, which hit all our rows' centres and edges: every edge is the
mean of the rows that it parts, and interpolation between them is interpolation between our rows.

The camera. Mitsuba takes a pixel's samples all over the pixel, so at the rim some miss the sphere and
darken the pixel, some 2 % relative RMSE at 127 x 127 however many samples. A larger sphere far behind
catches them, with normals that go on where the sphere's end.

The integrator is ``direct`` with one light and one BSDF sample. The sampler is ``multijitter``, on Grace the
best of Mitsuba's for its number of samples: at 64, 5.6 % relative RMSE where ``independent`` has 13.1 %. It
rounds up counts that it cannot arrange, 32 to 35; time and error are those of what it took, and ``about``
keeps how many that was.

A process of its own, because an LLVM that Dr.Jit takes may still abort: LLVM 15 and 16 lack what Dr.Jit's
code needs on some processors. It draws a small image before it counts as there.

Sources: https://mitsuba.readthedocs.io, plug-ins ``envmap``, ``orthographic``, ``direct``, ``multijitter``.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import time
import weakref
from importlib.util import find_spec
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from ..disc import disc_mask
from ..errors import LightdomeError
from ..interrupts import Unheard

VARIANTS = ("scalar_rgb", "llvm_ad_rgb")
MIN_LLVM = 17
FAR_BEHIND = 100.0
START_TIMEOUT = 120.0


def installed() -> bool:
    """Whether the package ``mitsuba`` is there; imports nothing."""
    return find_spec("mitsuba") is not None


def between_poles(radiance: np.ndarray) -> np.ndarray:
    """The map (H, W, 3) as the (2 H + 1, W, 3) rows that Mitsuba spreads from pole to pole, W at least 2."""
    height = len(radiance)
    rows = np.empty((2 * height + 1, *radiance.shape[1:]), np.float32)
    rows[1::2] = radiance
    rows[2:-1:2] = radiance[:-1] / 2 + radiance[1:] / 2
    rows[0], rows[-1] = radiance[0], radiance[-1]
    return np.repeat(rows, 2, axis=1) if radiance.shape[1] < 2 else rows


class Mitsuba:
    """A process that holds a map and draws the sphere under it with one of :data:`VARIANTS`.

    ``Mitsuba(variant, radiance)`` raises :class:`LightdomeError` where Mitsuba, or for ``llvm_ad_rgb`` an
    LLVM of version 17 or newer, is missing or does not work. The process ends with the object.
    ``about`` says what runs: version, LLVM, threads, the seconds of its start with a first, small image, and
    the samples that it took a pixel by those that it was told.
    """

    def __init__(self, variant: str, radiance: np.ndarray) -> None:
        self.variant = variant
        start = time.perf_counter()
        # Not forked: a copy of OpenCL's threads and locks would be broken.
        context = multiprocessing.get_context("spawn")
        self._connection, theirs = context.Pipe()
        self._process = context.Process(target=_work, args=(theirs, variant), daemon=True)
        with Unheard():  # Ctrl-C goes to the whole group
            self._process.start()
        theirs.close()
        self._stop = weakref.finalize(self, _stop, self._process, self._connection)
        with contextlib.suppress(OSError):  # a process that has ended says why below
            self._connection.send(between_poles(radiance))
        self.about: dict[str, object] = self._receive(START_TIMEOUT)
        self.about["start-up seconds"] = time.perf_counter() - start
        self._taken: dict[int, int] = {}
        self.about["samples per pixel"] = self._taken

    def render(self, resolution: int, spp: int, seed: int) -> tuple[np.ndarray, dict[str, float]]:
        """The image (R, R, 3) float32, 0 outside the disc, and the seconds of its stages by the process's clock.

        ``scene`` is the scene with the map's distribution, from the map in memory; ``render`` goes on to the image
        in memory. What the image takes from process to process is no part of them. Raises
        :class:`LightdomeError` where Mitsuba fails, ends, or takes some hundred times what it should.
        """
        with contextlib.suppress(OSError):
            self._connection.send((resolution, spp, seed))
        image, stages, self._taken[spp] = self._receive(300 + 2e-3 * spp * resolution**2)
        image[~disc_mask(resolution)] = 0
        return image, stages

    def _receive(self, timeout: float) -> Any:
        try:
            answer = self._connection.recv() if self._connection.poll(timeout) else f"did not answer in {timeout:.0f} s"
        except (EOFError, OSError):
            self._process.join(10)
            code = self._process.exitcode
            answer = f"crashed (signal {-code})" if code is not None and code < 0 else f"ended with exit status {code}"
        if isinstance(answer, str):
            self._stop()
            raise LightdomeError(answer)
        return answer


def _stop(process: multiprocessing.process.BaseProcess, connection: Connection) -> None:
    connection.close()
    process.kill()
    process.join(10)


def _work(connection: Connection, variant: str) -> None:
    """The process: take the map, try a small image and say what runs, then draw; a text is an error."""
    # Dr.Jit and LLVM complain over many lines where a text says what is wrong.
    with Path(os.devnull).open("wb") as nowhere:
        os.dup2(nowhere.fileno(), 1)
        os.dup2(nowhere.fileno(), 2)
    try:
        rows = connection.recv()
        try:
            about, bitmap = _start(variant, rows)
        except Exception as error:
            connection.send(_line(error))
            return
        connection.send(about)
        while True:
            resolution, spp, seed = connection.recv()
            try:
                connection.send(_draw(bitmap, resolution, spp, seed))
            except Exception as error:
                connection.send(_line(error))
    except (EOFError, OSError):
        return  # the other side has gone


def _line(error: Exception) -> str:
    return (str(error) if isinstance(error, LightdomeError) else f"{type(error).__name__}: {error}").splitlines()[0]


def _start(variant: str, rows: np.ndarray) -> tuple[dict[str, object], Any]:
    import drjit
    import mitsuba

    about: dict[str, object] = {"mitsuba": mitsuba.__version__, "threads": drjit.thread_count()}
    if variant.startswith("llvm"):
        advice = "set DRJIT_LIBLLVM_PATH to its libLLVM.so"
        if not drjit.has_backend(drjit.JitBackend.LLVM):
            raise LightdomeError(f"needs LLVM {MIN_LLVM} or newer; {advice}")
        found = drjit.detail.llvm_version()
        about["llvm"] = ".".join(map(str, found))
        if found[0] < MIN_LLVM:
            raise LightdomeError(f"needs LLVM {MIN_LLVM} or newer and found {about['llvm']}; {advice}")
    mitsuba.set_variant(variant)
    mitsuba.set_log_level(mitsuba.LogLevel.Error)
    bitmap = mitsuba.Bitmap(rows)
    _draw(bitmap, 8, 1, 0)
    return about, bitmap


def _draw(bitmap: Any, resolution: int, spp: int, seed: int) -> tuple[np.ndarray, dict[str, float], int]:
    import mitsuba

    start = time.perf_counter()
    scene = mitsuba.load_dict(_scene(mitsuba, bitmap, resolution, spp))
    loaded = time.perf_counter()
    image = np.array(mitsuba.render(scene, seed=seed % 2**32), dtype=np.float32)
    stages = {"scene": loaded - start, "render": time.perf_counter() - loaded}
    return image, stages, scene.sensors()[0].sampler().sample_count()


def _scene(mitsuba: Any, bitmap: Any, resolution: int, spp: int) -> dict[str, object]:
    """The scene as ``mitsuba.load_dict`` takes it; ``bitmap`` holds the rows of :func:`between_poles`."""
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
