"""Read PFM files; the magic word, the header and the file's size must agree before any value is used.

The header starts with ``PF`` (three channels), ``Pf`` (one channel, read as grey) or ``PF4`` (four channels, of which
the last is ignored). Then come the width, the height, and the scale. The sign of the scale gives the byte order,
negative for little endian; values are multiplied by its magnitude. Words are separated by white space and by comments,
which run from ``#`` to the end of a line. After the scale comes one white-space character, or the rest of its line:
spaces, a comment, and LF or CRLF. Then come the pixels, 4 bytes per value, bottom row first.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from ..errors import LightdomeError, one_line
from .image_source import ImageSource, check_size, damaged

HEADER_BYTES = 2**16
BETWEEN = rb"(?:\s|#[^\n]*\n)+"
WORD = rb"([^\s#]{1,40})"
HEADER = re.compile(BETWEEN.join([WORD] * 4))
AFTER_SCALE = re.compile(rb"[ \t]*(?:#[^\n]*)?\r?\n(?:#[^\n]*\n)*")
CHANNELS = {b"PF": 3, b"Pf": 1, b"PF4": 4}
NUMBER = re.compile(rb"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
BOTTOM_UP = 4


@contextmanager
def open_pfm(path: Path) -> Iterator[ImageSource]:
    """An open PFM file. Raises :class:`LightdomeError` if its header is wrong or does not fit the file's size."""
    with path.open("rb") as file:
        start = file.read(HEADER_BYTES)
        header = HEADER.match(start)
        if header is None:
            raise damaged(path, f"it must begin with PF, width, height and scale, in at most {HEADER_BYTES >> 10} KiB")
        kind, *size, scale_word = header.groups()
        if kind not in CHANNELS:
            raise LightdomeError(f"{path}: unknown kind of PFM file {_shown(kind)}; expected PF, Pf or PF4")
        if not all(re.fullmatch(rb"\d{1,10}", word) for word in size):
            raise LightdomeError(f"{path}: bad size {' x '.join(map(_shown, size))} in the PFM header")
        channels, (columns, rows) = CHANNELS[kind], map(int, size)
        scale = float(scale_word) if NUMBER.fullmatch(scale_word) else math.nan
        with np.errstate(over="ignore", under="ignore"):
            factor = np.float32(abs(scale))
        if not 0 < factor < np.inf:
            raise LightdomeError(
                f"{path}: bad scale {_shown(scale_word)} in the PFM header; it must be a finite number other than 0,"
                " negative for little endian"
            )
        check_size(path, rows, columns, channels)
        number = np.dtype("<f4" if scale < 0 else ">f4")
        row_bytes = columns * channels * number.itemsize
        first_byte = path.stat().st_size - rows * row_bytes
        gap = start[header.end() : first_byte] if header.end() < first_byte <= len(start) else b""
        # A gap of one white-space character is valid, unless a new line follows: then the pixels lack a byte.
        a_byte_short = b"\n" in start[: header.end()] and start[first_byte:].startswith(b"\n")
        if not (AFTER_SCALE.fullmatch(gap) or (len(gap) == 1 and gap.isspace() and not a_byte_short)):
            raise damaged(
                path,
                f"{columns} x {rows} pixels take {rows * row_bytes} bytes, but the file has after its header"
                f" {path.stat().st_size - header.end() - 1} bytes",
            )

        def read(first: int, end: int) -> np.ndarray:
            file.seek(first_byte + first * row_bytes)
            shape = (end - first, columns, channels)
            pixels = np.fromfile(file, number, math.prod(shape))
            if pixels.size < math.prod(shape):
                raise damaged(path, "it ends too early")
            pixels = pixels.reshape(shape)
            pixels = np.repeat(pixels, 3, axis=2) if channels == 1 else pixels[..., :3]
            pixels = pixels.astype(np.float32, copy=False)
            if factor == 1:
                return pixels
            with np.errstate(over="ignore", under="ignore", invalid="ignore"):
                return pixels * factor

        note = f"note: the values of {path} are multiplied by the scale in its header, {factor:g}"
        yield ImageSource(rows, columns, read, BOTTOM_UP, notes=(note,) if factor != 1 else ())


def _shown(word: bytes) -> str:
    return one_line(word.decode("latin-1"))
