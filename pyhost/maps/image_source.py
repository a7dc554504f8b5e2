"""What the readers of all formats share: an open file whose rows can be read, and checks of its header's claims."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import LightdomeError
from ..float_range import LARGEST

MAX_PIXELS = 2**30
# The most values that one byte of a file can hold. In EXR, block transforms keep one value of 64, and deflate then
# packs the 2-byte values by up to 1032.
DENSITY = 64 * 516


@dataclass(frozen=True)
class ImageSource:
    """An open file of ``rows`` x ``columns`` pixels, as they are stored.

    - ``read(first, end)``: the rows ``first`` to ``end`` - 1, (n, columns, 3) float32
    - ``orientation``: where row 0 and column 0 are, as in EXIF: 1 top and left, 4 bottom and left, 5 left and top, ...
    - ``together``: how many rows the file packs together
    - ``largest``: the largest finite value of the file's type: 65504 for half floats, else float32's
    - ``notes``: remarks for the user
    - ``is_cube``: whether the file says that it is a cube map, as defined by OpenEXR
    """

    rows: int
    columns: int
    read: Callable[[int, int], np.ndarray]
    orientation: int = 1
    together: int = 1
    largest: float = LARGEST
    notes: tuple[str, ...] = ()
    is_cube: bool = False


def check_size(path: Path, rows: int, columns: int, channels: int) -> None:
    """Raise :class:`LightdomeError` for a size that cannot be used.

    That includes a size too large for the file's bytes: to believe such a header would cost the memory that it claims.
    """
    if min(rows, columns, channels) < 1 or rows * columns > MAX_PIXELS:
        raise LightdomeError(f"{path}: cannot use an image of {columns} x {rows} pixels, {channels} channels")
    file_bytes = path.stat().st_size
    if rows * columns * channels > DENSITY * file_bytes:
        raise LightdomeError(f"{path} is damaged: it claims {columns} x {rows} pixels but has only {file_bytes} bytes")


def damaged(path: Path, reason: str) -> LightdomeError:
    """The error for a damaged file."""
    return LightdomeError(f"{path} is damaged or truncated: {reason}")
