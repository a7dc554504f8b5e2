"""A latitude-longitude environment map, checked, and the geometry of its pixels.

Row 0 is the top. Pixel centres lie at theta = pi (y + 1/2) / H and phi = 2 pi (x + 1/2) / W; their
directions are (sin(theta) cos(phi), cos(theta), sin(theta) sin(phi)), so +y is up.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from .. import checks
from ..errors import LightdomeError
from ..float_range import LARGEST, LARGEST_HALF
from .conventions import yaw_between
from .conversion import check_fits, convert, detected
from .geometry import row_angles
from .images import ImageRows, read_image
from .pictures import show
from .projections import PROJECTIONS
from .resample import resample
from .rotation import rotation_matrix, whole_columns

SANITIZE = ("black", "clamp")


@dataclass(frozen=True)
class Replaced:
    """What ``sanitize`` replaced bad values with, and how much light the replaced pixels carry.

    ``pixels`` had at least one bad value: ``nan`` of them NaN, ``infinite`` of them an infinite one, ``negative`` of
    them a negative one, which may be minus infinity. Infinities became ``infinity``; all others became 0. These pixels
    now carry ``flux_share`` of the map's flux, from 0 to 1.
    """

    pixels: int
    nan: int
    infinite: int
    negative: int
    infinity: float
    flux_share: float

    @property
    def note(self) -> str:
        """The same information as a line of text."""
        kinds = {"NaN by 0": self.nan, f"infinite by {self.infinity:g}": self.infinite, "negative by 0": self.negative}
        said = ", ".join(f"{n} {kind}" for kind, n in kinds.items() if n)
        plural = "s were" if self.pixels > 1 else " was"
        verb = "carry" if self.pixels > 1 else "carries"
        return (
            f"note: {self.pixels} bad pixel{plural} replaced ({said}) and now {verb} {100 * self.flux_share:.3g} %"
            " of the map's flux"
        )


@dataclass(frozen=True, eq=False)
class EnvironmentMap:
    """Radiance by direction: ``radiance`` is (H, W, 3) float32, finite, 0 or above, and read-only.

    ``EnvironmentMap(radiance)`` copies its array and checks it. Bad pixels raise a :class:`LightdomeError`, which
    counts them and names the first. With ``sanitize`` they are replaced instead, and ``replaced`` says how:
    ``"black"``, or True, makes each bad value 0; ``"clamp"`` makes infinite values the largest finite value of the
    array's type (65504 for half floats), and the others 0. ``notes`` are remarks on the file that :meth:`read` read:
    which layer it took, a factor in the header that it divided out, and so on.

    Maps are equal if their radiance is equal, whatever file they come from. They cannot be hashed.
    """

    radiance: np.ndarray
    peak: float
    replaced: Replaced | None
    notes: tuple[str, ...]

    def __init__(self, radiance: np.ndarray, *, sanitize: bool | str = False, name: str = "the map") -> None:
        inspection = Inspection(sanitize, largest_of(radiance))
        self._take(checks.array(name, radiance, ("H", "W", 3), np.float32, own=True), inspection, name)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, EnvironmentMap) and np.array_equal(self.radiance, other.radiance)

    def __repr__(self) -> str:
        return f"<EnvironmentMap: {self.width} x {self.height}, radiance up to {self.peak:.4g}>"

    def _repr_png_(self) -> bytes:
        return show(self.radiance)._repr_png_()

    @classmethod
    def read(
        cls,
        path: str | Path,
        *,
        sanitize: bool | str = False,
        layer: str | None = None,
        flip: bool = False,
        projection: str | None = None,
        convention: str = "lightdome",
    ) -> EnvironmentMap:
        """Read a PFM, EXR or Radiance HDR file; ``sanitize`` works as for the class, by the file's type.

        ``layer`` chooses a layer of an EXR file, as in :func:`read_image`. ``flip`` reverses the rows, for a file that
        was written upside down. ``projection`` is the file's projection, one of
        :data:`lightdome.maps.projections.PROJECTIONS`; by default :func:`lightdome.maps.conversion.detected` finds it.
        A map in any projection but latitude-longitude is resampled to that, with about as many pixels, and ``notes``
        say so. ``convention`` is that of the program for which a latitude-longitude file was made; see
        :mod:`lightdome.maps.conventions`. Raises :class:`LightdomeError` if the file cannot be read, does not fit its
        projection, or holds bad pixels.
        """
        yaw_between(convention, "lightdome")  # refuses an unknown convention before reading the file
        read = read_projected(
            path, sanitize=sanitize, layer=layer, flip=flip, projection=projection, convention=convention
        )
        radiance, peak, notes = read.radiance, read.peak, read.notes
        if read.projection != "latlong":
            radiance = convert(radiance, read.projection)
            peak = float(radiance.max())
            notes = (*notes, f"note: the map was resampled to {radiance.shape[1]} x {radiance.shape[0]} latlong pixels")
        result = object.__new__(cls)
        # Nothing else refers to the array just read, so it is not copied.
        result._set(radiance, peak, read.replaced, notes)
        return result.to_convention("lightdome", from_=convention)

    def _take(self, radiance: np.ndarray, inspection: Inspection, name: str) -> None:
        if 0 in radiance.shape:
            raise LightdomeError(f"{name} must have shape (H, W, 3) and at least one pixel, got shape {radiance.shape}")
        radiance = inspection.mended(radiance)
        inspection.refuse_bad_pixels(name)
        self._set(radiance, inspection.peak, inspection.replaced_in(radiance), ())

    def _set(self, radiance: np.ndarray, peak: float, replaced: Replaced | None, notes: tuple[str, ...]) -> None:
        radiance.flags.writeable = False
        fields = {"radiance": radiance, "peak": peak, "replaced": replaced, "notes": notes}
        for field, value in fields.items():
            object.__setattr__(self, field, value)

    def rotated(self, yaw: float, pitch: float = 0.0, roll: float = 0.0) -> EnvironmentMap:
        """The map after the world turns by angles in degrees; see :func:`lightdome.maps.rotation.rotation_matrix`.

        A yaw by whole columns moves the pixels unchanged. Any other rotation resamples them and keeps the flux. Raises
        :class:`LightdomeError` for an angle that is not finite.
        """
        matrix = rotation_matrix(yaw, pitch, roll)
        columns = whole_columns(self.width, matrix)
        if columns == 0:
            return self
        if columns is not None:
            return self._of_radiance(np.roll(self.radiance, columns, axis=1))
        latlong = PROJECTIONS["latlong"]
        return self._of_radiance(resample(self.radiance, latlong, latlong, self.radiance.shape[:2], matrix))

    def mirrored(self) -> EnvironmentMap:
        """The map with its columns in reverse: light from (x, y, z) comes from (x, y, -z)."""
        return self._of_radiance(np.ascontiguousarray(self.radiance[:, ::-1]))

    def to_convention(self, name: str, from_: str = "lightdome") -> EnvironmentMap:
        """The map as the program ``name`` reads it, so that it lights a scene there as this map does in lightdome.

        ``from_`` is the convention of this map. Both are names from :mod:`lightdome.maps.conventions`. The pixels stay
        as they are if the width is a multiple of 4 (of 2 for a half turn); otherwise the map is :meth:`rotated`. Raises
        :class:`LightdomeError` for an unknown convention.
        """
        return self.rotated(yaw_between(from_, name))

    def _of_radiance(self, radiance: np.ndarray) -> EnvironmentMap:
        """This map with ``radiance`` instead, which is not copied."""
        peak = float(radiance.max())
        return checks.made(EnvironmentMap, radiance=radiance, peak=peak, replaced=self.replaced, notes=self.notes)

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
        """A remark on a map that is not twice as wide as it is high, which is allowed; None for other maps."""
        return shape_note(self.height, self.width)


def shape_note(height: int, width: int) -> str | None:
    """A remark on a map that is not twice as wide as it is high, which is allowed; None for other maps."""
    if width == 2 * height:
        return None
    return f"note: the map is {width} x {height}, not 2:1; it is stretched over the whole sphere of directions"


@dataclass(frozen=True)
class Projected:
    """A map as it is in its file: checked ``radiance`` (H, W, 3), in the projection named ``projection``."""

    radiance: np.ndarray
    projection: str
    peak: float
    replaced: Replaced | None
    notes: tuple[str, ...]


def read_projected(
    path: str | Path,
    *,
    sanitize: bool | str = False,
    layer: str | None = None,
    flip: bool = False,
    projection: str | None = None,
    convention: str = "lightdome",
) -> Projected:
    """What :meth:`EnvironmentMap.read` reads, before it is resampled or turned; unused pixels are 0."""
    inspection = Inspection(sanitize)
    if checks.optional_text("projection", projection) is not None:
        checks.choice("projection", projection, PROJECTIONS)
    rows = ImageRows(path, layer=layer)
    if inspection.sanitize == "clamp":
        inspection.infinity = rows.largest
    radiance, notes = read_image(path, layer, flip), rows.notes
    if projection is None:
        projection, note = detected(radiance, rows.is_cube)
        notes = (*notes, note) if note else notes
    fitting = check_fits(projection, radiance.shape[:2], str(path))
    if projection != "latlong":
        if convention != "lightdome":
            raise LightdomeError(
                f"{path} is taken as {projection}, but conventions apply to latitude-longitude maps only; leave out"
                f" --convention {convention} and turn the map with --rotate"
            )
        inspection.solid_angles = fitting.solid_angles(radiance.shape[:2])
        radiance[inspection.solid_angles == 0] = 0
    radiance = inspection.mended(radiance)
    inspection.refuse_bad_pixels(str(path))
    return Projected(radiance, projection, inspection.peak, inspection.replaced_in(radiance), notes)


def largest_of(array: object) -> float:
    """The largest finite radiance that an array's type can hold: 65504 for half floats, else float32's."""
    return LARGEST_HALF if getattr(array, "dtype", None) == np.float16 else LARGEST


class Inspection:
    """Inspects a map's values, some rows at a time, in any order.

    - ``sanitize``: None, ``"black"`` or ``"clamp"``
    - ``infinity``: what infinite values become
    - ``peak``: the largest finite value, or 0 if none is above 0

    Raises :class:`LightdomeError` for any other ``sanitize``.
    """

    def __init__(self, sanitize: bool | str | None = None, largest: float = LARGEST) -> None:
        if sanitize is None or isinstance(sanitize, bool | np.bool_):
            sanitize = "black" if sanitize else None
        elif not (isinstance(sanitize, str) and sanitize in SANITIZE):
            names = " or ".join(map(repr, SANITIZE))
            raise LightdomeError(f"sanitize must be False, {names}, got {checks.told(sanitize)}")
        self.sanitize = sanitize
        self.infinity = largest if sanitize == "clamp" else 0.0
        self.peak = 0.0
        self.solid_angles: np.ndarray | None = None  # (H, W), for a map read all at once that is not latitude-longitude
        self.found = 0  # bad pixels
        self._kinds: Counter[str] = Counter()
        self._first: tuple[int, int, np.ndarray] | None = None  # y, x, and its value
        self._light: dict[int, float] = {}  # R + G + B of replaced pixels, by row

    def mended(self, radiance: np.ndarray, first_row: int = 0) -> np.ndarray:
        """Inspect the rows (n, W, 3) that start at ``first_row``; return them, or a copy without bad values."""
        # A NaN makes both extremes NaN, so two passes without temporaries see every bad value.
        lowest, peak = float(radiance.min()), float(radiance.max())
        if not (lowest >= 0 and peak < np.inf):
            bad = self._count(radiance, first_row)
            infinite = radiance == np.inf
            radiance = np.where((radiance >= 0) & ~infinite, radiance, np.float32(0))
            radiance[infinite] = self.infinity
            peak = float(radiance.max())
            y, x = np.nonzero(bad)
            light = radiance[y, x].sum(axis=1, dtype=np.float64)
            if self.solid_angles is not None:
                light *= self.solid_angles[y, x]
            light = np.bincount(y, light, len(radiance))
            self._light.update({first_row + int(row): float(light[row]) for row in np.unique(y)})
        self.peak = max(self.peak, peak)
        return radiance

    def _count(self, radiance: np.ndarray, first_row: int) -> np.ndarray:
        kinds = {
            "NaN": np.isnan(radiance).any(axis=2),
            "infinite": (radiance == np.inf).any(axis=2),
            "negative": (radiance < 0).any(axis=2),
        }
        pixels = np.logical_or.reduce(list(kinds.values()))
        self.found += int(pixels.sum())
        self._kinds.update({kind: int(found.sum()) for kind, found in kinds.items()})
        y, x = (int(i) for i in np.argwhere(pixels)[0])
        if self._first is None or first_row + y < self._first[0]:
            self._first = first_row + y, x, radiance[y, x].copy()
        return pixels

    def refuse_bad_pixels(self, name: str) -> None:
        """Raise :class:`LightdomeError` for bad pixels that are not to be replaced, with their count."""
        if self._first is None or self.sanitize:
            return
        kinds = ", ".join(f"{n} {kind}" for kind, n in self._kinds.items() if n)
        y, x, (r, g, b) = self._first
        clamp = ", or infinite ones by the largest value with --sanitize clamp" if self._kinds["infinite"] else ""
        raise LightdomeError(
            f"{name}: {self.found} bad pixel{'s' if self.found > 1 else ''} ({kinds}), the first at x = {x}, y = {y}:"
            f" ({r:g}, {g:g}, {b:g}); fix the map, or replace them by black with --sanitize{clamp}"
        )

    def replaced_in(self, radiance: np.ndarray) -> Replaced | None:
        """What was replaced in this map, once every row has been inspected."""
        if not self.found:
            return None
        if self.solid_angles is not None:
            return self.replaced(len(radiance), float(np.einsum("yxc,yx->", radiance, self.solid_angles)))
        rows = radiance.sum(axis=(1, 2), dtype=np.float64)
        return self.replaced(len(radiance), float(rows @ np.sin(row_angles(len(radiance)))))

    def replaced(self, height: int, total: float) -> Replaced | None:
        """What was replaced in a map of ``height`` rows, where (R + G + B) sin(theta) now sums to ``total``."""
        if not self.found:
            return None
        sine = np.sin(row_angles(height)) if self.solid_angles is None else np.ones(height)
        light = sum(light * sine[row] for row, light in self._light.items())
        return Replaced(
            pixels=self.found,
            nan=self._kinds["NaN"],
            infinite=self._kinds["infinite"],
            negative=self._kinds["negative"],
            infinity=self.infinity,
            flux_share=min(1.0, float(light / total)) if total > 0 else 0.0,
        )
