"""A latitude-longitude environment map, checked, and the geometry of its pixels.

Row 0 is the top. Pixel centres lie at theta = pi (y + 1/2) / H and phi = 2 pi (x + 1/2) / W; their
directions are (sin theta cos phi, cos theta, sin theta sin phi), so +y is up.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from .errors import LightdomeError
from .images import ImageRows, read_image


def row_angles(height: int) -> np.ndarray:
    """Polar angles theta of the rows' centres, (height,) float64, radians."""
    return np.pi * (np.arange(height) + 0.5) / height


def column_angles(width: int) -> np.ndarray:
    """Azimuths phi of the columns' centres, (width,) float64, radians."""
    return 2 * np.pi * (np.arange(width) + 0.5) / width


def solid_angles(height: int, width: int) -> np.ndarray:
    """Solid angle of one pixel of each row, (height,) float64, steradians; over the map they sum to 4 pi.

    The integral of sin(theta) over the row is 2 sin(pi / 2H) sin(theta), exactly proportional to
    sin(theta) at the centre.
    """
    return 2 * np.pi / width * 2 * np.sin(np.pi / (2 * height)) * np.sin(row_angles(height))


@dataclass(frozen=True)
class EnvironmentMap:
    """Radiance by direction: ``radiance`` is (H, W, 3) float32, finite, and 0 or above.

    ``EnvironmentMap(radiance)`` checks what it is given and raises :class:`LightdomeError` that
    counts the bad pixels and names the first; with ``sanitize`` they become 0 instead. ``notes`` are remarks on the
    file that :meth:`read` read: the layer it took, a factor in the header that it divided out, ...
    """

    radiance: np.ndarray
    peak: float
    notes: tuple[str, ...] = ()

    def __init__(self, radiance: np.ndarray, *, sanitize: bool = False, name: str = "the map") -> None:
        radiance = np.ascontiguousarray(radiance, dtype=np.float32)
        if radiance.ndim != 3 or radiance.shape[2] != 3 or 0 in radiance.shape:
            raise LightdomeError(f"{name}: an environment map has shape (H, W, 3), not {radiance.shape}")
        inspection = Inspection()
        radiance = inspection.mended(radiance)
        if not sanitize:
            inspection.refuse_bad_pixels(name)
        object.__setattr__(self, "radiance", radiance)
        object.__setattr__(self, "peak", inspection.peak)

    @classmethod
    def read(cls, path: str | Path, *, sanitize: bool = False, layer: str | None = None) -> EnvironmentMap:
        """Read a PFM, EXR or Radiance HDR file, of an EXR file the layer that :func:`read_image` takes.

        Raises :class:`LightdomeError` where the file cannot be read or holds bad pixels.
        """
        notes = ImageRows(path, layer=layer).notes
        result = cls(read_image(path, layer), sanitize=sanitize, name=str(path))
        object.__setattr__(result, "notes", notes)
        return result

    @cached_property
    def is_grey(self) -> bool:
        """Whether the three channels are the same everywhere."""
        red, green, blue = np.moveaxis(self.radiance, 2, 0)
        return np.array_equal(red[0], green[0]) and np.array_equal(red, green) and np.array_equal(red, blue)

    @property
    def height(self) -> int:
        """Rows."""
        return self.radiance.shape[0]

    @property
    def width(self) -> int:
        """Columns."""
        return self.radiance.shape[1]

    @property
    def shape_note(self) -> str | None:
        """A remark on a map that is not twice as wide as high, which is allowed; else None."""
        return shape_note(self.height, self.width)


def shape_note(height: int, width: int) -> str | None:
    """A remark on a map that is not twice as wide as high, which is allowed; else None."""
    if width == 2 * height:
        return None
    return f"note: the map is {width} x {height}, not 2:1; it is stretched over the whole sphere of directions"


class Inspection:
    """What a map's values are, looked at row after row, in any order.

    ``peak`` is the largest value that is neither infinite nor NaN, 0 if there is none above
    """

    def __init__(self) -> None:
        self.peak = 0.0
        self._bad = 0
        self._kinds: Counter[str] = Counter()
        self._first: tuple[int, int, np.ndarray] | None = None  # y, x, and its value

    def mended(self, radiance: np.ndarray, first_row: int = 0) -> np.ndarray:
        """Look at rows ``first_row`` and following, (n, W, 3); the same, or a copy with 0 for every bad value."""
        # A NaN makes both extremes NaN, so two passes without temporaries see every bad value.
        lowest, peak = float(radiance.min()), float(radiance.max())
        if not (lowest >= 0 and peak < np.inf):
            self._count(radiance, first_row)
            radiance = np.where((radiance >= 0) & np.isfinite(radiance), radiance, np.float32(0))
            peak = float(radiance.max())
        self.peak = max(self.peak, peak)
        return radiance

    def _count(self, radiance: np.ndarray, first_row: int) -> None:
        kinds = {
            "NaN": np.isnan(radiance).any(axis=2),
            "infinite": np.isinf(radiance).any(axis=2),
            "negative": ((radiance < 0) & np.isfinite(radiance)).any(axis=2),
        }
        pixels = np.logical_or.reduce(list(kinds.values()))
        self._bad += int(pixels.sum())
        self._kinds.update({kind: int(found.sum()) for kind, found in kinds.items()})
        y, x = (int(i) for i in np.argwhere(pixels)[0])
        if self._first is None or first_row + y < self._first[0]:
            self._first = first_row + y, x, radiance[y, x]

    def refuse_bad_pixels(self, name: str) -> None:
        """Raise :class:`LightdomeError` if there were any, with their count and the first."""
        if self._first is None:
            return
        kinds = ", ".join(f"{n} {kind}" for kind, n in self._kinds.items() if n)
        y, x, (r, g, b) = self._first
        raise LightdomeError(
            f"{name}: {self._bad} bad pixel{'s' if self._bad > 1 else ''} ({kinds}), the first at x = {x}, y = {y}:"
            f" ({r:g}, {g:g}, {b:g}); mend the map, or replace them by black with --sanitize"
        )
