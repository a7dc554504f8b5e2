"""Resample a map onto other pixels, in another projection or rotated, without losing flux.

A pixel of the result is the mean of the source over its area. How much of source pixel s lies in target pixel t is
found from points that fill both images evenly, k x k per pixel. Each point stands for a small square of solid angle a,
which is shared by the two or four pixels that it touches. Where the points of both images meet, with squares a in one
and a' in the other, a point weighs a / (1 + (a / a')^3): the finer points decide, which at the pole of a
latitude-longitude image are its own. The resulting overlap w(s, t) has errors of about a percent in its sums over s and
over t, which must be the solid angles W(t) and W(s). So it is balanced, with

    b(t) = W(t) / sum over s of w(s, t),    a(s) = W(s) / sum over t of w(s, t) b(t).

The base of the map, in each pixel the minimum of it and its four neighbours, is resampled with weights w b, which keep
a constant constant. What rises above the base is resampled with weights w a b, which keep each source pixel's flux.
A factor on the whole result, one per channel, corrects the rest, at most about a thousandth of the flux.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from .. import checks
from ..errors import LightdomeError
from ..float_range import LARGEST
from ..progress import Progress
from .projections import Projection

POINTS = 2**21  # points in an image, at least; at most 8 x 8 per pixel, and 2 x 2 per pixel in a large image
AT_ONCE = 2**15  # points per batch, so that temporary arrays fit in the cache
KEPT = 2**24  # points whose overlaps are kept between passes, 20 bytes each; the rest are found again
THREADS = min(8, os.cpu_count() or 1)  # numpy releases Python's lock
AHEAD = 2 * THREADS  # batches started before they are needed
PASSES = 3
TINY = 1e-300
ORTHOGONAL = 1e-6  # how far the product of a rotation with its transpose may be from 1

_Points = tuple[int, float, float]  # the first row of a batch, and its points' place in each pixel, down and right
_Batch = tuple[int, _Points]  # 0 for points of the source, 1 for those of the target


def resample(
    radiance: np.ndarray,
    source: Projection,
    target: Projection,
    shape: tuple[int, int],
    rotation: np.ndarray | None = None,
) -> np.ndarray:
    """The map ``radiance`` (H, W, 3), in the projection ``source``, on ``shape`` pixels of ``target``, float32.

    ``rotation`` (3, 3) turns or mirrors the map: what lay in direction d, a column vector, then lies in
    ``rotation @ d``. Pixels that a projection does not use are 0. The flux, the sum of radiance times solid angle, is
    kept to within 1e-6, and a constant stays constant to within 1e-6. Without a rotation, an image of the same
    projection and shape comes back bit for bit. Memory is 60 bytes per pixel of both images, plus up to 500 MB.

    Raises :class:`LightdomeError` for shapes that do not fit the projections, for a matrix that is not a rotation, and
    for values that are not finite.
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
    if not np.abs(turn @ turn.T - np.eye(3)).max() <= ORTHOGONAL:  # also catches NaN
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
        self.steps = int(np.clip(np.sqrt(POINTS / used), 2, 8))  # points along the side of a pixel
        self.points = used * self.steps**2  # of the whole image
        self._rows = max(1, AT_ONCE // shape[1])

    def batches(self) -> Iterator[_Points]:
        """Yield all points in batches."""
        offsets = (np.arange(self.steps) + 0.5) / self.steps
        for first in range(0, self.shape[0], self._rows):
            for down in offsets:
                for right in offsets:
                    yield first, down, right

    def points_of(self, batch: _Points) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The pixels that points count towards, flat indices (n,), with directions (n, 3) and solid angles (n,)."""
        (height, width), (first, down, right) = self.shape, batch
        j, i = np.arange(first, min(first + self._rows, height))[:, None], np.arange(width)
        pixel = j * width + i if self.owners is None else self.owners[j * width + i]
        area = self.projection.density(i + right, j + down, self.shape) / self.steps**2
        direction = self.projection.directions(i + right, j + down, self.shape)
        used = area > 0
        if used.all():  # copies would take a tenth of the total time
            return pixel.ravel(), direction.reshape(-1, 3), area.ravel()
        return pixel[used], direction[used], area[used]

    def touched(self, x: np.ndarray, y: np.ndarray, side: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The first of the four pixels touched by squares around (x, y), and the shares in the next row and column."""
        first, shares = np.zeros(len(x), np.intp), []
        for at, length, tiles in zip((y, x), self.shape, self.projection.tiles, strict=True):
            start = at - side / 2
            low = np.floor(start)
            beyond = np.maximum(0, 1 - (low + 1 - start) / side)
            tile = length // tiles
            begin = np.minimum(at // tile, tiles - 1) * tile if tiles > 1 else 0
            # Squares end where neighbours in the image are not neighbours on the sphere.
            beyond[(low < begin) | (low >= begin + tile - 1)] = 0
            first = first * length + np.clip(low, begin, begin + tile - 1).astype(np.intp)
            shares.append(beyond)
        return first, *shares


class _Overlap(NamedTuple):
    """The overlap of points of one grid, each in a ``pixel`` of that grid, with the pixels of the other.

    The solid angle ``weight`` of each point lies in four pixels from ``first`` on, with the share ``down`` in the next
    row and the share ``right`` in the next column. All entries take 4 bytes, since many are kept.
    """

    pixel: np.ndarray
    first: np.ndarray
    down: np.ndarray
    right: np.ndarray
    weight: np.ndarray

    def spread(self, grid: _Grid) -> tuple[np.ndarray, np.ndarray]:
        """The four pixels, (4, n) flat indices of ``grid``, and the solid angles in each, (4, n)."""
        below, beside = grid.shape[1] * (self.down > 0), self.right > 0
        touched = np.empty((4, len(self.first)), np.intp)
        touched[0] = self.first
        np.add(touched[0], beside, out=touched[1])
        np.add(touched[:2], below, out=touched[2:])
        weight = np.empty(touched.shape)
        np.multiply(self.weight, self.right, out=weight[1])
        np.subtract(self.weight, weight[1], out=weight[0])
        np.multiply(weight[:2], self.down, out=weight[2:])
        weight[:2] -= weight[2:]
        return touched if grid.owners is None else grid.owners[touched], weight


def _overlap(own: _Grid, other: _Grid, turn: np.ndarray, batch: _Points) -> _Overlap:
    """The overlap of a batch of points of ``own``; ``turn`` takes its directions to those of ``other``."""
    pixel, direction, area = own.points_of(batch)
    # No matrix product: BLAS would start its own threads each time.
    turned = np.stack([sum(direction[:, k] * row[k] for k in range(3)) for row in turn], axis=-1)
    x, y = other.projection.positions(turned, other.shape)
    density = np.maximum(other.projection.density(x, y, other.shape), TINY)
    ratio = area * other.steps**2 / density
    weight = area / (1 + ratio * ratio * ratio)  # ** would take ten times as long
    first, down, right = other.touched(x, y, np.sqrt(np.minimum(ratio / other.steps**2, 1)))
    return _Overlap(
        pixel.astype(np.int32),
        first.astype(np.int32),
        *(values.astype(np.float32) for values in (down, right, weight)),
    )


class _Weights:
    """How much solid angle source and target pixels share, found from the points of both grids."""

    def __init__(
        self, source: _Grid, target: _Grid, turn: np.ndarray, pool: ThreadPoolExecutor, progress: Progress
    ) -> None:
        self._grids = source, target
        self._ways = ((source, target, turn), (target, source, turn.T))
        self._pool, self._progress, self._done = pool, progress, 0
        self._batches = [(way, batch) for way, (own, _, _) in enumerate(self._ways) for batch in own.batches()]
        self._keep = source.points + target.points <= KEPT
        self._kept: dict[_Batch, _Overlap] = {}

    def added(self, to_target: bool, values: Sequence[np.ndarray]) -> list[np.ndarray]:
        """For each pixel of one grid, the sum over its overlaps of each of ``values`` in the pixels of the other.

        The sums do not depend on the number of threads.
        """
        totals = [np.zeros(self._grids[to_target].solid_angles.size) for _ in values]
        for index, parts in _ahead(self._pool, partial(self._parts, to_target, values), self._batches):
            for total, part in zip(totals, parts, strict=True):
                np.add.at(total, index, part)
            self._done += 1
            self._progress.update(self._done / (PASSES * len(self._batches)))
        return totals

    def _parts(
        self, to_target: bool, values: Sequence[np.ndarray], batch: _Batch
    ) -> tuple[np.ndarray, list[np.ndarray]]:
        """For the points of a batch: pixels (n,), and what each of ``values`` adds to them, (n,)."""
        way, points = batch
        own, other, turn = self._ways[way]
        overlap = self._kept.get(batch) or _overlap(own, other, turn, points)
        if self._keep:
            self._kept[batch] = overlap
        touched, weight = overlap.spread(other)
        if to_target == (own is self._grids[0]):  # from the points' own pixels to those they touch
            return touched.ravel(), [(weight * value[overlap.pixel]).ravel() for value in values]
        return overlap.pixel, [(weight * value[touched]).sum(axis=0) for value in values]


def _ahead(pool: ThreadPoolExecutor, function: Callable[[Any], Any], items: Iterable[Any]) -> Iterator[Any]:
    """Like ``pool.map``, but with few results waiting at a time."""
    waiting: deque[Future[Any]] = deque()
    for item in items:
        waiting.append(pool.submit(function, item))
        if len(waiting) > AHEAD:
            yield waiting.popleft().result()
    while waiting:
        yield waiting.popleft().result()


def _quotient(solid_angles: np.ndarray, found: np.ndarray) -> np.ndarray:
    return np.divide(solid_angles, found, out=np.zeros_like(found), where=found > 0)


def _base(values: np.ndarray, used: np.ndarray) -> np.ndarray:
    """The minimum of each value and its used neighbours, up to four, (H, W)."""
    least = np.where(used, values, np.inf)
    result = least.copy()
    for axis in (0, 1):
        one, other = np.moveaxis(result, axis, 0), np.moveaxis(least, axis, 0)
        np.minimum(one[1:], other[:-1], out=one[1:])
        np.minimum(one[:-1], other[1:], out=one[:-1])
    return np.where(used, result, 0)


def _resampled(radiance: np.ndarray, source: _Grid, target: _Grid, turn: np.ndarray) -> np.ndarray:
    with Progress("resampling the map") as progress, ThreadPoolExecutor(THREADS) as pool:
        weights = _Weights(source, target, turn, pool, progress)
        (in_target,) = weights.added(True, [np.broadcast_to(1.0, source.solid_angles.size)])
        of_target = _quotient(target.solid_angles, in_target)
        (in_source,) = weights.added(False, [of_target])
        of_source = _quotient(source.solid_angles, in_source)

        used = source.solid_angles.reshape(source.shape) > 0
        values = []
        for plane in np.moveaxis(radiance, 2, 0).astype(np.float64):
            base = _base(plane, used).ravel()
            values.append(base + of_source * (plane.ravel() - base))
        sums = weights.added(True, values)

    result = np.empty((*target.shape, 3), np.float32)
    for channel, total in enumerate(sums):
        flux = total * of_target
        wanted = source.solid_angles @ radiance[..., channel].ravel().astype(np.float64)
        factor = wanted / flux.sum() if flux.any() else 1.0
        plane = np.minimum(factor * _quotient(flux, target.solid_angles), LARGEST)
        result[..., channel] = plane.reshape(target.shape)
    return result
