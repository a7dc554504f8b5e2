"""Checks what a page asks for, and packs answers with arrays.

A page sends JSON. An answer is binary: the length of its header (4 bytes, little-endian); the header, as JSON, padded
with spaces to a multiple of 4 bytes; then the arrays, each padded to a multiple of 4 bytes. The header's ``arrays``
maps each name to ``shape``; ``type`` (``float16``, ``float32``, ``int32`` or ``uint8``); ``offset``, counted from the
end of the header; ``bytes``; and ``scale``, a factor for the values.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from .. import checks
from ..errors import LightdomeError
from ..names import ESTIMATORS, PIXEL_SEQUENCES, SEQUENCES

SHARED, CUT, HARMONICS = "shared", "median-cut", "harmonics"
METHODS = (SHARED, CUT, HARMONICS, *ESTIMATORS)
# The largest number of samples, lights or samples per pixel, or order: a frame should take seconds at most.
MOST = {SHARED: 65536, CUT: 4096, HARMONICS: 24, **dict.fromkeys(ESTIMATORS, 256)}
RESOLUTIONS = (16, 1023)
HALF_PEAK = 60000.0  # the largest value sent as a half float, below its limit of 65504


@dataclass(frozen=True)
class Setting:
    """What a page shows: a map turned by ``angles`` (yaw, pitch, roll; degrees), and one method's image under it."""

    map: int
    method: str
    sequence: str
    count: int
    seed: int
    angles: tuple[float, float, float]
    albedo: float
    resolution: int
    is_moving: bool  # the user is still dragging: speed matters more than precision
    # For a page without WebGL: an exposure factor, gamma, and the difference shown in full colour, in percent of the
    # brightest exact pixel. None for a page with WebGL.
    pictures: tuple[float, float, float] | None

    @property
    def is_per_pixel(self) -> bool:
        """Whether every pixel has its own samples, which need a turned map rather than turned lights."""
        return self.method in ESTIMATORS

    @property
    def pixels(self) -> str:
        """How the method treats the map's pixels: as centres or as areas."""
        return ESTIMATORS[self.method].pixels if self.is_per_pixel else "centres"


def parse_setting(values: Mapping[str, Any], maps: int) -> Setting:
    """The setting a page asks for; raises :class:`LightdomeError` for a missing or invalid value."""
    method = checks.choice("method", _of(values, "method"), METHODS)
    sequences = PIXEL_SEQUENCES if method in ESTIMATORS else SEQUENCES
    sequence = _of(values, "sequence")
    angles = tuple(_real(values, name, -1e6, 1e6) for name in ("yaw", "pitch", "roll"))
    pictures = None
    if values.get("pictures") is True:
        limits = {"exposure": (1e-30, 1e30), "gamma": (0.1, 10.0), "difference": (0.01, 1000.0)}
        exposure, gamma, difference = (_real(values, name, *limit) for name, limit in limits.items())
        pictures = exposure, gamma, difference
    return Setting(
        map=checks.whole("the map", _of(values, "map"), 0, maps - 1),
        method=method,
        sequence=checks.choice("sequence", sequence, sequences) if method == SHARED or method in ESTIMATORS else "",
        count=checks.whole("the count", _of(values, "count"), 0 if method == HARMONICS else 1, MOST[method]),
        seed=checks.whole("the seed", _of(values, "seed"), 0, 2**53),
        angles=angles,  # type: ignore[arg-type]
        albedo=_real(values, "albedo", 0.0, 100.0),
        resolution=checks.whole("the resolution", _of(values, "resolution"), *RESOLUTIONS),
        is_moving=values.get("moving") is True,
        pictures=pictures,
    )


def _of(values: Mapping[str, Any], name: str) -> Any:
    if name not in values:
        raise LightdomeError(f"{name} is missing")
    return values[name]


def _real(values: Mapping[str, Any], name: str, low: float, high: float) -> float:
    value = checks.real(name, _of(values, name), "a finite number", -np.inf)
    if not low <= value <= high:
        raise LightdomeError(f"{name} must be from {low:g} to {high:g}, got {value:g}")
    return value


def halved(values: np.ndarray) -> tuple[np.ndarray, float]:
    """Values scaled to fit half floats, and the factor that restores them."""
    peak = float(max(values.max(), -values.min()))
    scale = peak / HALF_PEAK if peak > 0 else 1.0
    return (values * np.float32(1 / scale) if 1 / scale < np.inf else values / scale).astype(np.float16), scale


def packed(header: Mapping[str, object], arrays: Mapping[str, np.ndarray | tuple[np.ndarray, float]]) -> bytes:
    """Pack an answer: a header, and arrays, alone or in a pair with their scale."""
    described, parts, offset = {}, [], 0
    for name, value in arrays.items():
        array, scale = value if isinstance(value, tuple) else (value, 1.0)
        array = np.ascontiguousarray(array)
        described[name] = {
            "shape": array.shape,
            "type": array.dtype.name,
            "offset": offset,
            "bytes": array.nbytes,
            "scale": scale,
        }
        padding = -array.nbytes % 4
        parts += [array.data.cast("B") if array.size else b"", bytes(padding)]
        offset += array.nbytes + padding
    text = json.dumps({**header, "arrays": described}, allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    return b"".join([len(text).to_bytes(4, "little"), text, *parts])
