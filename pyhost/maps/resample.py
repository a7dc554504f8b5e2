"""Resample a map onto other pixels, in another projection or turned, with no flux lost.

A pixel of the result is the mean of the source over it. How much of pixel s lies in pixel t is found from points
that fill both images evenly, k x k in a pixel. Each stands for a small square of solid angle a and is shared by the
two pixels, or four, that the square touches. Where both images have points, with squares a of this image and a' of the
other, they weigh a / (1 + (a / a')^3): the finer points decide, which at the pole of a latitude-longitude image are its
own. This leaves an overlap w(s, t) with errors of a percent or so in its sums over s and over t, which must be the
solid angles W(t) and W(s). So it is balanced: with

    b(t) = W(t) / sum over s of w(s, t),    a(s) = W(s) / sum over t of w(s, t) b(t),

the base of the map, the least of each pixel and its four neighbours, is resampled with weights w b, by which a
constant stays constant, and what stands out from it with weights w a b, by which each source pixel keeps its flux. What
is left, about a thousandth of the flux at most, is a factor on the whole result, one for each channel.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from .. import checks
from ..errors import LightdomeError
from ..float_range import LARGEST
from ..progress import Progress
from .projections import Projection

POINTS = 2**21  # the least in an image, at most 8 x 8 in a pixel; there are 2 x 2 in large ones
AT_ONCE = 2**17  # points; their temporaries stay within the cache's reach
KEPT = 2**22  # points whose overlaps are kept from pass to pass, 72 bytes each; those of more are found again
PASSES = 3
TINY = 1e-300
ORTHOGONAL = 1e-6  # how far the product of a rotation with its transpose may be from 1


def resample(
    radiance: np.ndarray,
    source: Projection,
    target: Projection,
    shape: tuple[int, int],
    rotation: np.ndarray | None = None,
) -> np.ndarray:
    """The map ``radiance`` (H, W, 3), in the projection ``source``, on ``shape`` pixels of ``target``, float32.

    ``rotation`` (3, 3) turns the map, or mirrors it: what lay in direction d, a column, lies in ``rotation @ d``
    afterwards. Pixels that a projection does not use are 0. The flux, the sum of radiance times solid angle, is kept to
    1e-6, and a constant stays constant to 1e-6. Without a rotation, an image of the same projection and shape comes
    back bit for bit. Memory is that of the images, 40 bytes for each of their pixels, and 500 MB at most.

    Raises :class:`LightdomeError` for shapes that the projections do not have, for a rotation that is none, and for
    values that are not finite.
    """
    radiance = checks.array("radiance", radiance, ("H", "W", 3))
    for what, projection, size in (("the map", source, radiance.shape[:2]), ("the result", target, shape)):
        if not projection.fits(size):
            raise LightdomeError(
                f"{what} must have the sides {projection.aspect[0]}:{projection.aspect[1]} as {projection.name},"
                f" got {size[1]} x {size[0]} pixels"
            )
    if not np.isfinite(radiance).all():
        raise LightdomeError("the map must have finite values; replace NaN and infinite ones first")
    turn = np.eye(3) if rotation is None else checks.array("a rotation", rotation, (3, 3), np.float64)
    if not np.abs(turn @ turn.T - np.eye(3)).max() <= ORTHOGONAL:  # nor NaN
        raise LightdomeError("a rotation must be an orthogonal matrix, whose columns are perpendicular unit vectors")
    if (source.name, radiance.shape[:2]) == (target.name, tuple(shape)) and (turn == np.eye(3)).all():
        return radiance.astype(np.float32)
    return _resampled(radiance, _Grid(source, (len(radiance), radiance.shape[1])), _Grid(target, shape), turn)


class _Grid:
    """An image of ``shape`` in a ``projection``: the solid angles of its pixels, and points in them."""

    def __init__(self, projection: Projection, shape: tuple[int, int]) -> None:
        self.projection, self.shape = projection, shape
        self.solid_angles = projection.solid_angles(shape).ravel()
        self.owners = projection.owners(shape)
        used = np.count_nonzero(self.solid_angles)
        self.steps = int(np.clip(np.sqrt(POINTS / used), 2, 8))  # from point to point in a pixel
        self.points = used * self.steps**2  # of the whole image

    def spread(self) -> Iterator[tuple[np.ndarray, ...]]:
        """Yield the pixels of some points, flat indices (n,), their x and y, and their solid angles."""
        height, width = self.shape
        rows = max(1, AT_ONCE // width)
        offsets = (np.arange(self.steps) + 0.5) / self.steps
        for first in range(0, height, rows):
            j, i = np.arange(first, min(first + rows, height))[:, None], np.arange(width)
            pixel = j * width + i if self.owners is None else self.owners[j * width + i]
            for down in offsets:
                for right in offsets:
                    area = self.projection.density(i + right, j + down, self.shape) / self.steps**2
                    yield pixel, i + right, j + down, area

    def touched(self, x: np.ndarray, y: np.ndarray, side: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield the four pixels, or the same again, that squares round (x, y) touch, and the share of each."""
        parts = []
        for at, length, tiles in zip((y, x), self.shape, self.projection.tiles, strict=True):
            low = np.floor(at - side / 2)
            beyond = np.clip((at + side / 2 - low - 1) / side, 0, 1)
            tile = length // tiles
            first = np.minimum(at // tile, tiles - 1) * tile  # squares end where neighbours are none on the sphere
            both = (np.clip(low + n, first, first + tile - 1).astype(np.intp) for n in (0, 1))
            parts.append(list(zip(both, (1 - beyond, beyond), strict=True)))
        for row, down in parts[0]:
            for column, right in parts[1]:
                pixel = row * self.shape[1] + column
                yield pixel if self.owners is None else self.owners[pixel], down * right


def _overlaps(own: _Grid, other: _Grid, turn: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Yield overlaps: flat indices of pixels of both grids, (n,) and (4, n), and solid angles (4, n).

    They are those of the points of ``own``; ``turn`` leads from its directions to those of ``other``.
    """
    for pixel, x, y, area in own.spread():
        used = area > 0
        direction = own.projection.directions(x, y, own.shape)[used]
        pixel, area = pixel[used], area[used]
        x, y = other.projection.positions(direction @ turn.T, other.shape)
        density = np.maximum(other.projection.density(x, y, other.shape), TINY)
        ratio = area * other.steps**2 / density
        weight = area / (1 + ratio * ratio * ratio)  # ** would take ten times as long
        touched = list(other.touched(x, y, np.sqrt(np.minimum(ratio / other.steps**2, 1))))
        yield pixel, np.stack([index for index, _ in touched]), np.stack([weight * share for _, share in touched])


class _Weights:
    """Solid angles of source pixels in target pixels, found by the points of both grids."""

    def __init__(self, source: _Grid, target: _Grid, turn: np.ndarray, progress: Progress) -> None:
        self._ways = ((source, target, turn), (target, source, turn.T))
        self._points = source.points + target.points
        self._progress, self._done = progress, 0
        self._kept = list(self._found()) if self._points <= KEPT else None

    def __iter__(self) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Yield indices of source and of target pixels, one (n,), the other (4, n), and their overlaps (4, n)."""
        return iter(self._kept or self._found())

    def _found(self) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        for way, (own, other, turn) in enumerate(self._ways):
            for pixel, touched, weight in _overlaps(own, other, turn):
                yield (touched, pixel, weight) if way else (pixel, touched, weight)
                self._done += len(pixel)
                self._progress.update(min(1.0, self._done / (PASSES * self._points)))


def _add(total: np.ndarray, index: np.ndarray, values: np.ndarray) -> None:
    """Add values (4, n) to the pixels ``index``, (4, n) or, the same for all four, (n,)."""
    np.add.at(total, index.ravel(), values.ravel() if index.ndim == 2 else values.sum(axis=0))


def _quotient(solid_angles: np.ndarray, found: np.ndarray) -> np.ndarray:
    return np.divide(solid_angles, found, out=np.zeros_like(found), where=found > 0)


def _base(values: np.ndarray, used: np.ndarray) -> np.ndarray:
    """The least of each value and those of its four neighbours that are used, (H, W)."""
    least = np.where(used, values, np.inf)
    result = least.copy()
    for axis in (0, 1):
        one, other = np.moveaxis(result, axis, 0), np.moveaxis(least, axis, 0)
        np.minimum(one[1:], other[:-1], out=one[1:])
        np.minimum(one[:-1], other[1:], out=one[:-1])
    return np.where(used, result, 0)


def _resampled(radiance: np.ndarray, source: _Grid, target: _Grid, turn: np.ndarray) -> np.ndarray:
    with Progress("resampling the map") as progress:
        weights = _Weights(source, target, turn, progress)
        in_target = np.zeros(target.solid_angles.size)
        for _, t, weight in weights:
            _add(in_target, t, weight)
        of_target = _quotient(target.solid_angles, in_target)
        in_source = np.zeros(source.solid_angles.size)
        for s, t, weight in weights:
            _add(in_source, s, weight * of_target[t])
        of_source = _quotient(source.solid_angles, in_source)

        used = source.solid_angles.reshape(source.shape) > 0
        values = []
        for plane in np.moveaxis(radiance, 2, 0).astype(np.float64):
            base = _base(plane, used).ravel()
            values.append(base + of_source * (plane.ravel() - base))
        sums = np.zeros((3, target.solid_angles.size))
        for s, t, weight in weights:
            for total, value in zip(sums, values, strict=True):
                _add(total, t, weight * value[s])

    result = np.empty((*target.shape, 3), np.float32)
    for channel, total in enumerate(sums):
        flux = total * _quotient(target.solid_angles, in_target)
        wanted = source.solid_angles @ radiance[..., channel].ravel().astype(np.float64)
        factor = wanted / flux.sum() if flux.any() else 1.0
        plane = np.minimum(factor * _quotient(flux, target.solid_angles), LARGEST)
        result[..., channel] = plane.reshape(target.shape)
    return result
