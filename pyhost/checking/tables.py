"""Read tables of samples, densities, lights and reflectances, and report what a check found in them.

A table is a CSV file with a header, separated by commas, semicolons or tabs, or an NPZ file of arrays. The case of
column names does not matter, and several names are known for the same thing: ``to_light_x``, ``direction_x``, ``x``.
"""

from __future__ import annotations

import csv
import math
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from .. import checks
from ..errors import LightdomeError, one_line, quoted
from .causes import CAUSES, Cause, Finding

MAX_BYTES = 2**30
MAX_INFLATION = 64  # by which compressed arrays may grow, beyond 64 MiB
VECTORS = (
    ("direction_x", "direction_y", "direction_z"),
    ("to_light_x", "to_light_y_up", "to_light_z"),
    ("dir_x", "dir_y", "dir_z"),
    ("wx", "wy", "wz"),
    ("dx", "dy", "dz"),
    ("x", "y", "z"),
)
COLOURS = (
    ("radiance_red", "radiance_green", "radiance_blue"),
    ("irradiance_red", "irradiance_green", "irradiance_blue"),
    ("flux_red", "flux_green", "flux_blue"),
    ("red", "green", "blue"),
    ("r", "g", "b"),
)
PIXELS = (("pixel_x", "pixel_y"), ("column", "row"), ("col", "row"), ("px", "py"))


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class TableCheck(Finding):
    """What a check of samples, densities, lights or reflectances found; ``details`` are numbers and remarks by name."""

    details: dict[str, object] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        found: Sequence[tuple[Cause, str]],
        details: dict[str, object],
        agreement: str = "",
        orientation: str = "",
        is_turned: bool = False,
    ) -> TableCheck:
        """The result for the causes ``found``, each with a remark.

        ``agreement`` is the verdict if there is no cause and the orientation is right, which ``is_turned`` denies.
        """
        if not found and not is_turned:
            verdict = "; ".join(filter(None, (agreement, orientation)))
            return cls(agrees=True, verdict=verdict, orientation=orientation, details=details)
        said = [f"{cause.name}: {cause.what}{f' ({remark})' if remark else ''}" for cause, remark in found]
        return cls(
            agrees=False,
            verdict="; ".join(["does not agree", *said, *([orientation] if is_turned else [])]),
            causes=tuple(cause for cause, _ in found),
            orientation=orientation,
            details=details,
        )

    def to_dict(self) -> dict[str, object]:
        """The same for JSON; numbers that are not finite become None."""
        return super().to_dict() | {name: _plain(value) for name, value in self.details.items()}


def _plain(value: object) -> object:
    if isinstance(value, dict):
        return {name: _plain(item) for name, item in value.items()}
    if isinstance(value, np.ndarray | list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def cause_named(name: str, others: Sequence[Cause] = ()) -> Cause:
    """The cause with this name in ``others`` or :data:`lightdome.checking.causes.CAUSES`."""
    return next(cause for cause in (*others, *CAUSES) if cause.name == name)


def read_table(path: str | Path) -> dict[str, np.ndarray]:
    """The columns of a CSV file, (N,) float64, or the numeric arrays of an NPZ file, by their names in lower case.

    An entry of a CSV file that is empty or not a number becomes NaN. Raises :class:`LightdomeError` for a file that is
    missing, damaged or too large, or has no header.
    """
    path = checks.path(path)
    try:
        size = path.stat().st_size
        if not path.is_file():
            raise LightdomeError(f"cannot read {path}: it is not a regular file")
        if size > MAX_BYTES:
            raise LightdomeError(f"cannot read {path}: tables may have up to {MAX_BYTES // 2**20} MiB")
        return _npz(path) if path.suffix.lower() == ".npz" else _csv(path)
    except OSError as error:
        raise LightdomeError(f"cannot read {path}: {error.strerror or one_line(error)}") from error


def _npz(path: Path) -> dict[str, np.ndarray]:
    """The numeric arrays; each header is checked first, so that a false size cannot exhaust the memory."""
    arrays = {}
    room = max(2**26, MAX_INFLATION * path.stat().st_size)
    try:
        with zipfile.ZipFile(path) as archive:
            for member in archive.infolist():
                with archive.open(member) as stream:
                    if np.lib.format.read_magic(stream) != (1, 0):
                        raise ValueError("unknown version of the array format")
                    shape, _, dtype = np.lib.format.read_array_header_1_0(stream)
                if dtype.kind not in "fiu":
                    continue
                if not 0 <= math.prod(shape) * dtype.itemsize <= min(member.file_size, room):
                    raise ValueError(f"the array {member.filename} has another length than its header says")
                with archive.open(member) as stream:
                    array = np.lib.format.read_array(stream, allow_pickle=False)
                arrays[member.filename.removesuffix(".npy").lower()] = array
    except (OSError, MemoryError):
        raise
    except Exception as error:  # zipfile, zlib and numpy have no common base class of errors
        raise LightdomeError(f"{path} is damaged or not an .npz file: {one_line(error)}") from error
    return arrays


def _csv(path: Path) -> dict[str, np.ndarray]:
    content = path.read_bytes()
    if b"\0" in content:
        raise LightdomeError(f"{path} is not a table; use a .csv file with a line of names, or an .npz file")
    text = content.decode("utf-8-sig", errors="replace")
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    if len(lines) < 2:
        raise LightdomeError(f"{path}: a table needs a header line and at least one line of numbers")
    delimiter = max(",;\t", key=lines[0].count)
    names, *rows = csv.reader(lines, delimiter=delimiter)
    names = [name.strip().lower() for name in names]
    if all(math.isfinite(_number(name)) for name in names):
        raise LightdomeError(f"{path}: the first line has numbers; it must have the names of the columns")
    for number, row in enumerate(rows, 2):
        if len(row) != len(names):
            raise LightdomeError(
                f"{path}: line {number} has {len(row)} values, but the header has {len(names)} names:"
                f" {quoted(delimiter.join(row))}"
            )
    table = np.array([[_number(value) for value in row] for row in rows])
    return dict(zip(names, table.T, strict=True))


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def column(table: Mapping[str, np.ndarray], *names: str) -> np.ndarray | None:
    """The first column (N,) that has one of these names, or None."""
    return next((table[name] for name in names if name in table and table[name].ndim == 1), None)


def columns(
    table: Mapping[str, np.ndarray], array: Sequence[str], groups: Sequence[Sequence[str]]
) -> np.ndarray | None:
    """The first array (N, k) whose name is in ``array``, or the first of the ``groups`` of k columns, or None."""
    for name in array:
        if name in table and table[name].ndim == 2 and table[name].shape[1] == len(groups[0]):
            return table[name]
    for group in groups:
        if all(name in table and table[name].ndim == 1 for name in group):
            return np.stack([table[name] for name in group], axis=1)
    return None


def directions_of(table: Mapping[str, np.ndarray], path: object) -> np.ndarray:
    """The directions (N, 3); raises :class:`LightdomeError` if there are none."""
    found = columns(table, ("direction", "directions", "to_light"), VECTORS)
    if found is None:
        raise LightdomeError(
            f"{path}: no directions: expected columns x, y, z or an array direction (N, 3), got"
            f" {', '.join(map(quoted, list(table)[:12])) or 'no numbers'}"
        )
    return found


def colours_of(table: Mapping[str, np.ndarray]) -> np.ndarray | None:
    """The colours (N, 3), or None."""
    return columns(table, ("radiance", "flux", "color", "colour", "rgb", "irradiance"), COLOURS)


def unit(direction: np.ndarray) -> tuple[np.ndarray, float]:
    """The directions scaled to length 1, float64, and the largest difference of a length from 1.

    Raises :class:`LightdomeError` for a direction that is zero or not finite.
    """
    direction = direction.astype(np.float64)
    length = np.linalg.norm(direction, axis=1)
    bad = ~(np.isfinite(length) & (length > 0))
    if bad.any():
        n = int(bad.argmax())
        raise LightdomeError(
            f"a direction must be finite and not zero, got {checks.told(direction[n].tolist())} (row {n})"
        )
    return direction / length[:, None], float(np.abs(length - 1).max())
