"""A set of directions drawn from an environment map: the interface between sampling and shading."""

from __future__ import annotations

import warnings
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from .. import __version__, checks
from ..errors import LightdomeError, one_line
from ..files import replacing
from ..maps.geometry import column_angles, directions, row_angles, solid_angles
from ..names import SEQUENCES as SEQUENCES

MAX_SAMPLES = 2**27  # what a file may hold; 44 bytes each
MAX_INFLATION = 64  # `save` packs nothing; what others packed is far from this, but a bomb is not
MAX_SIDE = 2**20  # of a map


@dataclass(frozen=True)
class Samples:
    """N samples of an environment map of ``map_shape`` = (H, W).

    - ``direction``: (N, 3) float32, unit vectors towards the light
    - ``radiance``: (N, 3) float32, of the chosen pixels
    - ``probability``: (N,) float32, the discrete p(x, y) of the chosen pixels
    - ``pixel``: (N, 2) int32, (x, y)
    - ``sequence``, ``seed``, ``version``: what drew them; the same three draw them again

    The arrays are read-only. ``Samples(...)`` copies them and raises :class:`LightdomeError` where they contradict
    each other.
    """

    direction: np.ndarray
    radiance: np.ndarray
    probability: np.ndarray
    pixel: np.ndarray
    map_shape: tuple[int, int]
    sequence: str = "independent"
    seed: int = 0
    version: str = __version__

    def __post_init__(self) -> None:
        pixel = checks.array("pixel", self.pixel, ("N", 2))
        if pixel.dtype.kind == "f":
            raise LightdomeError(f"pixel must be an array of whole numbers, got {pixel.dtype}")
        counts = [len(pixel)]
        for name in ("direction", "radiance", "probability"):
            array = checks.array(name, getattr(self, name), _FORMAT[name][1], np.float32, own=True)
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
        _check("samples", self)
        object.__setattr__(self, "pixel", checks.array("pixel", pixel, ("N", 2), np.int32, own=True))

    def __len__(self) -> int:
        return len(self.probability)

    @property
    def density(self) -> np.ndarray:
        """The density per solid angle, p(x, y) / solid angle of the pixel: (N,) float64, 1 / steradian."""
        return self.probability.astype(np.float64) / solid_angles(*self.map_shape)[self.pixel[:, 1]]

    @property
    def flux(self) -> np.ndarray:
        """What each sample stands for, radiance / (N density): (N, 3) float64, radiance x steradian.

        The irradiance of a surface with normal n is the sum of flux max(0, n . direction).
        """
        return self.radiance / (len(self) * self.density[:, None])

    def save(self, path: str | Path) -> None:
        """Write the samples as ``.npz``; the file appears only when it is complete.

        Raises :class:`LightdomeError` where it cannot be written, and for more than 2^27, which :meth:`load` refuses.
        """
        check_count(len(self))
        arrays = {f.name: np.asarray(getattr(self, f.name)) for f in fields(self)}
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
        with np.errstate(over="ignore"):  # what a float32 cannot hold is refused as infinite or zero
            direction, radiance, probability = (
                arrays[name].astype(np.float32, copy=False) for name in ("direction", "radiance", "probability")
            )
        result = checks.made(
            cls,
            direction=direction,
            radiance=radiance,
            probability=probability,
            pixel=arrays["pixel"],
            map_shape=(int(arrays["map_shape"][0]), int(arrays["map_shape"][1])),
            sequence=str(arrays["sequence"]),
            seed=int(arrays["seed"]),
            version=str(arrays["version"]),
        )
        _check(path, result)
        return checks.made(cls, **{**vars(result), "pixel": result.pixel.astype(np.int32, copy=False)})


def check_count(count: int) -> None:
    """Raise :class:`LightdomeError` for more samples than :meth:`Samples.load` would read."""
    if count > MAX_SAMPLES:
        raise LightdomeError(f"a file must hold {MAX_SAMPLES} samples or fewer, got {count}; use fewer samples")


# What a file must hold: kinds of its type, and shape with N for the number of samples.
_FORMAT: dict[str, tuple[str, tuple[object, ...]]] = {
    "direction": ("f", ("N", 3)),
    "radiance": ("f", ("N", 3)),
    "probability": ("f", ("N",)),
    "pixel": ("iu", ("N", 2)),
    "map_shape": ("iu", (2,)),
    "sequence": ("U", ()),
    "seed": ("iu", ()),
    "version": ("U", ()),
}


def _arrays(path: Path) -> dict[str, np.ndarray]:
    """The arrays of an ``.npz`` after a look at their headers, so that no lie in them costs memory."""
    arrays: dict[str, np.ndarray] = {}
    count: int | None = None
    with _parsing(path):
        is_special = path.exists() and not path.is_file()
    if is_special:  # a pipe would be waited for
        raise LightdomeError(f"cannot read {path}: it is no ordinary file")
    with _parsing(path):
        room = MAX_INFLATION * path.stat().st_size
        archive = zipfile.ZipFile(path)
    with archive:
        for name, (kinds, shape) in _FORMAT.items():
            if f"{name}.npy" not in archive.namelist():
                raise LightdomeError(f"{path} is no file of samples: it has no array {name!r}")
            member = archive.getinfo(f"{name}.npy")
            if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                raise LightdomeError(f"{path}: the array {name!r} is packed as numpy never does")
            with _parsing(path), archive.open(member) as stream:
                version = np.lib.format.read_magic(stream)
                if version != (1, 0):
                    raise ValueError("unknown version of the array format")
                found, _, dtype = np.lib.format.read_array_header_1_0(stream)
            if dtype.hasobject or dtype.kind not in kinds or dtype.itemsize > 1024:
                raise LightdomeError(f"{path}: the array {name!r} has the wrong type, {dtype}")
            wanted = tuple(count if n == "N" and count is not None else n for n in shape)
            if len(found) != len(wanted) or any(n not in ("N", f) for n, f in zip(wanted, found, strict=True)):
                raise LightdomeError(f"{path}: the array {name!r} has shape {found}, not {_shape(wanted)}")
            count = found[0] if "N" in shape else count
            if count is not None and not 0 < count <= MAX_SAMPLES:
                raise LightdomeError(f"{path}: holds {count} samples; 1 to {MAX_SAMPLES} can be used")
            size = int(np.prod(found, dtype=np.int64)) * dtype.itemsize
            if not size <= min(member.file_size, room) or member.file_size > size + 65536:
                raise LightdomeError(f"{path} is damaged: the array {name!r} is not as long as it says")
            with _parsing(path), archive.open(member) as stream:
                array = np.lib.format.read_array(stream, allow_pickle=False)
                arrays[name] = np.asarray(array.item()) if dtype.kind == "U" else array  # may be no Unicode
    return arrays


@contextmanager
def _parsing(path: Path) -> Iterator[None]:
    """Tell of a damaged file in one line: what zipfile, zlib and numpy raise and warn of then has no common class."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            yield
    except MemoryError:
        raise
    except OSError as error:
        raise LightdomeError(f"cannot read {path}: {error.strerror or one_line(error)}") from error
    except Exception as error:
        raise LightdomeError(f"{path} is damaged or no .npz file: {one_line(error)}") from error


def _shape(wanted: tuple[object, ...]) -> str:
    return "(" + ", ".join(str(n) for n in wanted) + ("," if len(wanted) == 1 else "") + ")"


def _check(path: Path | str, samples: Samples) -> None:
    """Refuse samples that contradict each other; each message names the first that does."""

    def refuse(bad: np.ndarray, what: str) -> None:
        if bad.any():
            raise LightdomeError(f"{path}: {what} (sample {int(np.argmax(bad))})")

    height, width = samples.map_shape
    if not (0 < height <= MAX_SIDE and 0 < width <= MAX_SIDE):
        raise LightdomeError(f"{path}: map_shape is {height} x {width}, which is no map")
    x, y = samples.pixel[:, 0].astype(np.int64), samples.pixel[:, 1].astype(np.int64)
    refuse((x < 0) | (x >= width) | (y < 0) | (y >= height), "a pixel lies outside the map")
    p = samples.probability
    refuse(~((p > 0) & (p <= 1 + 1e-6)), "a probability is not in (0, 1]")
    L = samples.radiance
    refuse(~(np.isfinite(L) & (L >= 0)).all(axis=1), "a radiance is negative, infinite or NaN")
    theta, phi = row_angles(height)[y], column_angles(width)[x]
    expected = directions(theta, phi)
    refuse(~(np.abs(samples.direction - expected) < 1e-5).all(axis=1), "a direction is not that of its pixel")
