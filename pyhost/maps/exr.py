"""Read OpenEXR files: :mod:`lightdome.maps.exr_layers` chooses the channels, OpenImageIO unpacks them.

Half and single floats keep their values, infinities and NaN included; integers (UINT) are read as those numbers.
Luminance and chroma become R, G and B according to the file's chromaticities. Subsampled chroma is refused, because
versions of OpenImageIO treat it differently.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import OpenImageIO as oiio

from ..errors import LightdomeError, quoted
from ..float_range import LARGEST, LARGEST_HALF
from .exr_layers import Layer, Part, choose_layer
from .image_source import ImageSource, check_size, damaged
from .oiio_files import open_input, reason

# OpenEXR's time to read a header grows with the square of the number of attributes, and of channels.
HEADER_BYTES, ATTRIBUTES, CHANNELS_BYTES = 2**24, 2000, 2**18
MAX_OVERHANG = 2048  # pixels of a tile that may lie outside the image
REC_709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)  # OpenEXR's default chromaticities: R, G, B, white


@contextmanager
def open_exr(path: Path, layer: str | None) -> Iterator[ImageSource]:
    """An open EXR file. Raises :class:`LightdomeError` if it is damaged or has no such layer."""
    _check_header(path)
    file = open_input(path)
    if file is None:
        why = reason(oiio.geterror)
        if "ubsampled channels" in why:
            raise _subsampled(path)
        raise LightdomeError(f"{path}: OpenImageIO cannot read it: {why}")
    try:
        yield _source(path, file, layer)
    finally:
        file.close()


def _source(path: Path, file: oiio.ImageInput, name: str | None) -> ImageSource:
    specs = _specs(path, file)
    layer = choose_layer(path, [_part(path, spec) for spec in specs], name)
    if not file.seek_subimage(layer.part, 0):
        raise damaged(path, reason(file.geterror))
    spec = specs[layer.part]
    _check(path, spec)
    places = layer.colour or layer.grey
    luminance = _luminance_weights(path, spec) if layer.is_chroma else None
    columns = (spec.x, spec.x + spec.width)

    def read_channels(first: int, end: int, begin: int, stop: int, kind: oiio.BASETYPE) -> np.ndarray:
        lines = (spec.y + first, spec.y + end)
        if spec.tile_width:
            pixels = file.read_tiles(*columns, *lines, 0, 1, begin, stop, kind)
        else:
            pixels = file.read_scanlines(*lines, 0, begin, stop, kind)
        if pixels is None:
            raise damaged(path, reason(file.geterror))
        return pixels.reshape(end - first, spec.width, stop - begin)

    whole_numbers = [spec.channelformat(place).basetype == oiio.UINT32 for place in places]
    together = places == tuple(range(places[0], places[0] + len(places))) and not any(whole_numbers)

    def read(first: int, end: int) -> np.ndarray:
        if together:
            pixels = read_channels(first, end, places[0], places[0] + len(places), oiio.FLOAT)
        else:
            # Read integers as such: OpenImageIO would scale them so that the largest becomes 1.
            kinds = [oiio.UINT32 if whole else oiio.FLOAT for whole in whole_numbers]
            planes = [read_channels(first, end, c, c + 1, kind) for c, kind in zip(places, kinds, strict=True)]
            pixels = np.concatenate([plane.astype(np.float32, copy=False) for plane in planes], axis=2)
        if luminance is not None:
            return _from_chroma(pixels, luminance)
        return pixels if len(places) == 3 else np.repeat(pixels, 3, axis=2)

    is_half = all(spec.channelformat(place).basetype == oiio.HALF for place in places)
    return ImageSource(
        spec.height,
        spec.width,
        read,
        spec.get_int_attribute("Orientation", 1),
        # A batch that held only some of these rows would make OpenImageIO unpack them all again.
        together=max(1, spec.tile_height, spec.get_int_attribute("oiio:RowsPerChunk", 1)),
        largest=LARGEST_HALF if is_half else LARGEST,
        notes=tuple(_notes(path, spec, layer, chosen=name is not None)),
        is_cube=spec.get_string_attribute("textureformat") == "CubeFace Environment",
    )


def _check_header(path: Path) -> None:
    """Refuse a header that OpenEXR would be slow to read; OpenEXR reports other defects better."""
    with path.open("rb") as stream:
        data = stream.read(HEADER_BYTES)
    several_parts = len(data) > 8 and data[5] & 0x10
    at, count = 8, 0
    while at < len(data):
        name_end = data.find(b"\0", at, at + 256)
        if name_end == at:  # the end of a part's header
            if not (several_parts and count):
                return
            at, count = at + 1, 0
            continue
        kind_end = data.find(b"\0", name_end + 1, name_end + 257)
        if min(name_end, kind_end) < 0:
            return
        size = int.from_bytes(data[kind_end + 1 : kind_end + 5], "little")
        at, count = kind_end + 5 + size, count + 1
        if count > ATTRIBUTES or (data[name_end + 1 : kind_end] == b"chlist" and size > CHANNELS_BYTES):
            raise damaged(path, "its header has too many attributes or channels for an image")
    if len(data) == HEADER_BYTES:
        raise damaged(path, f"its header is longer than {HEADER_BYTES >> 20} MiB")


def _specs(path: Path, file: oiio.ImageInput) -> list[oiio.ImageSpec]:
    """The specification of every part."""
    specs = []
    for number in range(max(1, file.spec().get_int_attribute("oiio:subimages", 1))):
        if not file.seek_subimage(number, 0):
            raise damaged(path, reason(file.geterror))
        specs.append(file.spec())
    return specs


def _part(path: Path, spec: oiio.ImageSpec) -> Part:
    if spec.get_int_attribute("openexr:luminancechroma"):  # OpenImageIO before 3.2 calls them R, G, B and fails
        raise LightdomeError(
            f"{path}: this version of OpenImageIO cannot read luminance-chroma channels (Y, RY, BY);"
            " update OpenImageIO, or save the file as R, G, B"
        )
    try:
        views = spec.getattribute("multiView") or ()
        return Part(
            name=spec.get_string_attribute("name"),
            channels=spec.channelnames,
            view=spec.get_string_attribute("view"),
            views=views if isinstance(views, tuple) else (),
            deep=spec.deep,
        )
    except UnicodeDecodeError:
        raise damaged(path, "a name in its header is not valid UTF-8") from None


def _subsampled(path: Path) -> LightdomeError:
    return LightdomeError(
        f"{path}: some channels are subsampled, as in luminance-chroma files (Y, RY, BY); save the file as R, G, B"
    )


def _check(path: Path, spec: oiio.ImageSpec) -> None:
    width, height = spec.width, spec.height
    if spec.depth > 1:
        raise LightdomeError(f"{path}: cannot use an image of {width} x {height} x {spec.depth} pixels")
    if (spec.x, spec.y, width, height) != (spec.full_x, spec.full_y, spec.full_width, spec.full_height):
        raise LightdomeError(
            f"{path}: its data window differs from its display window, so it is not the whole map; save it uncropped"
        )
    # OpenImageIO allocates whole tiles, even if they extend far beyond the image.
    if spec.tile_width > width + MAX_OVERHANG or spec.tile_height > height + MAX_OVERHANG:
        raise LightdomeError(f"{path} is damaged: it claims tiles of {spec.tile_width} x {spec.tile_height} pixels")
    check_size(path, height, width, spec.nchannels)


def _notes(path: Path, spec: oiio.ImageSpec, layer: Layer, chosen: bool) -> Iterator[str]:
    if layer.label and not chosen:
        yield f"note: the map in {path} is its layer {quoted(layer.label)}; --layer NAME chooses another"
    if spec.get_string_attribute("textureformat") == "LatLong Environment":
        yield (
            f"note: {path} says envmap = latlong: OpenEXR places its outermost pixels on the border, the first and"
            " last rows on the poles; lightdome places their centres half a pixel inside, so that much is off"
        )


def _luminance_weights(path: Path, spec: oiio.ImageSpec) -> np.ndarray:
    """The weights of R, G and B in Y, by the file's chromaticities, (3,) float64; OpenEXR's ``computeYw``."""
    given = spec.getattribute("chromaticities")
    with np.errstate(all="ignore"):
        try:
            x, y = np.array(given if given is not None else REC_709, np.float64).reshape(4, 2).T
            weights = np.linalg.solve(np.stack([x, y, 1 - x - y])[:, :3], np.array([x, y, 1 - x - y])[:, 3]) * y[:3]
            weights /= weights.sum()
        except (ValueError, TypeError, np.linalg.LinAlgError):
            weights = np.full(3, np.nan)
    if not (np.isfinite(weights).all() and weights[1]):
        raise LightdomeError(f"{path}: its luminance and chroma cannot be converted: bad chromaticities in its header")
    return weights


def _from_chroma(pixels: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """R, G and B of Y, RY = (R - Y) / Y and BY = (B - Y) / Y, as in OpenEXR's ``YCAtoRGBA``."""
    luminance, red_chroma, blue_chroma = np.moveaxis(pixels.astype(np.float64), 2, 0)
    with np.errstate(all="ignore"):
        red, blue = (red_chroma + 1) * luminance, (blue_chroma + 1) * luminance
        green = (luminance - red * weights[0] - blue * weights[2]) / weights[1]
        is_grey = (red_chroma == 0) & (blue_chroma == 0)
        rgb = np.stack([red, np.where(is_grey, luminance, green), blue], axis=2)
        rgb[np.isposinf(luminance)] = np.inf  # a sun, where green would be NaN
        return rgb.astype(np.float32)
