"""Read Radiance HDR (RGBE) files, following Radiance's format document and its ``header.c`` and ``color.c``.

The header is lines of text up to an empty line. The first is ``#?`` and any word; the others may come in any order and
number. ``FORMAT=32-bit_rle_rgbe`` may be missing. ``EXPOSURE=`` and ``COLORCORR=`` are factors by which the radiance
was multiplied; there may be several such lines, and all are divided out. Spaces around ``=`` and any case are allowed.
A line that begins with white space describes a picture that this one was made from, and is ignored. The size comes
last, in any of its eight orientations.

A scan line is packed by component (it begins with 2 2), or is plain pixels, or plain pixels with old-style run lengths:
a pixel (1, 1, 1, n) repeats the pixel before it n times, and in each such pixel that follows another, n counts 256
times as much. OpenImageIO mistakes run lengths for pixels, confuses two of the orientations, ignores both factors, and
refuses many valid headers. So it is used, for speed, only where it cannot go wrong: for packed lines below a header
that it is known to read.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
import OpenImageIO as oiio

from ..errors import LightdomeError, quoted, shown
from .image_source import ImageSource, check_size, damaged
from .oiio_files import open_input

HEADER_BYTES = 2**20
READ_BYTES = 2**22
BLOCK_PIXELS = 2**18
PACKED_WIDTHS = range(8, 2**15)
ORIENTATIONS = {"-Y+X": 1, "-Y-X": 2, "+Y-X": 3, "+Y+X": 4, "+X-Y": 5, "-X-Y": 6, "-X+Y": 7, "+X+Y": 8}
SIZE = re.compile(r"([+-][XY])\s+(\d{1,10})\s+([+-][XY])\s+(\d{1,10})\s*")
VARIABLE = re.compile(r"(FORMAT|EXPOSURE|COLORCORR|GAMMA)\s*=\s*(.*?)\s*(?:#.*)?", re.IGNORECASE)
NUMBER = re.compile(r"[+]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
SCALES = np.ldexp(np.float32(1), np.arange(256) - 136)
SCALES[0] = 0


@dataclass(frozen=True)
class Header:
    """A header's content: scan lines, pixels per line, orientation (as in EXIF), and the divisors of R, G and B."""

    rows: int
    columns: int
    orientation: int
    divisor: np.ndarray
    notes: tuple[str, ...]
    size: int


@contextmanager
def open_hdr(path: Path) -> Iterator[ImageSource]:
    """An open HDR file. Raises :class:`LightdomeError` for a header, a size or pixels that cannot be used."""
    with path.open("rb") as file:
        header = read_header(path, file.read(HEADER_BYTES))
        file.seek(header.size)
        packed = _is_packed(file.read(4), 0, header.columns)
        check_size(path, header.rows, header.columns, 3)
        lines = _ScanLines(path, file, header)
        quick = _QuickLines(path, header) if packed else None
        try:

            def read(first: int, end: int) -> np.ndarray:
                pixels = quick.read(first, end) if quick else None
                if pixels is None:
                    pixels = np.empty((end - first, header.columns, 3), np.float32)
                    lines.go_to(first)
                    for begin, stop in _blocks(0, len(pixels), header.columns):
                        _radiance(lines.read(stop - begin), pixels[begin:stop])
                return _divided(pixels, header.divisor)

            yield ImageSource(header.rows, header.columns, read, header.orientation, notes=header.notes)
        finally:
            if quick:
                quick.close()


def read_header(path: Path, start: bytes) -> Header:
    """The header of the file ``path``, whose first bytes are ``start``."""
    lines = [line.rstrip(b"\r").decode("latin-1") for line in start.split(b"\n")]
    if "" not in lines[:-2]:
        raise damaged(path, "its header does not end, with an empty line and the size, within the first MiB")
    end = lines.index("")
    header_bytes = sum(len(line) + 1 for line in start.split(b"\n", end + 2)[:-1])

    divisor = np.ones(3)
    said = []
    notes = []
    for line in lines[1:end]:
        found = VARIABLE.fullmatch(line)
        if not found:
            continue
        name, value = found[1].upper(), found[2]
        if name == "FORMAT":
            _check_format(path, value)
            continue
        words = value.split()
        numbers = [float(word) if NUMBER.fullmatch(word) else 0.0 for word in words]
        if name == "GAMMA":
            if numbers != [1]:
                notes.append(f"note: {path} says GAMMA={shown(value[:200])}, which is not undone")
            continue
        wanted = 3 if name == "COLORCORR" else 1
        if len(numbers) != wanted or not all(0 < n < math.inf for n in numbers):
            raise LightdomeError(
                f"{path}: bad header line {quoted(line)}; {name} takes {wanted} finite number"
                f"{'s' if wanted > 1 else ''} above 0"
            )
        with np.errstate(over="ignore", under="ignore"):
            divisor = divisor * numbers
        said.append(f"{name}={' '.join(words)}")
    if (divisor != 1).any():
        if not (np.isfinite(divisor) & (divisor > 0)).all():
            raise LightdomeError(f"{path}: its {' and '.join(said[:4])} together exceed the range of numbers")
        by = " ".join(f"{d:g}" for d in (divisor[:1] if (divisor == divisor[0]).all() else divisor))
        more = f" and {len(said) - 4} more" if len(said) > 4 else ""
        notes.append(f"note: the radiance in {path} is divided by {by}: its header says {', '.join(said[:4])}{more}")

    size = SIZE.fullmatch(lines[end + 1])
    if not size or size[1][1] == size[3][1]:
        raise damaged(path, f"expected a size such as -Y 512 +X 1024, got {quoted(lines[end + 1])}")
    rows, columns = int(size[2]), int(size[4])
    return Header(rows, columns, ORIENTATIONS[size[1] + size[3]], divisor, tuple(notes), header_bytes)


def _check_format(path: Path, value: str) -> None:
    if value.lower() == "32-bit_rle_xyze":
        # Radiance means watts times 179 and equal-energy white; other programs apply Rec. 709's matrix as it is.
        raise LightdomeError(
            f"{path} holds CIE XYZ (FORMAT=32-bit_rle_xyze), and programs disagree on its white and scale; convert it"
            " to RGB, for example with Radiance's ra_xyze -r"
        )
    if value.lower() != "32-bit_rle_rgbe":
        raise LightdomeError(f"{path}: expected the FORMAT 32-bit_rle_rgbe, got {quoted(value)}")


def _is_packed(data: bytes, at: int, columns: int) -> bool:
    return columns in PACKED_WIDTHS and data[at : at + 2] == b"\2\2" and data[at + 2 : at + 3] < b"\x80"


def _blocks(first: int, end: int, columns: int) -> Iterator[tuple[int, int]]:
    """Yield blocks of rows (first, end) that keep temporary arrays small."""
    size = max(1, BLOCK_PIXELS // columns)
    for begin in range(first, end, size):
        yield begin, min(begin + size, end)


class _QuickLines:
    """Scan lines read by OpenImageIO, as long as it cannot have got one wrong."""

    def __init__(self, path: Path, header: Header) -> None:
        self._file = open_input(path)
        self._columns = header.columns
        self._next = 0
        oiio.geterror()  # clear it: if OpenImageIO cannot open the file, that is not the file's fault
        if self._file and (self._file.spec().height, self._file.spec().width) != (header.rows, header.columns):
            self.close()

    def close(self) -> None:
        if self._file:
            self._file.close()
            self._file = None

    def read(self, first: int, end: int) -> np.ndarray | None:
        """Rows ``first`` to ``end``, (n, columns, 3) float32, or None if OpenImageIO cannot be trusted with them."""
        # A misread line shifts all lines after it, so skipped lines are checked too.
        for begin, stop in _blocks(self._next if self._next <= first else 0, first, self._columns):
            self._read(begin, stop)
        return self._read(first, end)

    def _read(self, first: int, end: int) -> np.ndarray | None:
        pixels = self._file.read_scanlines(first, end, 0, 0, 3, oiio.FLOAT) if self._file else None
        self._next = end
        if pixels is None or _has_old_runs(pixels):
            self.close()
            return None
        return pixels.reshape(end - first, self._columns, 3)


class _ScanLines:
    """The scan lines of an open file, in sequence."""

    def __init__(self, path: Path, file: BinaryIO, header: Header) -> None:
        self._path = path
        self._file = file
        self._header = header
        self._rewind()

    def _rewind(self) -> None:
        self._file.seek(self._header.size)
        self._left = self._path.stat().st_size - self._header.size
        self._data = b""
        self._at = 0
        self._next = 0

    def go_to(self, row: int) -> None:
        """Make ``row`` the next to read; the rows before it have to be unpacked to find where it begins."""
        if row < self._next:
            self._rewind()
        while self._next < row:
            self.read(1)

    def read(self, count: int) -> np.ndarray:
        """The next ``count`` scan lines by component, (count, 4, columns) uint8."""
        columns = self._header.columns
        result = np.empty((count, 4, columns), np.uint8)
        for line in result:
            self._fill()
            try:
                if _is_packed(self._data, self._at, columns):
                    self._unpack(line)
                else:
                    line[:] = self._plain()
            except IndexError:
                raise damaged(self._path, "it ends too early") from None
            self._next += 1
        return result

    def _fill(self) -> None:
        """Load a whole scan line, if the file has one: with runs, at most 4 records per pixel."""
        most = 16 * self._header.columns + 64
        if self._left > 0 and len(self._data) - self._at < most:
            more = self._file.read(min(self._left, max(most, READ_BYTES)))
            self._left -= len(more) or self._left
            self._data = self._data[self._at :] + more
            self._at = 0

    def _unpack(self, line: np.ndarray) -> None:
        data, at, columns = self._data, self._at, self._header.columns
        if data[at + 2] * 256 + data[at + 3] != columns:
            raise damaged(self._path, f"scan line {self._next} gives another length")
        at += 4
        for component in line:
            parts = []
            found = 0
            while found < columns:
                count = data[at]
                if count > 128:
                    count -= 128
                    parts.append(data[at + 1 : at + 2] * count)
                    at += 2
                elif count:
                    parts.append(data[at + 1 : at + 1 + count])
                    at += 1 + count
                else:
                    raise damaged(self._path, f"scan line {self._next} has a run of length 0")
                found += count
            if found > columns:
                raise damaged(self._path, f"a run exceeds scan line {self._next}")
            values = b"".join(parts)
            if len(values) < columns:
                raise IndexError
            component[:] = np.frombuffer(values, np.uint8)
        self._at = at

    def _plain(self) -> np.ndarray:
        columns = self._header.columns
        there = (len(self._data) - self._at) // 4
        records = np.frombuffer(self._data, np.uint8, 4 * min(columns, there), self._at).reshape(-1, 4)
        marker = (records[:, :3] == 1).all(axis=1)
        if not marker.any():
            if there < columns:
                raise IndexError
            self._at += 4 * columns
            return records.T
        records = np.frombuffer(self._data, np.uint8, 4 * min(4 * columns, there), self._at).reshape(-1, 4)
        marker = (records[:, :3] == 1).all(axis=1)
        if marker[0]:
            raise damaged(self._path, f"scan line {self._next} begins with a run")
        index = np.arange(len(records))
        pixel = np.maximum.accumulate(np.where(marker, 0, index))
        shift = 8 * np.clip(index - pixel - 1, 0, 4)
        counts = np.where(marker, np.minimum(records[:, 3].astype(np.int64) << shift, columns), 1)
        ends = np.cumsum(counts)
        last = int(np.searchsorted(ends, columns))
        if last == len(ends):
            raise IndexError
        if ends[last] > columns:
            raise damaged(self._path, f"a run exceeds scan line {self._next}")
        self._at += 4 * (last + 1)
        return np.repeat(records[pixel[: last + 1]], counts[: last + 1], axis=0).T


def _has_old_runs(pixels: np.ndarray) -> bool:
    """Whether any pixel from OpenImageIO could be a run (1, 1, 1, n), though it may be a grey power of two."""
    bits = pixels.view(np.uint32).reshape(-1, 3)
    red = bits[:, 0]
    power = (((red & 0x7FFFFF) == 0) | (red < 0x800000)) & (red != 0)
    return bool((power & (red == bits[:, 1]) & (red == bits[:, 2])).any())


def _radiance(rgbe: np.ndarray, out: np.ndarray) -> None:
    """Write the radiance of scan lines by component, (n, 4, W) uint8, into ``out``, (n, W, 3) float32."""
    scale = SCALES[rgbe[:, 3]]
    for c in range(3):
        np.multiply(rgbe[:, c], scale, out=out[..., c])


def _divided(pixels: np.ndarray, divisor: np.ndarray) -> np.ndarray:
    if (divisor != 1).any():
        with np.errstate(over="ignore", under="ignore"):
            for row in pixels:
                row[:] = row / divisor
    return pixels
