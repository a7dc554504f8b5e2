"""Maps in every format, byte by byte from the specifications; ``exr_bytes.py`` has EXR's layers and parts."""

from __future__ import annotations

import struct

import numpy as np

IMAGE = np.arange(2 * 4 * 3, dtype=np.float32).reshape(2, 4, 3) / 4  # exact in half and in RGBE


def pfm(image: np.ndarray, order: str = "<") -> bytes:
    """Rows bottom up, as the format says."""
    kind = b"PF" if image.ndim == 3 else b"Pf"
    head = kind + b"\n%d %d\n" % image.shape[1::-1] + (b"-1.0\n" if order == "<" else b"1.0\n")
    return head + image[::-1].astype(order + "f4").tobytes()


def exr(image: np.ndarray) -> bytes:
    """Scan lines without compression, half floats, planes in the order B, G, R."""
    height, width = image.shape[:2]

    def attribute(name: bytes, kind: bytes, value: bytes) -> bytes:
        return name + b"\0" + kind + b"\0" + struct.pack("<i", len(value)) + value

    box = struct.pack("<4i", 0, 0, width - 1, height - 1)
    channels = b"".join(c + b"\0" + struct.pack("<iiii", 1, 0, 1, 1) for c in (b"B", b"G", b"R")) + b"\0"
    head = struct.pack("<ii", 20000630, 2)
    head += attribute(b"channels", b"chlist", channels)
    head += attribute(b"compression", b"compression", b"\0")
    head += attribute(b"dataWindow", b"box2i", box) + attribute(b"displayWindow", b"box2i", box)
    head += attribute(b"lineOrder", b"lineOrder", b"\0")
    head += attribute(b"pixelAspectRatio", b"float", struct.pack("<f", 1))
    head += attribute(b"screenWindowCenter", b"v2f", struct.pack("<ff", 0, 0))
    head += attribute(b"screenWindowWidth", b"float", struct.pack("<f", 1)) + b"\0"
    rows = [image[y, :, ::-1].T.astype("<f2").tobytes() for y in range(height)]
    start = len(head) + 8 * height
    table = b"".join(struct.pack("<Q", start + y * (8 + len(rows[0]))) for y in range(height))
    return head + table + b"".join(struct.pack("<ii", y, len(r)) + r for y, r in enumerate(rows))


def hdr(image: np.ndarray, size: bytes) -> bytes:
    """Flat RGBE pixels, exponent 2^3: values to 8 in steps of 1/32."""
    mantissa = np.rint(image * 32).astype(np.uint8)
    pixels = np.concatenate([mantissa, np.full((*image.shape[:2], 1), 128 + 3, np.uint8)], axis=2)
    return b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n" + size + b"\n" + pixels.tobytes()
