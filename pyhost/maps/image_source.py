"""What the readers of all formats share: an open file whose rows can be read, and the checks of its claims."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import LightdomeError
from ..float_range import LARGEST

MAX_PIXELS = 2**30
# The most values that a byte of a file can hold: in EXR, block transforms keep one value of 64, and deflate then packs
# 2-byte values by up to 1032.
DENSITY = 64 * 516


@dataclass(frozen=True)
class ImageSource:
    """An open file of ``rows`` x ``columns`` pixels, as they lie in it.

    - ``read(first, end)``: those rows, (n, columns, 3) float32
    - ``orientation``: where row 0 and column 0 are, as in EXIF: 1 top and left, 4 bottom and left, 5 left and top, ...
    - ``together``: rows that the file packs together
    - ``largest``: the largest finite value that its type holds: of half floats 65504, else float32's
    - ``notes``: remarks for the user
    - ``is_cube``: whether the file says that it is a cube map, as OpenEXR defines it
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

    A header that claims more than a file of its bytes can hold is a lie, and believing it would cost the memory that it
    claims.
    """
    if min(rows, columns, channels) < 1 or rows * columns > MAX_PIXELS:
        raise LightdomeError(f"{path}: cannot use an image of {columns} x {rows} pixels, {channels} channels")
    file_bytes = path.stat().st_size
    if rows * columns * channels > DENSITY * file_bytes:
        raise LightdomeError(f"{path} is damaged: it claims {columns} x {rows} pixels but has only {file_bytes} bytes")


def damaged(path: Path, reason: str) -> LightdomeError:
    """The error for a damaged file."""
    return LightdomeError(f"{path} is damaged or truncated: {reason}")
