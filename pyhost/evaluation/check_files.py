"""Reading the images that other renderers wrote: radiance, or a picture for the eye."""

from __future__ import annotations

import math
import zipfile
from pathlib import Path

import numpy as np
import OpenImageIO as oiio

from .. import checks
from ..errors import LightdomeError, one_line
from ..maps.images import READABLE, read_image
from ..maps.oiio_files import open_input, reason

PICTURES = {".png": (b"\x89PNG",), ".ppm": (b"P3", b"P6")}  # and how such files begin
MAX_PIXELS = 2**26  # of a picture or an array
GAMMA = 2.2


def read_rendered(path: str | Path, gamma: float = GAMMA) -> tuple[np.ndarray, bool]:
    """An image (h, w, 3) float32, row 0 at the top, and whether its values are linear.

    PFM, EXR and HDR hold radiance; of an NPZ file the array ``image`` does. PNG and PPM hold values 0 to 1 for the eye,
    from which ``gamma`` is taken. Raises :class:`LightdomeError` for another kind, and for what cannot be read.
    """
    path, gamma = checks.path(path), checks.positive("gamma", gamma)
    suffix = path.suffix.lower()
    if suffix in READABLE:
        return read_image(path), True
    if suffix not in (*PICTURES, ".npz"):
        known = ", ".join((*READABLE, *PICTURES, ".npz"))
        raise LightdomeError(f"{path}: not an image that can be checked; give one of {known}")
    if not path.is_file():  # a pipe would be waited for
        raise LightdomeError(f"cannot read {path}: there is no such file")
    if suffix == ".npz":
        return _array(path), True
    with np.errstate(over="ignore"):
        return (_picture(path, PICTURES[suffix]).astype(np.float64) ** gamma).astype(np.float32), False


def _picture(path: Path, starts: tuple[bytes, ...]) -> np.ndarray:
    """The values 0 to 1 of a picture, (h, w, 3) float32."""
    with path.open("rb") as stream:
        if not stream.read(8).startswith(starts):
            raise LightdomeError(f"{path} is damaged or of another kind: it does not begin like a {path.suffix} file")
    source = open_input(path)
    if source is None:
        raise LightdomeError(f"{path} is damaged or of another kind: {reason(oiio.geterror)}")
    try:
        spec = source.spec()
        if spec.width * spec.height > MAX_PIXELS:
            raise LightdomeError(f"{path}: {spec.width} x {spec.height} pixels are too many to be checked")
        colours = 3 if spec.nchannels >= 3 else 1
        pixels = source.read_image(0, 0, 0, colours, "float")
        if pixels is None:
            raise LightdomeError(f"{path} is damaged: {reason(source.geterror)}")
    finally:
        source.close()
    return np.broadcast_to(pixels.reshape(spec.height, spec.width, colours), (spec.height, spec.width, 3))


def _array(path: Path) -> np.ndarray:
    """The array ``image`` of an ``.npz`` file, after a look at its header, so that no lie there costs memory."""
    try:
        with zipfile.ZipFile(path) as archive:
            if "image.npy" not in archive.namelist():
                raise LightdomeError(f"{path} has no array named image")
            with archive.open("image.npy") as stream:
                if np.lib.format.read_magic(stream) != (1, 0):
                    raise ValueError("unknown version of the array format")
                shape, _, dtype = np.lib.format.read_array_header_1_0(stream)
            if len(shape) != 3 or shape[2] != 3 or dtype.kind not in "fiu":
                raise LightdomeError(f"{path}: image must be numbers of shape (h, w, 3), got {dtype} {shape}")
            if math.prod(shape) > 3 * MAX_PIXELS:
                raise LightdomeError(f"{path}: {shape[1]} x {shape[0]} pixels are too many to be checked")
            with archive.open("image.npy") as stream:
                pixels = np.lib.format.read_array(stream, allow_pickle=False)
    except (MemoryError, LightdomeError):
        raise
    except Exception as error:  # zipfile, zlib and numpy have no class of errors in common
        raise LightdomeError(f"{path} is damaged or no .npz file: {one_line(error)}") from error
    with np.errstate(over="ignore"):
        return pixels.astype(np.float32)
