"""OpenEXR files packed by hand, by the format's document: plain scan lines, any channels, attributes and parts."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

PIXEL_TYPES = {np.dtype(np.uint32): 0, np.dtype(np.float16): 1, np.dtype(np.float32): 2}
Box = tuple[int, int, int, int]


def attribute(name: str, kind: str, value: bytes) -> bytes:
    return name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<i", len(value)) + value


@dataclass
class Part:
    """``channels`` are planes (h, w) of float16, float32 or uint32; a plane smaller than the window is subsampled."""

    channels: Mapping[str, np.ndarray]
    name: str = ""
    attributes: Mapping[str, tuple[str, bytes]] = field(default_factory=dict)  # name: (type, value)
    window: Box | None = None
    display: Box | None = None
    deep: bool = False  # a deep part, with no samples in any pixel

    def __post_init__(self) -> None:
        height, width = max(plane.shape for plane in self.channels.values())
        self.window = self.window or (0, 0, width - 1, height - 1)
        self.width = self.window[2] - self.window[0] + 1
        self.height = self.window[3] - self.window[1] + 1

    def header(self, multipart: bool) -> bytes:
        channels = b""
        for name, plane in sorted(self.channels.items()):
            steps = self.width // plane.shape[1], self.height // plane.shape[0]
            channels += name.encode() + b"\0" + struct.pack("<iiii", PIXEL_TYPES[plane.dtype], 0, *steps)
        attributes = {
            "channels": ("chlist", channels + b"\0"),
            "compression": ("compression", b"\0"),
            "dataWindow": ("box2i", struct.pack("<4i", *self.window)),
            "displayWindow": ("box2i", struct.pack("<4i", *(self.display or self.window))),
            "lineOrder": ("lineOrder", b"\0"),
            "pixelAspectRatio": ("float", struct.pack("<f", 1)),
            "screenWindowCenter": ("v2f", struct.pack("<ff", 0, 0)),
            "screenWindowWidth": ("float", struct.pack("<f", 1)),
        }
        if multipart or self.deep:
            attributes["type"] = ("string", b"deepscanline" if self.deep else b"scanlineimage")
            attributes["chunkCount"] = ("int", struct.pack("<i", self.height))
            if multipart:
                attributes["name"] = ("string", self.name.encode())
        if self.deep:
            attributes["version"] = ("int", struct.pack("<i", 1))
            attributes["maxSamplesPerPixel"] = ("int", struct.pack("<i", 0))
        attributes |= self.attributes
        return b"".join(attribute(name, *rest) for name, rest in attributes.items()) + b"\0"

    def chunks(self) -> list[bytes]:
        """A chunk per scan line, without the part's number."""
        result = []
        for y in range(self.height):
            start = struct.pack("<i", self.window[1] + y)
            if self.deep:
                counts = bytes(4 * self.width)
                result.append(start + struct.pack("<QQQ", len(counts), 0, 0) + counts)
                continue
            row = b""
            for _, plane in sorted(self.channels.items()):
                step = self.height // plane.shape[0]
                row += b"" if y % step else plane[y // step].astype(plane.dtype.newbyteorder("<")).tobytes()
            result.append(start + struct.pack("<i", len(row)) + row)
        return result


def exr_file(*parts: Part) -> bytes:
    """The bytes of a file with these parts."""
    multipart = len(parts) > 1
    flags = 0x1000 * multipart + 0x800 * any(part.deep for part in parts)
    content = struct.pack("<ii", 20000630, 2 | flags)
    content += b"".join(part.header(multipart) for part in parts) + b"\0" * multipart
    chunks = [[struct.pack("<i", n) * multipart + c for c in part.chunks()] for n, part in enumerate(parts)]
    at = len(content) + 8 * sum(map(len, chunks))
    table, body = b"", b""
    for chunk in (chunk for of_part in chunks for chunk in of_part):
        table += struct.pack("<Q", at + len(body))
        body += chunk
    return content + table + body


def planes(image: np.ndarray, names: str = "RGB", layer: str = "", kind: type = np.float16) -> dict[str, np.ndarray]:
    """The channels of (H, W, n) pixels, named by the letters of ``names`` in ``layer``."""
    prefix = f"{layer}." if layer else ""
    return {prefix + name: image[..., i].astype(kind) for i, name in enumerate(names)}
