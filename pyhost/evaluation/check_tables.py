"""Tables of samples, densities, lights and reflectances: reading what others wrote, and what a check found in it.

A table is a CSV file with a header, separated by commas, semicolons or tabs, or an NPZ file of arrays. Names of columns
are compared in lower case, and by what they mean: ``to_light_x``, ``direction_x`` and ``x`` are the same.
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
from .check_causes import CAUSES, Cause

MAX_BYTES = 2**30
MAX_INFLATION = 64  # of packed arrays
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


@dataclass(frozen=True)
class TableCheck:
    """What a check of samples, densities, lights or reflectances found.

    - ``agrees``: True, False, or None where it cannot be told
    - ``verdict``: a line that says so, with the cause if it is known
    - ``cause``: the mistake that explains what was found, else None
    - ``orientation``: in which axes the directions are, or how they are turned or mirrored; "" for lightdome's own
    - ``details``: numbers and remarks by name
    """

    agrees: bool | None
    verdict: str
    cause: Cause | None = None
    orientation: str = ""
    details: dict[str, object] = field(default_factory=dict)

    def to_dict(self) -> dict[str, object]:
        """Everything, for JSON: what is not finite becomes None."""
        return {
            "agrees": self.agrees,
            "verdict": self.verdict,
            "cause": self.cause and self.cause.name,
            "orientation": self.orientation,
            **{name: _plain(value) for name, value in self.details.items()},
        }


def _plain(value: object) -> object:
    if isinstance(value, dict):
        return {name: _plain(item) for name, item in value.items()}
    if isinstance(value, np.ndarray | list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def cause_named(name: str, others: Sequence[Cause] = ()) -> Cause:
    """The cause of this name, of :data:`lightdome.evaluation.check_causes.CAUSES` or ``others``."""
    return next(cause for cause in (*others, *CAUSES) if cause.name == name)


def read_table(path: str | Path) -> dict[str, np.ndarray]:
    """The columns of a CSV file, (N,) float64, or the arrays of numbers of an NPZ file, by names in lower case.

    A value of a CSV file that is empty or no number is NaN. Raises :class:`LightdomeError` for a file that is missing,
    damaged, too large, or has no header.
    """
    path = checks.path(path)
    try:
        size = path.stat().st_size
        if not path.is_file():
            raise LightdomeError(f"cannot read {path}: it is no ordinary file")
        if size > MAX_BYTES:
            raise LightdomeError(f"cannot read {path}: a table of more than {MAX_BYTES // 2**20} MiB is too large")
        return _npz(path) if path.suffix.lower() == ".npz" else _csv(path)
    except OSError as error:
        raise LightdomeError(f"cannot read {path}: {error.strerror or one_line(error)}") from error


def _npz(path: Path) -> dict[str, np.ndarray]:
    """The arrays of numbers, each after a look at its header, so that no lie there costs memory."""
    arrays = {}
    room = MAX_INFLATION * path.stat().st_size
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
                    raise ValueError(f"the array {member.filename} is not as long as it says")
                with archive.open(member) as stream:
                    array = np.lib.format.read_array(stream, allow_pickle=False)
                arrays[member.filename.removesuffix(".npy").lower()] = array
    except (OSError, MemoryError):
        raise
    except Exception as error:  # what zipfile, zlib and numpy raise has no common class
        raise LightdomeError(f"{path} is damaged or no .npz file: {one_line(error)}") from error
    return arrays


def _csv(path: Path) -> dict[str, np.ndarray]:
    text = path.read_bytes().decode("utf-8-sig", errors="replace")
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    if len(lines) < 2:
        raise LightdomeError(f"{path}: a table needs a line of names and at least one line of numbers")
    delimiter = max(",;\t", key=lines[0].count)
    names, *rows = csv.reader(lines, delimiter=delimiter)
    names = [name.strip().lower() for name in names]
    if all(math.isfinite(_number(name)) for name in names):
        raise LightdomeError(f"{path}: the first line holds numbers; it must hold the names of the columns")
    for number, row in enumerate(rows, 2):
        if len(row) != len(names):
            raise LightdomeError(
                f"{path}: line {number} has {len(row)} values, and the header {len(names)} names:"
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
    """The first column (N,) that has one of these names, None without one."""
    return next((table[name] for name in names if name in table and table[name].ndim == 1), None)


def columns(
    table: Mapping[str, np.ndarray], array: Sequence[str], groups: Sequence[Sequence[str]]
) -> np.ndarray | None:
    """The first array (N, k) of the names ``array``, or the first ``groups`` of k columns; None without either."""
    for name in array:
        if name in table and table[name].ndim == 2 and table[name].shape[1] == len(groups[0]):
            return table[name]
    for group in groups:
        if all(name in table and table[name].ndim == 1 for name in group):
            return np.stack([table[name] for name in group], axis=1)
    return None


def directions_of(table: Mapping[str, np.ndarray], path: object) -> np.ndarray:
    """The directions (N, 3); raises :class:`LightdomeError` where there are none."""
    found = columns(table, ("direction", "directions", "to_light"), VECTORS)
    if found is None:
        raise LightdomeError(
            f"{path}: it needs directions, as columns x, y, z or an array direction (N, 3); it has"
            f" {', '.join(map(quoted, list(table)[:12])) or 'no numbers'}"
        )
    return found


def colours_of(table: Mapping[str, np.ndarray]) -> np.ndarray | None:
    """The colours (N, 3), None without any."""
    return columns(table, ("radiance", "flux", "color", "colour", "rgb", "irradiance"), COLOURS)


def verdict_of(causes: Sequence[tuple[Cause, str]], orientation: str = "") -> str:
    """What does not agree: causes with a remark each, and how it is turned."""
    said = [f"{cause.name}: {cause.what}{f' ({more})' if more else ''}" for cause, more in causes]
    return "; ".join(["does not agree", *said, *([orientation] if orientation else [])])


def unit(direction: np.ndarray) -> tuple[np.ndarray, float]:
    """``direction`` with length 1, float64, and by how much the worst one's length was off.

    Raises :class:`LightdomeError` for a direction that is 0 or not finite.
    """
    direction = direction.astype(np.float64)
    length = np.linalg.norm(direction, axis=1)
    bad = ~(np.isfinite(length) & (length > 0))
    if bad.any():
        n = int(bad.argmax())
        raise LightdomeError(f"a direction must be a vector, got {checks.told(direction[n].tolist())} (row {n})")
    return direction / length[:, None], float(np.abs(length - 1).max())
