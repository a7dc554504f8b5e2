"""Read and write images; tone-map radiance for display.

Arrays are (H, W, 3) with row 0 at the top, whatever the order of rows in the file. The readers
(:mod:`lightdome.maps.exr` with :mod:`lightdome.maps.exr_layers`, :mod:`lightdome.maps.radiance_hdr`, and
:mod:`lightdome.maps.pfm`) say what they read and what they refuse. In short:

- EXR: R, G, B of the default layer, else its Y as grey, else the only colour layer of all parts, or the layer that the
  caller names; half, float and UINT; luminance-chroma at full resolution. Depth, alpha and albedo are never light.
- HDR: RGBE in all eight orientations, with scan lines that are packed, plain or have old-style run lengths;
  ``EXPOSURE`` and ``COLORCORR`` are divided out; XYZE is refused.
- PFM: ``PF``, ``Pf`` (grey) and ``PF4`` (without its fourth channel), in both byte orders, times the scale.

Memory is proportional to what a file holds, whatever its header claims: up to three times the values of its three
channels at 4 bytes each. :class:`ImageRows` reads as few rows at a time as you like.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import OpenImageIO as oiio

from .. import checks
from ..errors import LightdomeError
from ..files import cannot_write, replacing, utf8_name
from ..float_range import LARGEST
from .exr import open_exr
from .image_source import ImageSource
from .oiio_files import reason
from .pfm import open_pfm
from .radiance_hdr import open_hdr

READABLE = (".pfm", ".exr", ".hdr")
LINEAR, DISPLAYED = (".pfm", ".exr"), (".ppm", ".png")  # the formats that are written
BATCH_VALUES = 3 * 2**22


def read_image(path: str | Path, layer: str | None = None, flip: bool = False) -> np.ndarray:
    """The radiance in a PFM, EXR or Radiance HDR file: (H, W, 3) float32, row 0 at the top.

    ``layer`` names a layer of an EXR file, a part, or both as ``part.layer``. Without it the file must be unambiguous:
    R, G and B of the default layer are taken, else its Y as grey, else the only colour layer. ``flip`` reverses the
    rows, for a file that was written upside down. :class:`ImageRows` has remarks on the file, such as that its header
    changes the radiance.

    Raises :class:`LightdomeError` for a file that is missing, truncated, damaged or of another kind, and for one whose
    colour is ambiguous, with a list of its layers.
    """
    path, layer, flip = checks.path(path), checks.optional_text("layer", layer), checks.flag("flip", flip)
    with _opened(path, layer) as source:
        pixels = _upright(source.read(0, source.rows), source.orientation)
    return np.ascontiguousarray(pixels[::-1] if flip else pixels)


class ImageRows:
    """The rows of a file that :func:`read_image` can read, some at a time, with memory only for those rows.

    - ``height``, ``width``: the image's
    - ``batch``: the most rows that :meth:`read` yields at once; by default as many as take 50 MB, or as many as the
      file packs together, such as a row of tiles
    - ``largest``: the largest finite value of the file's type: 65504 for half floats, else float32's
    - ``notes``: remarks for the user: which layer was taken, a factor in the header that was divided out, and so on
    - ``is_cube``: whether the file says that it is a cube map (OpenEXR's ``envmap``), whose rows cannot be read

    ``layer`` and ``flip`` are as in :func:`read_image`. A file that is stored on its side is read all at once
    nevertheless. Raises :class:`LightdomeError` as :func:`read_image` does.
    """

    def __init__(
        self, path: str | Path, batch: int | None = None, layer: str | None = None, flip: bool = False
    ) -> None:
        self.path = checks.path(path)
        self.flip = checks.flag("flip", flip)
        self._layer = checks.optional_text("layer", layer)
        with _opened(self.path, self._layer) as source:
            self._on_its_side = source.orientation >= 5
            self.height, self.width = (source.rows, source.columns)[:: -1 if self._on_its_side else 1]
            self.largest = source.largest
            self.notes = source.notes
            self.is_cube = source.is_cube
            self._together = source.together
            fitting = BATCH_VALUES // (source.columns * 3)
        self._columns: np.ndarray | None = None
        if batch is not None:
            checks.whole("a batch", batch, 1, 2**31 - 1)
        self.batch = batch or max(fitting - fitting % self._together, self._together)

    def read(self, rows: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield the radiance of ``rows``, ascending numbers, in batches: row numbers (n,) and (n, W, 3) float32.

        Batches come in the file's order, which may be bottom up. Other rows are skipped where the format allows it.
        Raises :class:`LightdomeError` for numbers out of range or not ascending, and for a cube map.
        """
        if self.is_cube:
            raise LightdomeError(
                f"{self.path} is a cube map (envmap = cube); only a latitude-longitude map is read row by row"
            )
        rows = checks.array("rows", rows, ("N",))
        inside = rows.size == 0 or (rows[0] >= 0 and rows[-1] < self.height and (np.diff(rows.astype(float)) > 0).all())
        if rows.dtype.kind == "f" or not inside:
            raise LightdomeError(f"rows must be ascending whole numbers from 0 to {self.height - 1}")
        last = self.height - 1
        if self.flip:
            read = self._read(last - rows[::-1].astype(np.int64))
            batches: Iterator[tuple[np.ndarray, np.ndarray]] = (
                (last - batch[::-1], pixels[::-1]) for batch, pixels in read
            )
        else:
            batches = self._read(rows)
        if self._columns is None:
            return batches
        return ((batch, pixels[:, self._columns]) for batch, pixels in batches)

    def reorder(self, columns: np.ndarray) -> None:
        """Let :meth:`read` yield the columns in the order of ``columns``, (W,) column numbers of the file.

        Raises :class:`LightdomeError` unless ``columns`` holds each column exactly once.
        """
        columns = checks.array("columns", columns, (self.width,))
        in_file = np.arange(self.width)
        if not np.array_equal(np.sort(columns), in_file):
            raise LightdomeError(f"columns must hold each number from 0 to {self.width - 1} once")
        # Batches are copied only if columns move.
        self._columns = None if np.array_equal(columns, in_file) else columns.astype(np.int64)

    def _read(self, rows: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """As :meth:`read`, before ``flip`` and :meth:`reorder`: row 0 is the top, as the file says."""
        if self._on_its_side:
            image = read_image(self.path, self._layer)
            for begin in range(0, len(rows), self.batch):
                batch = rows[begin : begin + self.batch]
                yield batch, image[batch]
            return
        with _opened(self.path, self._layer) as source:
            bottom_up = source.orientation in (3, 4)
            in_file = self.height - 1 - rows[::-1] if bottom_up else rows
            for begin in range(0, len(rows), self.batch):
                batch = in_file[begin : begin + self.batch]
                parts = []
                for first, end in self._spans(batch):
                    wanted = batch[(batch >= first) & (batch < end)] - first
                    part = source.read(first, end)
                    parts.append(part if len(wanted) == end - first else part[wanted])
                pixels = _upright(parts[0] if len(parts) == 1 else np.concatenate(parts), source.orientation)
                yield self.height - 1 - batch[::-1] if bottom_up else batch, np.ascontiguousarray(pixels)

    def _spans(self, rows: np.ndarray) -> Iterator[tuple[int, int]]:
        """Spans (first row, end) of whole packs that cover ``rows``; none is longer than a batch has to be."""
        packs = np.unique(rows // self._together)
        most = max(1, self.batch // self._together)
        for run in np.split(packs, np.flatnonzero(np.diff(packs) > 1) + 1):
            for first in range(run[0], run[-1] + 1, most):
                end = min(first + most, run[-1] + 1)
                yield first * self._together, min(end * self._together, self.height)


@contextmanager
def _opened(path: Path, layer: str | None) -> Iterator[ImageSource]:
    """An open file of a kind that lightdome reads. Raises :class:`LightdomeError` for any other."""
    try:
        path.stat()
        if not path.is_file():  # opening a pipe would block
            raise LightdomeError(f"{path} is a folder or a device, not an image")
        with path.open("rb") as stream:
            start = stream.read(4)
    except OSError as error:
        raise LightdomeError(f"cannot read {path}: {error.strerror}") from error
    if path.suffix.lower() not in READABLE:
        raise LightdomeError(f"{path}: not a map that lightdome reads; give a .pfm, .exr or .hdr file")

    # OpenImageIO would try all of its readers on any other file, whatever its suffix.
    if start == b"v/1\x01":
        source = open_exr(path, layer)
    elif layer is not None and start.startswith((b"PF", b"Pf", b"#?")):
        raise LightdomeError(f"{path}: only EXR files have layers; leave out --layer")
    elif start.startswith((b"PF", b"Pf")):
        source = open_pfm(path)
    elif start.startswith(b"#?"):
        source = open_hdr(path)
    else:
        raise LightdomeError(f"{path} is damaged or of another kind: it does not start like a .pfm, .exr or .hdr file")
    with source as opened:
        yield opened


def _upright(pixels: np.ndarray, orientation: int) -> np.ndarray:
    """Undo an orientation, numbered as in EXIF."""
    if orientation >= 5:
        pixels = pixels.swapaxes(0, 1)
        orientation = {5: 1, 6: 2, 7: 3, 8: 4}.get(orientation, 1)
    rows = slice(None, None, -1) if orientation in (3, 4) else slice(None)
    columns = slice(None, None, -1) if orientation in (2, 3) else slice(None)
    return pixels[rows, columns]


def auto_exposure(radiance: np.ndarray) -> float:
    """The factor that brings the 95th percentile of the pixels' largest channel to 1.

    Black pixels do not count, so that a sphere's background does not change its exposure; infinite ones do not either.
    For a black image the factor is 1. Raises :class:`LightdomeError` for NaN, and for an array that does not hold real
    numbers.
    """
    brightest = _numbers(radiance).max(axis=-1)
    lit = brightest[(brightest > 0) & (brightest < np.inf)]
    level = float(np.percentile(lit, 95)) if lit.size else 1.0
    return min(1.0 / level, 3e38) if level > 0 else 1.0


def tone_map(radiance: np.ndarray, exposure: float, gamma: float = 2.2) -> np.ndarray:
    """8-bit values round(255 (exposure L)^(1/gamma)), clipped; the shape of ``radiance``, uint8.

    Raises :class:`LightdomeError` for NaN, and for an exposure or a gamma that is not finite and above 0.
    """
    exposure, gamma = checks.positive("the exposure", exposure), checks.positive("gamma", gamma)
    radiance = _numbers(radiance)
    result = np.empty(radiance.shape, np.uint8)
    rows = max(1, BATCH_VALUES // max(1, radiance[0].size))  # at a time, because float64 takes memory
    with np.errstate(over="ignore"):  # too large becomes white
        for first in range(0, len(radiance), rows):
            part = slice(first, first + rows)
            scaled = np.clip(radiance[part].astype(np.float64) * exposure, 0.0, 1.0)
            result[part] = np.rint(255.0 * scaled ** (1.0 / gamma))
    return result


def _numbers(radiance: np.ndarray) -> np.ndarray:
    """Radiance as a non-empty array of any shape, without NaN."""
    radiance = checks.array("radiance", radiance)
    if radiance.size == 0 or radiance.ndim == 0:
        raise LightdomeError(f"radiance must be an array with at least one pixel, got shape {radiance.shape}")
    if np.isnan(radiance.max()):
        raise LightdomeError(f"radiance must not hold NaN, got {int(np.isnan(radiance).sum())}; replace it first")
    return radiance


def write_image(path: str | Path, pixels: np.ndarray, *, is_cube: bool = False) -> None:
    """Write (H, W, 3) pixels, row 0 at the top: floating-point radiance as .pfm or .exr, uint8 as .ppm or .png.

    Radiance is written unchanged, in single precision. With ``is_cube``, an .exr file says ``envmap = cube``, which
    suits only the projection ``cube-openexr``. The file appears only when it is complete. Raises
    :class:`LightdomeError` for other types, shapes and suffixes, and if the file cannot be written.
    """
    path = checks.path(path)
    suffix = path.suffix.lower()
    pixels = checks.array("an image", pixels, ("H", "W", 3))
    if suffix not in LINEAR + DISPLAYED:
        raise LightdomeError(f"cannot write {path}: the name of an image must end in {', '.join(LINEAR + DISPLAYED)}")
    if 0 in pixels.shape:
        raise LightdomeError(f"cannot write {path}: an image of shape {pixels.shape} has no pixels")
    if suffix in DISPLAYED and pixels.dtype != np.uint8:
        raise LightdomeError(
            f"cannot write {path}: {suffix} holds 8-bit values, got {pixels.dtype}; give radiance to tone_map first,"
            " or write a .pfm or .exr"
        )
    if suffix in LINEAR:
        if pixels.dtype.kind != "f":
            raise LightdomeError(
                f"cannot write {path}: {suffix} holds radiance, floating point, got {pixels.dtype}; write 8-bit values"
                " as .ppm or .png"
            )
        if pixels.dtype.itemsize > 4 and (np.isfinite(pixels) & (np.abs(pixels) > LARGEST)).any():
            raise LightdomeError(f"cannot write {path}: values must be at most {LARGEST:.3g}; scale them down")
        pixels = pixels.astype(np.float32, copy=False)
    height, width, channels = pixels.shape
    spec = oiio.ImageSpec(width, height, channels, oiio.UINT8 if suffix in DISPLAYED else oiio.FLOAT)
    if suffix == ".ppm":
        spec.attribute("pnm:pfmflip", 0)
        spec.attribute("pnm:binary", 1)
    if is_cube:
        spec.attribute("textureformat", "CubeFace Environment")
    with replacing(path) as temporary:
        if suffix == ".pfm":  # OpenImageIO before 3.2 scrambles files larger than 64 MiB
            with temporary.open("wb") as stream:
                stream.write(b"PF\n%d %d\n-1.0000\n" % (width, height))
                stream.write(np.ascontiguousarray(pixels[::-1], "<f4").data)
            return
        name = utf8_name(temporary)
        file = oiio.ImageOutput.create(name)
        if file is None:
            raise cannot_write(path, reason(oiio.geterror))
        done = file.open(name, spec) and file.write_image(np.ascontiguousarray(pixels))
        done = file.close() and done
        if not done:
            raise cannot_write(path, reason(file.geterror))
