"""A set of directions drawn from an environment map: the interface between sampling and shading."""

from __future__ import annotations

import math
import warnings
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields
from functools import lru_cache
from pathlib import Path
from typing import Any, overload

import numpy as np

from .. import __version__, checks
from ..errors import LightdomeError, one_line
from ..files import replacing
from ..maps.geometry import column_angles, directions, row_angles, solid_angles
from ..maps.pictures import show_directions
from ..names import SEQUENCES as SEQUENCES
from ..names import WITHIN

MAX_SAMPLES = 2**27  # the most that a file may hold; 44 bytes each
# Arrays may be this many times the size of their file: `save` does not compress, and compressed samples stay far below
# it, but a zip bomb does not.
MAX_INFLATION = 64
MAX_SIDE = 2**20  # of a map
_solid_angles = lru_cache(maxsize=2)(solid_angles)  # many sets of samples come from one map
PER_SAMPLE = ("direction", "radiance", "probability", "pixel")  # arrays of samples


@dataclass(frozen=True, eq=False)
class Sample:
    """One of :class:`Samples`: ``direction`` and ``radiance`` (3,), ``probability``, and ``pixel`` (x, y)."""

    direction: np.ndarray
    radiance: np.ndarray
    probability: float
    pixel: np.ndarray


@dataclass(frozen=True, eq=False)
class Samples:
    """N samples of an environment map of ``map_shape`` = (H, W).

    - ``direction``: (N, 3) float32, unit vectors towards the light
    - ``radiance``: (N, 3) float32, of the chosen pixels
    - ``probability``: (N,) float32, the discrete p(x, y) of the chosen pixels
    - ``pixel``: (N, 2) int32, (x, y)
    - ``sequence``, ``seed``, ``version``: what drew them; with ``within``, all it takes to draw the same samples again
    - ``within``: where the directions lie: at the ``centre`` of the chosen pixels, or anywhere in the ``pixel``

    The arrays are read-only. ``Samples(...)`` copies them and raises :class:`LightdomeError` where they contradict
    each other.

    ``samples[3]`` is a :class:`Sample`, and iteration yields them. ``samples[:64]``, or an array of indices or of
    booleans, gives Samples: N is now 64, and so :attr:`flux` is that of a set of 64, while ``sequence`` and ``seed``
    stay those of the whole set. Samples are equal if all of their content is; they cannot be hashed.
    """

    direction: np.ndarray
    radiance: np.ndarray
    probability: np.ndarray
    pixel: np.ndarray
    map_shape: tuple[int, int]
    sequence: str = "independent"
    seed: int = 0
    version: str = __version__
    within: str = WITHIN[0]

    def __post_init__(self) -> None:
        pixel = checks.array("pixel", self.pixel, ("N", 2))
        if pixel.dtype.kind == "f":
            raise LightdomeError(f"pixel must be an array of whole numbers, got {pixel.dtype}")
        counts = [len(pixel)]
        for name, form in ("direction", ("N", 3)), ("radiance", ("N", 3)), ("probability", ("N",)):
            array = checks.array(name, getattr(self, name), form, np.float32, own=True)
            object.__setattr__(self, name, array)
            counts.append(len(array))
        if min(counts) < max(counts) or counts[0] == 0:
            raise LightdomeError(f"each array of samples must have the same length, one or more; got {counts}")
        shape = tuple(checks.wholes("map_shape", self.map_shape, 1, MAX_SIDE))
        if len(shape) != 2:
            raise LightdomeError(f"map_shape must be (height, width), got {checks.told(self.map_shape)}")
        object.__setattr__(self, "map_shape", shape)
        object.__setattr__(self, "seed", checks.whole("a seed", self.seed, 0, 2**64 - 1))
        for name in ("sequence", "version"):
            if not isinstance(getattr(self, name), str):
                raise LightdomeError(f"{name} must be a string, got {checks.told(getattr(self, name))}")
        checks.choice("place within a pixel", self.within, WITHIN)
        _check(self)
        object.__setattr__(self, "pixel", checks.array("pixel", pixel, ("N", 2), np.int32, own=True))

    def __len__(self) -> int:
        return len(self.probability)

    @overload
    def __getitem__(self, index: int) -> Sample: ...
    @overload
    def __getitem__(self, index: slice | np.ndarray) -> Samples: ...
    def __getitem__(self, index: int | slice | np.ndarray) -> Sample | Samples:
        if not isinstance(index, slice | np.ndarray):
            probability = float(self.probability[index])
            return Sample(self.direction[index], self.radiance[index], probability, self.pixel[index])
        parts = {name: np.ascontiguousarray(getattr(self, name)[index]) for name in PER_SAMPLE}
        if len(parts["probability"]) == 0:
            raise LightdomeError(f"a set of samples must hold one or more, got none of {len(self)}")
        return checks.made(Samples, **{**vars(self), **parts})

    def __iter__(self) -> Iterator[Sample]:
        return (self[n] for n in range(len(self)))

    def __eq__(self, other: object) -> bool:
        return checks.same(self, other)

    def __repr__(self) -> str:
        height, width = self.map_shape
        return f"<Samples: {len(self)} of a {width} x {height} map, {self.sequence}, seed {self.seed}, {self.within}>"

    def _repr_png_(self) -> bytes:
        return show_directions(self.direction, self.radiance)._repr_png_()

    @property
    def density(self) -> np.ndarray:
        """The density per solid angle, p(x, y) / solid angle of the pixel: (N,) float64, 1 / steradian.

        Directions anywhere in a pixel have exactly this density; one at a centre stands for its pixel's solid angle.
        """
        return self.probability.astype(np.float64) / _solid_angles(*self.map_shape)[self.pixel[:, 1]]

    @property
    def flux(self) -> np.ndarray:
        """The flux that each sample stands for, radiance / (N density): (N, 3) float64, RGB, radiance x steradian.

        The irradiance of a surface with normal n is the sum of flux max(0, n . direction).
        """
        return self.radiance / (len(self) * self.density[:, None])

    def save(self, path: str | Path) -> None:
        """Write the samples as ``.npz``; the file appears only when it is complete.

        Raises :class:`LightdomeError` if the file cannot be written, and for more than 2^27 samples, which :meth:`load`
        refuses.
        """
        check_count(len(self))
        arrays: dict[str, Any] = {f.name: np.asarray(getattr(self, f.name)) for f in fields(self)}
        arrays["map_shape"] = np.asarray(self.map_shape, dtype=np.int32)
        arrays["seed"] = np.asarray(self.seed, dtype=np.uint64)
        with replacing(checks.path(path)) as temporary:
            np.savez(temporary, **arrays)

    @classmethod
    def load(cls, path: str | Path) -> Samples:
        """Read samples that :meth:`save` wrote; pickles are never read.

        Raises :class:`LightdomeError` for a file that is missing, damaged, of another kind, or whose
        arrays contradict each other.
        """
        path = checks.path(path)
        arrays = _arrays(path)
        try:
            return cls(**arrays)
        except LightdomeError as error:
            raise LightdomeError(f"{path}: {error}") from error


def check_count(count: int) -> None:
    """Raise :class:`LightdomeError` for more samples than :meth:`Samples.load` would read."""
    if count > MAX_SAMPLES:
        raise LightdomeError(f"a file must hold {MAX_SAMPLES} samples or fewer, got {count}; use fewer samples")


# The arrays that a file must hold, and the kinds of their types.
_KINDS = {
    "direction": "f",
    "radiance": "f",
    "probability": "f",
    "pixel": "iu",
    "map_shape": "iu",
    "sequence": "U",
    "seed": "iu",
    "version": "U",
    "within": "U",
}


def _arrays(path: Path) -> dict[str, Any]:
    """The arrays of an ``.npz``; headers are checked first, so that a false one costs no memory."""
    arrays: dict[str, Any] = {}
    with _parsing(path):
        room = MAX_INFLATION * path.stat().st_size
        if not path.is_file():  # a pipe would block
            raise LightdomeError(f"cannot read {path}: it is not a regular file")
        with zipfile.ZipFile(path) as archive:
            for name, kinds in _KINDS.items():
                if f"{name}.npy" not in archive.namelist():
                    if name == "within":  # written by a version that had only centres
                        continue
                    raise LightdomeError(f"{path} is not a file of samples: it has no array {name!r}")
                member = archive.getinfo(f"{name}.npy")
                if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                    raise LightdomeError(f"{path}: the array {name!r} is compressed in a way that numpy never uses")
                with archive.open(member) as stream:
                    if np.lib.format.read_magic(stream) != (1, 0):
                        raise ValueError("unknown version of the array format")
                    shape, _, dtype = np.lib.format.read_array_header_1_0(stream)
                if dtype.kind not in kinds or (name == "map_shape" and shape != (2,)):
                    raise LightdomeError(f"{path}: the array {name!r} has the wrong type or shape, {one_line(dtype)}")
                if max(shape, default=1) > MAX_SAMPLES:
                    raise LightdomeError(f"{path} holds more than {MAX_SAMPLES} samples, the most that can be read")
                if not 0 <= math.prod(shape) * dtype.itemsize <= min(member.file_size, room):
                    raise LightdomeError(f"{path} is damaged: the array {name!r} is not as long as it says")
                with archive.open(member) as stream:
                    array = np.lib.format.read_array(stream, allow_pickle=False)
                arrays[name] = array if array.ndim else array.item()
    return arrays


@contextmanager
def _parsing(path: Path) -> Iterator[None]:
    """Report a damaged file in one line: the errors and warnings of zipfile, zlib and numpy have no common class."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            yield
    except (MemoryError, LightdomeError):
        raise
    except OSError as error:
        raise LightdomeError(f"cannot read {path}: {error.strerror or one_line(error)}") from error
    except Exception as error:
        raise LightdomeError(f"{path} is damaged or no .npz file: {one_line(error)}") from error


def _check(samples: Samples) -> None:
    """Refuse samples that contradict each other; each message names the first that does."""

    def refuse(bad: np.ndarray, what: str) -> None:
        if bad.any():
            raise LightdomeError(f"{what} (sample {int(np.argmax(bad))})")

    height, width = samples.map_shape
    x, y = samples.pixel[:, 0].astype(np.int64), samples.pixel[:, 1].astype(np.int64)
    refuse((x < 0) | (x >= width) | (y < 0) | (y >= height), "a pixel lies outside the map")
    p = samples.probability
    refuse(~((p > 0) & (p <= 1 + 1e-6)), "a probability is not in (0, 1]")
    L = samples.radiance
    refuse(~(np.isfinite(L) & (L >= 0)).all(axis=1), "a radiance is negative, infinite or NaN")
    theta, phi = row_angles(height)[y], column_angles(width)[x]
    if samples.within == "centre":
        expected = directions(theta, phi)
        refuse(~(np.abs(samples.direction - expected) < 1e-5).all(axis=1), "a direction is not that of its pixel")
    else:
        w_x, w_y, w_z = samples.direction.astype(np.float64).T
        sine = np.hypot(w_x, w_z)
        refuse(~(np.abs(np.hypot(sine, w_y) - 1) < 1e-5), "a direction is not a unit vector")
        down, across = np.arctan2(sine, w_y) - theta, np.arctan2(w_z, w_x) - phi
        across -= 2 * np.pi * np.round(across / (2 * np.pi))
        outside = (np.abs(down) > np.pi / height / 2 + 1e-5) | ((np.abs(across) - np.pi / width) * sine > 1e-5)
        refuse(outside, "a direction is not in its pixel")
