"""Read and write images with OpenImageIO; tone-map radiance for the eye.

Arrays are (H, W, 3) with row 0 at the top, whatever the file's own order of rows. OpenImageIO's PNM
plug-in needs a hint on both ways to keep it so: it reads PFM bottom up unless ``pnm:pfmflip`` is 1, and
writes PPM bottom up unless it is 0.

Reading costs memory for what a file holds, whatever its header claims: the values of all its channels at
4 bytes each, up to three times; :class:`ImageRows` reads so many rows at a time as one likes.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import OpenImageIO as oiio

from .errors import LightdomeError, one_line
from .files import cannot_write, replacing, utf8_name

READABLE = (".pfm", ".exr", ".hdr")
MAX_PIXELS = 2**30
# What a file begins with, and the most values that one of its bytes can stand for; a header that claims more is
# a lie, and believing it would cost the memory that it claims. HDR has runs of 127 in 2 bytes, EXR deflates 2-byte
# values by up to 1032, and those of its methods that transform blocks keep one of 64 before that.
DENSITY = {b"PF": 1 / 4, b"Pf": 1 / 4, b"#?": 64, b"v/1\x01": 516}
DENSITY_OF_BLOCKS = 64 * 516
MAX_OVERHANG = 2048  # pixels of a tile outside the image
BATCH_VALUES = 3 * 2**22
COMMON_PFM = re.compile(rb"(P[Ff])\n(\d{1,9}) (\d{1,9})\n(-?)1(?:\.0*)?\n")
BOTTOM_UP = 4  # an ``Orientation``


def read_image(path: str | Path) -> np.ndarray:
    """The radiance in a PFM, EXR or Radiance HDR file: (H, W, 3) float32, row 0 at the top.

    A single channel is read as grey; of more than three, R, G and B (else the first three) are read.
    Raises :class:`LightdomeError` for a file that is missing, truncated, damaged or of another kind.
    """
    path = Path(path)
    with _opened(path) as file:
        spec = file.spec()
        pixels = file.read_image(oiio.FLOAT)
        if pixels is None:
            raise _damaged(path, _reason(file.geterror))
        return _radiance(pixels.reshape(spec.height, spec.width, spec.nchannels), spec)


class ImageRows:
    """The rows of a file that :func:`read_image` reads, some at a time: memory for those, not for the image.

    - ``height``, ``width``: of the image
    - ``batch``: the most rows that :meth:`read` yields at once; by default they take 50 MB, or are those that the
      file packs together, a row of tiles for one

    An HDR file that lies on its side is read whole all the same, and so are the bytes of a PFM file whose header is
    of an uncommon form. Raises :class:`LightdomeError` as :func:`read_image` does.
    """

    def __init__(self, path: str | Path, batch: int | None = None) -> None:
        self.path = Path(path)
        with _row_reader(self.path) as (spec, _):
            self._on_its_side = spec.get_int_attribute("Orientation", 1) >= 5
            self.height, self.width = (spec.height, spec.width)[:: -1 if self._on_its_side else 1]
            # As OpenImageIO says, which would unpack them again for every batch that has some of them.
            self._together = max(1, spec.tile_height, spec.get_int_attribute("oiio:RowsPerChunk", 1))
            fitting = BATCH_VALUES // (spec.width * max(3, spec.nchannels))
        self.batch = batch or max(fitting - fitting % self._together, self._together)

    def read(self, rows: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield the radiance of ``rows``, ascending numbers, in batches: their numbers (n,), and (n, W, 3) float32.

        Batches come in the file's order, which may be bottom up. Other rows are not read where the format allows it.
        """
        if self._on_its_side:
            image = read_image(self.path)
            for begin in range(0, len(rows), self.batch):
                batch = rows[begin : begin + self.batch]
                yield batch, image[batch]
            return
        with _row_reader(self.path) as (spec, read_rows):
            bottom_up = spec.get_int_attribute("Orientation", 1) in (3, 4)
            in_file = self.height - 1 - rows[::-1] if bottom_up else rows
            for begin in range(0, len(rows), self.batch):
                batch = in_file[begin : begin + self.batch]
                parts = []
                for first, end in self._spans(batch):
                    wanted = batch[(batch >= first) & (batch < end)] - first
                    part = read_rows(first, end)
                    parts.append(part if len(wanted) == end - first else part[wanted])
                pixels = _radiance(parts[0] if len(parts) == 1 else np.concatenate(parts), spec)
                yield self.height - 1 - batch[::-1] if bottom_up else batch, pixels

    def _spans(self, rows: np.ndarray) -> Iterator[tuple[int, int]]:
        """Spans of whole packs, first row and end, that hold ``rows``; none is longer than a batch need be."""
        packs = np.unique(rows // self._together)
        most = max(1, self.batch // self._together)
        for run in np.split(packs, np.flatnonzero(np.diff(packs) > 1) + 1):
            for first in range(run[0], run[-1] + 1, most):
                end = min(first + most, run[-1] + 1)
                yield first * self._together, min(end * self._together, self.height)


@contextmanager
def _row_reader(path: Path) -> Iterator[tuple[oiio.ImageSpec, Callable[[int, int], np.ndarray]]]:
    """A file's specification, and a function that reads its rows ``first`` to ``end``, (n, W, channels) float32."""
    start, size, density = _look(path)
    header = COMMON_PFM.match(start)
    with path.open("rb") if header else _opened(path) as file:
        if header:  # OpenImageIO would read the whole file
            kind, width, height, sign = header.groups()
            spec = oiio.ImageSpec(int(width), int(height), 3 if kind == b"PF" else 1, oiio.FLOAT)
            spec.attribute("Orientation", BOTTOM_UP)
            _check_size(path, size, spec, density)
            number = np.dtype("<f4" if sign else ">f4")
        else:
            spec = file.spec()
        columns = (spec.x, spec.x + spec.width)

        def read_rows(first: int, end: int) -> np.ndarray:
            shape = (end - first, spec.width, spec.nchannels)
            if header:
                file.seek(header.end() + first * spec.width * spec.nchannels * number.itemsize)
                pixels = np.fromfile(file, number, math.prod(shape)).astype(np.float32, copy=False)
                if pixels.size < math.prod(shape):
                    raise _damaged(path, "it ends too early")
                return pixels.reshape(shape)
            lines = (spec.y + first, spec.y + end)
            if spec.tile_width:
                pixels = file.read_tiles(*columns, *lines, 0, 1, 0, spec.nchannels, oiio.FLOAT)
            else:
                pixels = file.read_scanlines(*lines, 0, 0, spec.nchannels, oiio.FLOAT)
            if pixels is None:
                raise _damaged(path, _reason(file.geterror))
            return pixels.reshape(shape)

        yield spec, read_rows


def _look(path: Path) -> tuple[bytes, int, float]:
    """What a file begins with, its size, and the most values that one of its bytes can stand for.

    Raises :class:`LightdomeError` for what is no file of a kind that lightdome reads.
    """
    try:
        size = path.stat().st_size
        if not path.is_file():  # a pipe would be waited for
            raise LightdomeError(f"{path} is a folder or a device, not an image")
        with path.open("rb") as stream:
            start = stream.read(64)
    except OSError as error:
        raise LightdomeError(f"cannot read {path}: {error.strerror}") from error
    if path.suffix.lower() not in READABLE:
        raise LightdomeError(f"{path}: not a map that lightdome reads; give a .pfm, .exr or .hdr file")

    # OpenImageIO would try all of its readers on a file of another kind, whatever its suffix.
    density = next((density for magic, density in DENSITY.items() if start.startswith(magic)), None)
    if density is None:
        raise LightdomeError(f"{path} is damaged or of another kind: it does not begin like a .pfm, .exr or .hdr file")
    return start, size, density


@contextmanager
def _opened(path: Path) -> Iterator[oiio.ImageInput]:
    """An open file, which is of a kind that lightdome reads and no larger than it can be."""
    _, size, density = _look(path)
    config = oiio.ImageSpec()
    config.attribute("pnm:pfmflip", 1)
    file = oiio.ImageInput.open(utf8_name(path), config)
    if file is None:
        raise LightdomeError(f"{path} is no image that OpenImageIO can read: {_reason(oiio.geterror)}")
    try:
        spec = file.spec()
        if spec.get_string_attribute("compression").startswith(("dwa", "htj2k")):
            density = DENSITY_OF_BLOCKS
        _check_size(path, size, spec, density)
        yield file
    finally:
        file.close()


def _radiance(pixels: np.ndarray, spec: oiio.ImageSpec) -> np.ndarray:
    """R, G and B, upright, of rows as they lie in a file of specification ``spec``."""
    names = [name.upper() for name in spec.channelnames]
    if spec.nchannels < 3:
        wanted = [0, 0, 0]
    elif {"R", "G", "B"} <= set(names):
        wanted = [names.index(c) for c in "RGB"]
    else:
        wanted = [0, 1, 2]
    if wanted != list(range(spec.nchannels)):
        pixels = pixels[..., wanted]
    return np.ascontiguousarray(_upright(pixels, spec.get_int_attribute("Orientation", 1)))


def _upright(pixels: np.ndarray, orientation: int) -> np.ndarray:
    """Undo a file's ``Orientation`` (as in EXIF), which Radiance HDR keeps as +Y, -X or swapped axes."""
    if orientation >= 5:
        pixels = pixels.swapaxes(0, 1)
        orientation = {5: 1, 6: 2, 7: 3, 8: 4}.get(orientation, 1)
    rows = slice(None, None, -1) if orientation in (3, 4) else slice(None)
    columns = slice(None, None, -1) if orientation in (2, 3) else slice(None)
    return pixels[rows, columns]


def _check_size(path: Path, file_bytes: int, spec: oiio.ImageSpec, density: float) -> None:
    width, height, channels = spec.width, spec.height, spec.nchannels
    if min(width, height, channels) < 1 or spec.depth > 1 or width * height > MAX_PIXELS:
        raise LightdomeError(f"{path}: cannot use an image of {width} x {height} pixels, {channels} channels")
    if spec.deep:
        raise LightdomeError(f"{path} is a deep image, which is no environment map; flatten it")
    if (spec.x, spec.y, width, height) != (spec.full_x, spec.full_y, spec.full_width, spec.full_height):
        raise LightdomeError(
            f"{path}: its data window is not its display window, so it is no whole environment map; save it uncropped"
        )
    # The library makes room for whole tiles, also where they reach far out of the image.
    if spec.tile_width > width + MAX_OVERHANG or spec.tile_height > height + MAX_OVERHANG:
        raise LightdomeError(f"{path} is damaged: it claims tiles of {spec.tile_width} x {spec.tile_height} pixels")
    if width * height * channels > density * file_bytes:
        raise LightdomeError(f"{path} is damaged: it claims {width} x {height} pixels but has only {file_bytes} bytes")


def _damaged(path: Path, reason: str) -> LightdomeError:
    return LightdomeError(f"{path} is damaged or truncated: {reason}")


def _reason(geterror: Callable[[], str]) -> str:
    """What OpenImageIO says; it quotes damaged files as they are, in bytes that may be no text."""
    try:
        return one_line(geterror())
    except UnicodeDecodeError as error:
        return one_line(error.object.decode("utf-8", "replace"))


def auto_exposure(radiance: np.ndarray) -> float:
    """The factor that brings the 95th percentile of the pixels' largest channel to 1.

    Black pixels do not count: a sphere's background must not change its exposure. 1 for a black image.
    """
    brightest = radiance.max(axis=-1)
    lit = brightest[brightest > 0]
    level = float(np.percentile(lit, 95)) if lit.size else 1.0
    return min(1.0 / level, 3e38) if level > 0 else 1.0


def tone_map(radiance: np.ndarray, exposure: float, gamma: float = 2.2) -> np.ndarray:
    """8-bit values round(255 (exposure L)^(1/gamma)), clipped; the shape of ``radiance``, uint8."""
    with np.errstate(over="ignore"):  # infinity is clipped too
        scaled = np.clip(radiance.astype(np.float64) * exposure, 0.0, 1.0)
    return np.rint(255.0 * scaled ** (1.0 / gamma)).astype(np.uint8)


def write_image(path: str | Path, pixels: np.ndarray) -> None:
    """Write (H, W, 3) pixels, row 0 at the top: float32 as .pfm or .exr, uint8 as .ppm or .png.

    The file appears only when it is complete. Raises :class:`LightdomeError` where it cannot be written.
    """
    path = Path(path)
    height, width, channels = pixels.shape
    spec = oiio.ImageSpec(width, height, channels, oiio.UINT8 if pixels.dtype == np.uint8 else oiio.FLOAT)
    if path.suffix == ".ppm":
        spec.attribute("pnm:pfmflip", 0)
        spec.attribute("pnm:binary", 1)
    with replacing(path) as temporary:
        name = utf8_name(temporary)
        file = oiio.ImageOutput.create(name)
        if file is None:
            raise cannot_write(path, _reason(oiio.geterror))
        done = file.open(name, spec) and file.write_image(np.ascontiguousarray(pixels))
        done = file.close() and done
        if not done:
            raise cannot_write(path, _reason(file.geterror))
