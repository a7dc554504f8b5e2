"""Read images that other renderers wrote: linear radiance, or pictures encoded for a display."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenImageIO as oiio

from .. import checks
from ..errors import LightdomeError
from ..maps.images import READABLE, read_image
from ..maps.oiio_files import open_input, reason
from .tables import read_table

PICTURES = {".png": (b"\x89PNG",), ".ppm": (b"P3", b"P6")}  # with the first bytes of such files
MAX_PIXELS = 2**26
GAMMA = 2.2


def read_rendered(path: str | Path, gamma: float = GAMMA) -> tuple[np.ndarray, bool]:
    """An image (h, w, 3) float32, row 0 at the top, and whether its values are linear.

    PFM, EXR and HDR files, and the array ``image`` of an NPZ file, hold radiance. The values of PNG and PPM files are
    encoded for a display; they are decoded with ``gamma``. Raises :class:`LightdomeError` for any other kind of file,
    and for a file that cannot be read.
    """
    path, gamma = checks.path(path), checks.positive("gamma", gamma)
    suffix = path.suffix.lower()
    if suffix in READABLE:
        return read_image(path), True
    if suffix not in (*PICTURES, ".npz"):
        known = ", ".join((*READABLE, *PICTURES, ".npz"))
        raise LightdomeError(f"{path}: not an image that can be checked; use one of {known}")
    if not path.is_file():  # a pipe would block
        raise LightdomeError(f"cannot read {path}: there is no such file")
    if suffix == ".npz":
        return _array(path), True
    with np.errstate(over="ignore"):
        return (_picture(path, PICTURES[suffix]).astype(np.float64) ** gamma).astype(np.float32), False


def _picture(path: Path, starts: tuple[bytes, ...]) -> np.ndarray:
    """The encoded values of a picture, 0 to 1: (h, w, 3) float32."""
    with path.open("rb") as stream:
        if not stream.read(8).startswith(starts):
            raise LightdomeError(f"{path} is damaged or of another kind: it does not start like a {path.suffix} file")
    source = open_input(path)
    if source is None:
        raise LightdomeError(f"{path} is damaged or of another kind: {reason(oiio.geterror)}")
    try:
        spec = source.spec()
        if spec.width * spec.height > MAX_PIXELS:
            raise LightdomeError(f"{path}: {spec.width} x {spec.height} pixels are too many to check")
        colours = 3 if spec.nchannels >= 3 else 1
        pixels = source.read_image(0, 0, 0, colours, "float")
        if pixels is None:
            raise LightdomeError(f"{path} is damaged: {reason(source.geterror)}")
    finally:
        source.close()
    return np.broadcast_to(pixels.reshape(spec.height, spec.width, colours), (spec.height, spec.width, 3))


def _array(path: Path) -> np.ndarray:
    """The array ``image`` of an NPZ file."""
    pixels = read_table(path).get("image")
    if pixels is None:
        raise LightdomeError(f"{path} has no array of numbers named image")
    if pixels.ndim != 3 or pixels.shape[2] != 3:
        raise LightdomeError(f"{path}: image must have shape (h, w, 3), got {pixels.shape}")
    if pixels.size > 3 * MAX_PIXELS:
        raise LightdomeError(f"{path}: {pixels.shape[1]} x {pixels.shape[0]} pixels are too many to check")
    with np.errstate(over="ignore"):
        return pixels.astype(np.float32)
