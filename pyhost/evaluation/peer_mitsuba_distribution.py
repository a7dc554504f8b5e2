"""Mitsuba 3's ``DiscreteDistribution2D`` on the stability table's maps, in a process of its own.

It gets luminance x sin(theta) in float32 and is asked for p of all pixels and for draws, in ``llvm_ad_rgb``.
The process is there for the same reason as in :mod:`lightdome.evaluation.peer_mitsuba`: its LLVM may abort.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, TimeoutError
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import Any

import numpy as np

from .. import reference
from ..checks import made
from ..disc import disc_mask
from ..errors import LightdomeError
from ..interrupts import Unheard
from ..maps.geometry import column_angles, row_angles, solid_angles
from ..sampling.samples import Samples
from .peer_mitsuba import MIN_LLVM, installed
from .peers import INSTALL

TIMEOUT = 300.0


class Mitsuba:
    """The process; :meth:`sampler` gives one for a map. Make it with :func:`start`."""

    def __init__(self, pool: ProcessPoolExecutor) -> None:
        self._pool = pool
        self.about: dict[str, object] = self.call(_start)

    def sampler(self, radiance: np.ndarray) -> MitsubaSampler:
        """A :class:`lightdome.evaluation.stability.Sampler`.

        Raises :class:`LightdomeError` where Mitsuba fails or ends.
        """
        return MitsubaSampler(self, radiance)

    def call(self, function: Any, *arguments: object) -> Any:
        """``function(*arguments)`` in the process; a failure there is one line here."""
        try:
            with Unheard():  # the first call starts the process, and Ctrl-C goes to the whole group
                answer = self._pool.submit(function, *arguments)
            return answer.result(TIMEOUT)
        except BrokenProcessPool:
            raise LightdomeError("Mitsuba's process ended; its LLVM may not fit this machine") from None
        except LightdomeError:
            raise
        except TimeoutError:
            for process in multiprocessing.active_children():
                process.kill()
            raise LightdomeError(f"Mitsuba did not answer in {TIMEOUT:.0f} s") from None
        except Exception as error:
            raise LightdomeError(f"{type(error).__name__}: {error}".splitlines()[0]) from error


@contextmanager
def start() -> Iterator[Mitsuba]:
    """Start the process; it ends with the block. Raises :class:`LightdomeError` where Mitsuba does not work."""
    if not installed():
        raise LightdomeError(INSTALL)
    # Not forked: a copy of OpenCL's threads and locks would be broken.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, context) as pool:
        yield Mitsuba(pool)


class MitsubaSampler:
    """Mitsuba's distribution of one map, as a :class:`lightdome.evaluation.stability.Sampler`."""

    def __init__(self, mitsuba: Mitsuba, radiance: np.ndarray) -> None:
        self._mitsuba = mitsuba
        self._radiance = radiance
        height, width = radiance.shape[:2]
        weights = np.empty((height, width), np.float32)
        for row, weight, theta in zip(radiance, weights, row_angles(height), strict=True):
            weight[:] = row.sum(axis=1, dtype=np.float64) / 3 * np.sin(theta)
        total = mitsuba.call(_build, weights)
        self.flux = total * solid_angles(height, width)[0] / np.sin(row_angles(height)[0])

    def probability(self, rows: slice) -> np.ndarray:
        """p(x, y) of whole rows, (n, W)."""
        p: np.ndarray = self._mitsuba.call(_probability, rows.start, rows.stop, self._radiance.shape[1])
        return p

    def draw(self, count: int, seed: int) -> Samples:
        """``count`` samples of points that numpy draws, 24 bits each."""
        height, width = self._radiance.shape[:2]
        x, y, p = self._mitsuba.call(_draw, count, seed)
        sine = np.sin(row_angles(height))[y]
        direction = np.stack(
            [
                sine * np.cos(column_angles(width))[x],
                np.cos(row_angles(height))[y],
                sine * np.sin(column_angles(width))[x],
            ],
            axis=1,
        )
        return made(  # unchecked: whether they are right is the question
            Samples,
            direction=direction.astype(np.float32),
            radiance=self._radiance[y, x],
            probability=p,
            pixel=np.stack([x, y], axis=1).astype(np.int32),
            map_shape=(height, width),
        )

    def image(self, samples: Samples, resolution: int) -> np.ndarray:
        """The sphere in the light of the samples, shaded by numpy in float64."""
        image = np.zeros((resolution, resolution, 3))
        mask = disc_mask(resolution)
        normals = reference.normals(resolution)[mask]
        image[mask] = reference.shade(normals, samples.direction, samples.radiance.astype(np.float64), samples.density)
        return image


# ---- in the process ----

_state: dict[str, Any] = {}


def _start() -> dict[str, object]:
    import drjit
    import mitsuba

    if not drjit.has_backend(drjit.JitBackend.LLVM) or drjit.detail.llvm_version()[0] < MIN_LLVM:
        raise LightdomeError(f"needs LLVM {MIN_LLVM} or newer; set DRJIT_LIBLLVM_PATH to its libLLVM.so")
    mitsuba.set_variant("llvm_ad_rgb")
    mitsuba.set_log_level(mitsuba.LogLevel.Error)
    mitsuba.DiscreteDistribution2D(np.ones((2, 2), np.float32)).pdf(mitsuba.Point2u(0, 0))
    return {"mitsuba": mitsuba.__version__, "llvm": ".".join(map(str, drjit.detail.llvm_version()))}


def _build(weights: np.ndarray) -> float:
    """Build the distribution; the total weight, from what the brightest pixel's two values say of it."""
    import mitsuba

    _state["distribution"] = distribution = mitsuba.DiscreteDistribution2D(weights)
    y, x = np.unravel_index(weights.argmax(), weights.shape)
    at = mitsuba.Point2u(int(x), int(y))
    with np.errstate(all="ignore"):
        return float(np.float64(distribution.eval(at)[0]) / np.float64(distribution.pdf(at)[0]))


def _probability(first: int, last: int, width: int) -> np.ndarray:
    import mitsuba

    y, x = np.mgrid[first:last, 0:width].astype(np.uint32)
    p = np.array(_state["distribution"].pdf(mitsuba.Point2u(x.ravel(), y.ravel())))
    return np.broadcast_to(p, y.size).reshape(y.shape)


def _draw(count: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    import mitsuba

    u = np.random.default_rng(seed).random((2, count), dtype=np.float32)
    at, p, _ = _state["distribution"].sample(mitsuba.Point2f(u[0], u[1]))
    # Dr.Jit keeps what is the same for all, the only row of a map say, as one value.
    x, y, p = (np.broadcast_to(np.array(v), count) for v in (at.x, at.y, p))
    return x, y, p
