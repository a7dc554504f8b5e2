"""Checks an image dropped on the page, as ``lightdome check image`` checks a file."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .. import checks
from ..checking.files import read_rendered
from ..checking.image import ImageCheck, check_image
from ..errors import LightdomeError
from ..maps.envmap import EnvironmentMap
from ..maps.images import ImageRows
from ..opencl.device import Device
from .messages import packed

MOST_BYTES = 2**26  # size of a file
MOST_PIXELS = 2**22  # size of its image: a compressed file may hold a far larger one
SUFFIXES = (".pfm", ".exr", ".hdr")
SHOWN = 512  # largest width of the images sent back, in pixels


@dataclass(frozen=True, eq=False)
class Checker:
    """Checks images lit by one of ``maps``, on its own device."""

    device: Device
    maps: Sequence[EnvironmentMap]

    def checked(self, options: Mapping[str, str], data: bytes) -> bytes:
        """The verdict on a file's content, and the images to show; raises :class:`LightdomeError` if it is no image.

        ``options``: the number of the ``map``, the file's ``suffix``, ``albedo``, and ``samples`` or ``spp`` if known.
        The content is stored under a name that this program chooses.
        """
        suffix = checks.choice("kind of file", options.get("suffix"), SUFFIXES)
        envmap = self.maps[_whole(options, "map", 0, len(self.maps) - 1) or 0]
        counts = {name: _whole(options, name, 1, 2**31 - 1) for name in ("samples", "spp")}
        try:
            albedo = float(options.get("albedo", 1))
        except ValueError:
            raise LightdomeError("the albedo must be a number") from None
        pixels, linear = _read(suffix, data)
        check = check_image(self.device, pixels, envmap, albedo=albedo, linear=linear, **counts)
        self.device.decisions.take()
        images = {"image": _small(check.image), "reference": _small(check.exact)}
        return packed({"kind": "checked", **_told(check)}, images)


def _read(suffix: str, data: bytes) -> tuple[np.ndarray, bool]:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, f"image{suffix}")
        path.write_bytes(data)
        try:
            rows = ImageRows(path)
            if rows.height * rows.width > MOST_PIXELS:
                raise LightdomeError(f"{rows.width} x {rows.height} pixels are too many; the limit is {MOST_PIXELS}")
            return read_rendered(path)
        except LightdomeError as error:
            raise LightdomeError(str(error).replace(str(path), "the file")) from None


def _whole(options: Mapping[str, str], name: str, low: int, high: int) -> int | None:
    text = options.get(name, "")
    if text == "":
        return None
    if not (text.isascii() and text.isdigit() and len(text) < 12):
        raise LightdomeError(f"{name} must be a whole number from {low} to {high}")
    return checks.whole(name, int(text), low, high)


def _told(check: ImageCheck) -> dict[str, object]:
    cause = check.cause and {"seen": check.cause.seen, "where": check.cause.where}
    height, width = check.file_shape
    return {**check.to_dict(), "cause_told": cause, "file_width": width, "file_height": height}


def _small(image: np.ndarray) -> np.ndarray:
    """Every n-th pixel, so that the image is at most SHOWN pixels wide."""
    step = -(-len(image) // SHOWN)
    return np.ascontiguousarray(image[step // 2 :: step, step // 2 :: step], np.float32)
