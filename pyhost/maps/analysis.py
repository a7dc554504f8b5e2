"""What is in a map: range, clipping, where its light comes from, its sun, and how many samples it needs.

A file is read twice, in bands of rows, so it may be larger than memory. All sums are in float64; each pixel counts as
the direction of its centre, with its exact solid angle. Luminance is I = (R + G + B) / 3, rounded to float32. Floats
that are not negative sort in the order of their bits, so two histograms of 2^16 bins, the second within one bin of the
first, give exact percentiles. NaN and negative values are counted, and otherwise taken as 0. So are infinite values,
except that in a file of half floats they are taken as 65504: there, they are most often a sun.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from .. import checks
from ..disc import disc_mask
from ..errors import LightdomeError
from ..float_range import LARGEST, LARGEST_HALF
from ..progress import Progress
from .envmap import EnvironmentMap, Inspection, Projected, shape_note
from .geometry import column_angles, directions, row_angles, solid_angles
from .images import ImageRows
from .sun import (
    CELL_ROWS,
    GROUP,
    MAX_RIVAL,
    PATCH,
    Cells,
    Patch,
    Region,
    Sun,
    azimuth_elevation,
    distance,
    find_region,
    luminance,
    measure,
)

BLOCK_PIXELS = 2**18
FINE = 4096  # rows; in a finer map, a sun spans a dozen pixels
SIDES = ("up", "down", "plus_x", "minus_x", "plus_z", "minus_z")
TOPS = (1, 10, 100)
PERCENTILES = (0.5, 0.99, 0.999)
DARKEST = 0.01  # share of the lit solid angle that the range ignores
DISC = 24  # pixels across the sphere; errors are averaged over their normals
# Values at which formats and programs clip.
LIMITS = {
    1.0: "white in display images",
    255 / 256: "white in display images stored as RGBE",
    255.0: "white in 8-bit images",
    65535.0: "white in 16-bit images",
    LARGEST_HALF: "the largest half float",
    LARGEST: "the largest float",
}
# A channel's top is flat if FLAT of the solid angle within NEARLY of the largest value has exactly that value. Of a
# smooth top, even in RGBE's steps of 1/256, only a small share has it.
NEARLY, FLAT = 0.75, 0.2


@dataclass(frozen=True)
class Clipping:
    """Whether the brightest light was cut off.

    - ``verdict``: ``"clipped"`` or ``"not clipped"``; ``reason``: why
    - ``maximum_rgb``: the largest finite value of each channel; ``pixels_at_maximum_rgb``: how many pixels have it
    - ``touching_pairs_rgb``: how many pairs of those pixels are neighbours in a row or a column
    - ``pixels_at_65504``, ``pixels_at_1``: pixels with exactly that value in any channel
    """

    verdict: str
    reason: str
    maximum_rgb: tuple[float, float, float]
    pixels_at_maximum_rgb: tuple[int, int, int]
    touching_pairs_rgb: tuple[int, int, int]
    pixels_at_65504: int
    pixels_at_1: int


@dataclass(frozen=True)
class Analysis:
    """What :func:`analyse` found. Radiance and luminance are in the map's own unit; ``_sr``: that unit x steradian.

    - ``format``: the file's, None for an array; ``projection``: ``"latlong"``; ``notes``: remarks
    - ``nan_pixels``, ``infinite_pixels``, ``negative_pixels``: pixels with such a value in any channel; minus infinity
      counts as negative
    - ``luminance_...``: over pixels; ``..._by_solid_angle``: weighted by solid angle, so that the many pixels at the
      poles do not count too much. Half of all directions are at most as bright as that median
    - ``range_stops``: log2 of the ratio of the maximum to the luminance below which 1 % of the lit solid angle lies
    - ``mean_radiance_rgb``: over all directions; ``flux_rgb_radiance_sr``: 4 pi times that
    - ``irradiance_..._rgb_radiance_sr``: on a surface that faces up (+y), down (-y), +x, -x, +z or -z
    - ``mean_direction_length``: length of the mean direction, weighted by flux: 0 for light from everywhere, 1 for
      light from one direction. ``mean_direction_azimuth_degrees`` and ``..._elevation_degrees`` are as in :class:`Sun`;
      they are None if the length is 0
    - ``flux_share_of_1_pixel``, ...: the share of the pixels that have the most flux
    - ``effective_pixels``: 1 / sum of p^2, where p is a pixel's share of the flux
    - ``samples_for_1_percent_error``: independent samples that all pixels share, see :func:`analyse`; None without
      light
    - ``sun``: the sun, or None; ``no_sun_reason``: why there is none
    """

    format: str | None
    projection: str
    width_pixels: int
    height_pixels: int
    notes: tuple[str, ...]
    nan_pixels: int
    infinite_pixels: int
    negative_pixels: int
    luminance_minimum: float
    luminance_median_by_solid_angle: float
    luminance_99_percent_by_solid_angle: float
    luminance_99_9_percent_by_solid_angle: float
    luminance_maximum: float
    range_stops: float | None
    clipping: Clipping
    mean_radiance_rgb: tuple[float, float, float]
    flux_rgb_radiance_sr: tuple[float, float, float]
    irradiance_up_rgb_radiance_sr: tuple[float, float, float]
    irradiance_down_rgb_radiance_sr: tuple[float, float, float]
    irradiance_plus_x_rgb_radiance_sr: tuple[float, float, float]
    irradiance_minus_x_rgb_radiance_sr: tuple[float, float, float]
    irradiance_plus_z_rgb_radiance_sr: tuple[float, float, float]
    irradiance_minus_z_rgb_radiance_sr: tuple[float, float, float]
    mean_direction_length: float
    mean_direction_azimuth_degrees: float | None
    mean_direction_elevation_degrees: float | None
    flux_share_of_1_pixel: float
    flux_share_of_10_pixels: float
    flux_share_of_100_pixels: float
    effective_pixels: float
    samples_for_1_percent_error: int | None
    sun: Sun | None
    no_sun_reason: str | None

    def to_dict(self) -> dict[str, object]:
        """Everything under the same names, for JSON: finite numbers, strings, None, lists and dicts."""
        return asdict(self)


@dataclass(frozen=True)
class SplitSun:
    """A map split in two: ``sun`` describes ``sun_map``; in ``rest``, the radiance around the sun fills its place."""

    sun: Sun
    sun_map: EnvironmentMap
    rest: EnvironmentMap


def analyse(
    source: str | Path | ImageRows | EnvironmentMap | np.ndarray, *, layer: str | None = None, flip: bool = False
) -> Analysis:
    """Say what is in a map: a file or its rows (read in bands), a map, or radiance (H, W, 3).

    ``layer`` and ``flip`` are as in :func:`lightdome.read_image`; :class:`lightdome.ImageRows` has its own. Bad values
    are counted, see the module's documentation.

    The number of samples is for the image of the sphere that :func:`lightdome.shade_samples` makes from ``independent``
    samples. With the one-sample estimate X = max(0, n . w) (L / I) Phi of the irradiance E, the relative RMSE of N
    samples is sqrt(sum of var X / sum of E^2 / N), where the sums are over the image's normals and channels. Other
    sequences need fewer samples.

    Raises :class:`LightdomeError` for a file that cannot be read, and for an array of another shape or without pixels.
    """
    return _examined(_Map.of(source, layer, flip))[0]


def analyse_resampled(read: Projected, envmap: EnvironmentMap) -> Analysis:
    """The analysis of ``envmap``, which was resampled from what was read, with the remarks on both."""
    analysis = analyse(envmap)
    remarks = (*read.notes, *([read.replaced.note] if read.replaced else []), *analysis.notes)
    return replace(analysis, projection=f"{read.projection}, resampled to latlong", notes=remarks)


def split_sun(envmap: EnvironmentMap) -> SplitSun:
    """Split the sun from the rest of a map; the two maps sum to the original, up to float32 rounding.

    In the rest, the radiance around the sun fills its place; the sun is what rises above that. A directional light from
    its ``direction_xyz`` with its ``flux_rgb_radiance_sr`` can replace ``sun_map``. Raises :class:`LightdomeError` for
    a map without a sun.
    """
    checks.instance("the map", envmap, EnvironmentMap)
    analysis, region = _examined(_Map.of(envmap, None, False))
    if analysis.sun is None or region is None:
        raise LightdomeError(f"the map has no sun to split off: {analysis.no_sun_reason}")
    sun, rest = np.zeros_like(envmap.radiance), envmap.radiance.copy()
    phi = column_angles(envmap.width)
    for y, theta in enumerate(row_angles(envmap.height)):
        row = rest[y]
        held = region.holds(directions(theta, phi), luminance(row.astype(np.float64)))
        row[held] = np.minimum(row[held], region.surroundings.astype(np.float32))
        sun[y] = envmap.radiance[y] - row
    maps = (checks.made(EnvironmentMap, radiance=r, peak=float(r.max()), replaced=None, notes=()) for r in (sun, rest))
    return SplitSun(analysis.sun, *maps)


class _Map:
    """A map whose rows can be read again and again."""

    def __init__(self, height: int, width: int, rows: ImageRows | None, radiance: np.ndarray | None) -> None:
        self.height, self.width = height, width
        self._rows = rows
        self._radiance = radiance
        self.inspection = self._fresh_inspection()

    @classmethod
    def of(cls, source: Any, layer: str | None, flip: bool) -> _Map:
        if isinstance(source, EnvironmentMap):
            return cls(source.height, source.width, None, source.radiance)
        if not isinstance(source, np.ndarray):
            rows = source if isinstance(source, ImageRows) else ImageRows(source, layer=layer, flip=flip)
            return cls(rows.height, rows.width, rows, None)
        radiance = checks.array("the map", source, ("H", "W", 3), np.float32)
        if 0 in radiance.shape:
            raise LightdomeError(f"the map must have at least one pixel, got shape {radiance.shape}")
        height, width, _ = radiance.shape
        return cls(height, width, None, radiance)

    def _fresh_inspection(self) -> Inspection:
        is_half = self._rows is not None and self._rows.largest == LARGEST_HALF
        return Inspection("clamp" if is_half else "black", LARGEST_HALF)

    @property
    def notes(self) -> tuple[str, ...]:
        notes = (*(self._rows.notes if self._rows else ()), shape_note(self.height, self.width))
        return tuple(note for note in notes if note)

    @property
    def format(self) -> str | None:
        if self._rows is None:
            return None
        with self._rows.path.open("rb") as file:
            start = file.read(2)
        if start == b"v/":
            return f"OpenEXR, {'half' if self._rows.largest == LARGEST_HALF else 'float'}"
        return "Radiance HDR" if start == b"#?" else "PFM"

    def blocks(self, label: str) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Row numbers and the rows' radiance, (n,) and (n, W, 3) float32, without bad values.

        Each block is small and lies in one row of :class:`Cells`. Blocks come in the file's order.
        """
        self.inspection = self._fresh_inspection()
        everything = np.arange(self.height)
        in_memory = [] if self._radiance is None else [(everything, self._radiance)]
        batches = self._rows.read(everything) if self._rows else in_memory
        most, done = max(1, BLOCK_PIXELS // self.width), 0
        with Progress(label) as progress:
            for rows, pixels in batches:
                cell_row = rows * CELL_ROWS // self.height
                begin = 0
                while begin < len(rows):
                    end = min(begin + most, int(np.searchsorted(cell_row, cell_row[begin], side="right")))
                    yield rows[begin:end], self.inspection.mended(pixels[begin:end], int(rows[begin]))
                    begin = end
                done += len(rows)
                progress.update(done / self.height)


class _Quantiles:
    """Exact weighted order statistics of non-negative float32 values, as the module's documentation says."""

    def __init__(self) -> None:
        self._high = np.zeros(2**15)
        self._zero = 0.0  # weight of values of 0
        self._low: dict[int, np.ndarray] = {}

    def count(self, values: np.ndarray, weights: np.ndarray) -> None:
        """The first pass."""
        self._high += np.bincount((values.view(np.uint32) >> 16).ravel(), weights.ravel(), 2**15)
        self._zero += float(weights[values == 0].sum())

    def aim(self, fractions: tuple[float, ...], of_lit: float) -> None:
        """Choose the quantiles: ``fractions`` of all weight, then ``of_lit`` of the weight of values above 0."""
        self._sums = np.cumsum(self._high)
        total = self._sums[-1]
        wanted = [fraction * total for fraction in fractions] + [self._zero + of_lit * (total - self._zero)]
        self._wanted = np.array(wanted) * (1 - 1e-12)  # allows for the rounding of sums
        self._bins = np.searchsorted(self._sums, self._wanted)
        self._low = {int(b): np.zeros(2**16) for b in self._bins}

    def refine(self, values: np.ndarray, weights: np.ndarray) -> None:
        """The second pass."""
        bits = values.view(np.uint32)
        for high, counts in self._low.items():
            inside = (bits >> 16) == high
            if inside.any():
                counts += np.bincount(bits[inside] & 0xFFFF, weights[inside], 2**16)

    def values(self) -> list[float]:
        """For each quantile, the smallest value with at least that fraction at or below it."""
        found = []
        for high, wanted in zip(self._bins.tolist(), self._wanted, strict=True):
            counts = self._low[high]
            low = np.searchsorted(self._sums[high] - self._high[high] + np.cumsum(counts), wanted)
            bits = high << 16 | min(int(low), int(np.flatnonzero(counts)[-1]))
            found.append(float(np.uint32(bits).view(np.float32)))
        return found


class _Light:
    """The first pass: sums, extremes, and the first histogram of the quantiles."""

    def __init__(self, height: int, width: int) -> None:
        self.theta, self.phi = row_angles(height), column_angles(width)
        self.solid_angles = solid_angles(height, width)
        towards_x, towards_z = np.cos(self.phi), np.sin(self.phi)
        sides = (np.ones(width), towards_x, -towards_x, towards_z, -towards_z)
        self._sides = np.maximum(sides, 0)
        self.cells = Cells()
        self.quantiles = _Quantiles()
        self.flux = np.zeros(3)
        self.irradiance = np.zeros((6, 3))
        self.square = 0.0
        self.top = np.zeros(TOPS[-1])  # the largest I x solid angle
        self.minimum, self.maximum = np.inf, -1.0
        self.brightest = np.zeros(3)  # direction of the first pixel with the largest luminance
        self.peaks = np.zeros(3, np.float32)
        self.at_half, self.at_one = 0, 0

    def add(self, rows: np.ndarray, radiance: np.ndarray) -> None:
        theta, solid_angle = self.theta[rows], self.solid_angles[rows]
        exact = radiance.astype(np.float64)
        of_sides = self._sides @ exact  # (n, 5, 3)
        self.flux += solid_angle @ of_sides[:, 0]
        cosine = np.cos(theta)
        self.irradiance[0] += (solid_angle * np.maximum(cosine, 0)) @ of_sides[:, 0]
        self.irradiance[1] += (solid_angle * np.maximum(-cosine, 0)) @ of_sides[:, 0]
        self.irradiance[2:] += np.tensordot(solid_angle * np.sin(theta), of_sides[:, 1:], 1)
        intensity = luminance(exact)
        self.cells.add(int(rows[0]) * CELL_ROWS // len(self.theta), solid_angle, theta, self.phi, exact, intensity)

        light = (intensity * solid_angle[:, None]).ravel()
        self.square += float(light @ light)
        most = np.partition(light, -len(self.top))[-len(self.top) :] if light.size > len(self.top) else light
        self.top = np.sort(np.concatenate([self.top, most]))[-len(self.top) :]
        if intensity.max() > self.maximum:
            y, x = np.unravel_index(np.argmax(intensity), intensity.shape)
            self.brightest = directions(theta[y], self.phi[x])
        self.minimum = min(self.minimum, float(intensity.min()))
        self.maximum = max(self.maximum, float(intensity.max()))
        self.quantiles.count(intensity.astype(np.float32), np.broadcast_to(solid_angle[:, None], intensity.shape))
        self.peaks = np.maximum(self.peaks, radiance.max(axis=(0, 1)))
        self.at_half += int((radiance == LARGEST_HALF).any(axis=2).sum())
        self.at_one += int((radiance == 1).any(axis=2).sum())

    @property
    def total(self) -> float:
        """The sum of I x solid angle."""
        return float(luminance(self.flux))


class _Tops:
    """The second pass, for each channel's largest value: how many pixels have it, touch, or come close."""

    def __init__(self, peaks: np.ndarray) -> None:
        self.peaks = peaks
        self.count, self.pairs = (np.zeros(3, np.int64) for _ in range(2))
        self.area, self.near = np.zeros(3), np.zeros(3)  # solid angle of the pixels that have it, and that come close
        self._edges: dict[tuple[str, int], np.ndarray] = {}  # edge rows of blocks whose neighbours are yet to come

    def add(self, rows: np.ndarray, solid_angle: np.ndarray, radiance: np.ndarray) -> None:
        at = (radiance == self.peaks) & (self.peaks > 0)
        of_rows = at.sum(axis=1)
        self.count += of_rows.sum(axis=0)
        self.area += solid_angle @ of_rows
        self.near += solid_angle @ (radiance >= np.float32(NEARLY) * self.peaks).sum(axis=1)
        if at.shape[1] > 1:
            self.pairs += (at & np.roll(at, 1, axis=1)).sum(axis=(0, 1))
        self.pairs += (at[1:] & at[:-1]).sum(axis=(0, 1))
        first, last = int(rows[0]), int(rows[-1])
        for edge, own, neighbour in (
            (at[0], ("above", first), ("below", first - 1)),
            (at[-1], ("below", last), ("above", last + 1)),
        ):
            if neighbour in self._edges:
                self.pairs += (edge & self._edges.pop(neighbour)).sum(axis=0)
            else:
                self._edges[own] = edge.copy()


class _Patches:
    """The second pass, around candidates for the sun."""

    def __init__(self, centres: list[np.ndarray], is_fine: bool) -> None:
        self.centres = centres
        self._is_fine = is_fine
        # If pixels are very large, none may be near a candidate.
        self._parts = [[(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))] for _ in centres]

    def add(self, theta: np.ndarray, phi: np.ndarray, solid_angle: np.ndarray, radiance: np.ndarray) -> None:
        for centre, parts in zip(self.centres, self._parts, strict=True):
            if np.abs(theta - np.arccos(np.clip(centre[1], -1, 1))).min() > PATCH:
                continue
            # In a fine map, the narrow pixels near a pole are merged.
            thin, width = 1, len(phi)
            while self._is_fine and 2 * thin * np.sin(theta).max() <= 1 and width % (2 * thin) == 0:
                thin *= 2
            direction = directions(theta[:, None], phi.reshape(-1, thin).mean(axis=1))
            y, x = np.nonzero(distance(direction, centre) <= PATCH)
            pixels = radiance.reshape(len(theta), -1, thin, 3)[y, x].astype(np.float64).mean(axis=1)
            parts.append((direction[y, x], pixels, thin * solid_angle[y]))

    def patches(self) -> Iterator[tuple[np.ndarray, Patch]]:
        for centre, parts in zip(self.centres, self._parts, strict=True):
            yield centre, Patch(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))


def _examined(of: _Map) -> tuple[Analysis, Region | None]:
    light = _Light(of.height, of.width)
    for rows, radiance in of.blocks("reading the map"):
        light.add(rows, radiance)
    bad = of.inspection.replaced(of.height, 0)
    light.quantiles.aim(PERCENTILES, DARKEST)
    tops = _Tops(light.peaks)
    patches = _Patches(_candidates(light), of.height > FINE)
    for rows, radiance in of.blocks("reading the map again"):
        solid_angle = light.solid_angles[rows]
        intensity = luminance(radiance.astype(np.float64)).astype(np.float32)
        light.quantiles.refine(intensity, np.broadcast_to(solid_angle[:, None], intensity.shape))
        tops.add(rows, solid_angle, radiance)
        patches.add(light.theta[rows], light.phi, solid_angle, radiance)

    infinite = bad.infinite if bad else 0
    clipping = _clipping(light, tops, infinite, of.height * of.width)
    sun, region, reason = _sun(light, tops, patches, clipping)
    *percentiles, darkest = light.quantiles.values()
    maximum = float(np.float32(light.maximum))
    is_lit = light.total > 0
    shares = {n: float(light.top[-n:].sum() / light.total) if is_lit else 0.0 for n in TOPS}
    vector = luminance(light.irradiance[::2] - light.irradiance[1::2])[[1, 0, 2]] / (light.total if is_lit else 1)
    length = float(np.linalg.norm(vector))
    towards = azimuth_elevation(vector) if length > 1e-12 else (None, None)
    analysis = Analysis(
        format=of.format,
        projection="latlong",
        width_pixels=of.width,
        height_pixels=of.height,
        notes=of.notes,
        nan_pixels=bad.nan if bad else 0,
        infinite_pixels=infinite,
        negative_pixels=bad.negative if bad else 0,
        luminance_minimum=float(np.float32(light.minimum)),
        luminance_median_by_solid_angle=percentiles[0],
        luminance_99_percent_by_solid_angle=percentiles[1],
        luminance_99_9_percent_by_solid_angle=percentiles[2],
        luminance_maximum=maximum,
        range_stops=float(np.log2(maximum / darkest)) if maximum > 0 else None,
        clipping=clipping,
        mean_radiance_rgb=_triple(light.flux / (4 * np.pi)),
        flux_rgb_radiance_sr=_triple(light.flux),
        **{
            f"irradiance_{side}_rgb_radiance_sr": _triple(of_side)
            for side, of_side in zip(SIDES, light.irradiance, strict=True)
        },
        mean_direction_length=length,
        mean_direction_azimuth_degrees=towards[0],
        mean_direction_elevation_degrees=towards[1],
        flux_share_of_1_pixel=shares[1],
        flux_share_of_10_pixels=shares[10],
        flux_share_of_100_pixels=shares[100],
        effective_pixels=light.total**2 / light.square if is_lit else 0.0,
        samples_for_1_percent_error=_samples(light.cells, light.total, 0.01),
        sun=sun,
        no_sun_reason=reason,
    )
    return analysis, region


def _triple(values: np.ndarray) -> Any:
    return tuple(values.tolist())


def _candidates(light: _Light) -> list[np.ndarray]:
    """Where the sun may be: towards the most light, and towards the brightest pixel, in case the sun is clipped."""
    if not light.total > 0:
        return []
    most = light.cells.brightest()
    return [most] if distance(most, light.brightest) < GROUP else [most, light.brightest]


def _clipping(light: _Light, tops: _Tops, infinite: int, pixels: int) -> Clipping:
    verdict, reason = "not clipped", _not_clipped(tops)
    c = int(np.argmax(tops.count))
    value, count = float(light.peaks[c]), int(tops.count[c])
    limit = next((name for limit, name in LIMITS.items() if abs(value / limit - 1) < 1e-6), None)
    channels = " and ".join(name for name, peak in zip("RGB", light.peaks, strict=True) if peak == light.peaks[c])
    if infinite:
        verdict, reason = "clipped", f"{infinite} pixel{'s are' if infinite > 1 else ' is'} infinite"
    elif 2 * count > pixels > 1:
        reason = f"most pixels have the largest value of {channels}, {value:g}"
    elif limit and count >= (1 if value > 65000 else 2):
        verdict = "clipped"
        reason = f"{count} pixel{'s are' if count > 1 else ' is'} at {value:g} in {channels}, {limit}"
    elif count >= 4 and 2 * tops.pairs[c] >= count and tops.area[c] >= FLAT * tops.near[c]:
        verdict = "clipped"
        reason = f"{count} touching pixels share the largest value of {channels}, {value:g}; perhaps an even lamp"
    return Clipping(
        verdict=verdict,
        reason=reason,
        maximum_rgb=_triple(light.peaks.astype(np.float64)),
        pixels_at_maximum_rgb=_triple(tops.count),
        touching_pairs_rgb=_triple(tops.pairs),
        pixels_at_65504=light.at_half,
        pixels_at_1=light.at_one,
    )


def _not_clipped(tops: _Tops) -> str:
    count = int(tops.count.max())
    if count == 0:
        return "there is no light"
    return f"{count} pixel{'s have' if count > 1 else ' has'} the largest value of any channel, {tops.peaks.max():g}"


def _sun(
    light: _Light, tops: _Tops, patches: _Patches, clipping: Clipping
) -> tuple[Sun | None, Region | None, str | None]:
    """The sun and its region, or why there is none, as found for the first candidate."""
    pixel = max(np.pi / len(light.theta), 2 * np.pi / len(light.phi))
    reasons = ["there is no light"] if not patches.centres else []
    for start, patch in patches.patches():
        region = find_region(patch, start, pixel)
        if isinstance(region, str):
            reasons.append(region)
            continue
        held = region.holds(patch.direction, patch.luminance)
        at_top = patch.solid_angle[held] @ (patch.radiance[held] == tops.peaks)
        is_clipped = clipping.verdict == "clipped" and bool((at_top > tops.area / 2).any())
        sun = measure(patch, region, light.total, is_clipped)
        if isinstance(sun, str):
            reasons.append(sun)
            continue
        rival = light.cells.rival(np.array(sun.direction_xyz)) / (sun.flux_share * light.total)
        if rival > MAX_RIVAL:
            reasons.append(f"another source has {100 * rival:.0f} % of the light of the brightest one")
            continue
        return sun, region, None
    return None, None, reasons[0]


def _samples(cells: Cells, total: float, error: float) -> int | None:
    """Independent samples for the relative RMSE ``error``, from sums over cells; see :func:`analyse`."""
    inside = np.argwhere(disc_mask(DISC)[::-1])
    across = (2 * inside[:, ::-1] + 1 - DISC) / DISC
    normal = np.concatenate([across, np.sqrt(1 - (across**2).sum(axis=1, keepdims=True))], axis=1)
    direction, variance, square = cells.direction, 0.0, 0.0
    for some in np.array_split(normal, DISC):
        cosine = np.maximum(some @ direction.T, 0)
        mean_squared = (cosine @ cells.flux) ** 2
        variance += float((total * (cosine**2 @ cells.second) - mean_squared).sum())
        square += float(mean_squared.sum())
    return max(1, int(np.ceil(variance / square / error**2))) if square > 0 else None
