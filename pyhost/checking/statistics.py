"""The error that sampling causes in an image of the sphere, measured by moments.

The moments of an image are its products with the Zernike polynomials up to degree 4. If all pixels share N samples
drawn in proportion to the light, the error is smooth, and the map determines the covariance of the moments and the tail
of their distribution. If each pixel has fresh samples, the error is noise, and the covariance is measured from the
noise of the image itself.

Sources: Born and Wolf, Principles of Optics, 9.2 (Zernike polynomials); Wilson and Hilferty, The Distribution of
Chi-Square (1931); Pharr, Jakob, Humphreys, Physically Based Rendering, 4th ed., 2.1 and 2.2 (variance, importance).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..disc import disc_mask
from ..evaluation.metrics import relative_rmse
from ..maps.envmap import EnvironmentMap
from ..maps.geometry import directions, solid_angles

DEGREE = 4  # of the polynomials
SAMPLES = 4096  # stand for all samples that can be drawn from a map
SETS = 400  # sets of samples drawn to measure their spread
TAIL = 3.0  # standard deviations at which the largest of those sets should lie


def normals(resolution: int) -> np.ndarray:
    """Unit normals of the pixels of the disc, (P, 3) float64, in the order of ``image[disc_mask(resolution)]``."""
    y, x = np.nonzero(disc_mask(resolution))
    a, b = (2 * x + 1 - resolution) / resolution, (resolution - 2 * y - 1) / resolution
    return np.stack([a, b, np.sqrt(np.maximum(0, 1 - a * a - b * b))], axis=1)


def zernike(normal: np.ndarray) -> np.ndarray:
    """Zernike polynomials up to degree 4, (P, 15), whose mean products over the disc are 1 with themselves, else 0."""
    radius, angle = np.hypot(normal[:, 0], normal[:, 1]), np.arctan2(normal[:, 1], normal[:, 0])
    columns = []
    for n in range(DEGREE + 1):
        for m in range(-n, n + 1, 2):
            k = np.arange((n - abs(m)) // 2 + 1)
            weights = [(-1) ** i * math.comb(n - i, i) * math.comb(n - 2 * i, (n - abs(m)) // 2 - i) for i in k]
            radial = sum(w * radius ** (n - 2 * i) for w, i in zip(weights, k, strict=True))
            turn = np.cos(m * angle) if m >= 0 else np.sin(-m * angle)
            columns.append(radial * turn * math.sqrt((n + 1) * (1 if m == 0 else 2)))
    return np.stack(columns, axis=1)


def moments(basis: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """The moments (45,) of an image: mean products of its pixels (P, 3) with ``basis`` (P, 15)."""
    return (basis.T @ pixels / len(pixels)).reshape(-1)


@dataclass(frozen=True)
class Expected:
    """The relative RMSE with ``count`` samples: its mean, and the limits between which nine of ten images lie."""

    count: int
    per_pixel: bool
    mean: float
    low: float
    high: float


@dataclass(frozen=True)
class Spread:
    """The distribution, over correct images, of d^T C^-1 d for the error d of the moments and their covariance C.

    - ``freedom``, ``stretch``: degrees of freedom and scale of the chi-square distribution with that mean and variance
    - ``tail``: divides standard deviations, since few samples have a longer tail than chi-square
    """

    freedom: float
    stretch: float = 1.0
    tail: float = 1.0

    @classmethod
    def of(cls, sizes: np.ndarray) -> Spread:
        """The distribution with the mean and variance of ``sizes``."""
        mean, variance = max(float(sizes.mean()), 1e-300), max(float(sizes.var()), 1e-300)
        result = cls(2 * mean**2 / variance, variance / (2 * mean))
        return cls(result.freedom, result.stretch, max(1.0, result.deviations(float(sizes.max())) / TAIL))

    def deviations(self, size: float) -> float:
        """How far off an equally unlikely normal number would be, in standard deviations."""
        share, part = size / (self.stretch * self.freedom), 2 / (9 * self.freedom)
        return (share ** (1 / 3) - (1 - part)) / math.sqrt(part) / self.tail


class Sampling:
    """What one sample, drawn in proportion to the light, contributes to the pixels with these normals (P, 3)."""

    def __init__(self, envmap: EnvironmentMap, albedo: float, normal: np.ndarray) -> None:
        self._known: dict[int, tuple[np.ndarray, float, float]] = {}  # by count
        drawn = population(envmap, SAMPLES)
        self.luminance, self.flux, self.probability = drawn.luminance, drawn.flux, drawn.probability
        self.cosine = np.maximum(0, normal @ drawn.direction.T)  # (P, S)
        self.light, p = drawn.light * albedo, self.probability
        light = self.light
        self.moments = moments_of_each(self.cosine, zernike(normal), light, p)
        self.covariance = (self.moments * p[:, None]).T @ self.moments
        self.mean = self.cosine @ (light * p[:, None])
        square = (self.mean**2).mean()
        self.variance = float(((self.cosine**2) @ (light**2 * p[:, None])).mean() / square - 1)  # relative

    def sets(self, count: int) -> np.ndarray:
        """Moments (400, 45), less their mean, of sets of ``count`` samples."""
        return self._drawn(count)[0]

    def expected(self, count: int, per_pixel: bool) -> Expected:
        """The relative RMSE with ``count`` samples."""
        mean = math.sqrt(self.variance / count)
        if per_pixel:  # an average over many independent errors hardly varies
            return Expected(count, True, mean, 0.9 * mean, 1.1 * mean)
        return Expected(count, False, mean, *self._drawn(count)[1:])

    def _drawn(self, count: int) -> tuple[np.ndarray, float, float]:
        """:meth:`sets`, and the limits between which nine of ten of their images' errors lie."""
        if count not in self._known:
            share = np.random.default_rng(0).multinomial(count, self.probability, SETS) / count
            few = self.cosine[::21]
            images = few @ (share.T[:, :, None] * self.light[:, None, :]).reshape(len(self.light), -1)
            images = images.reshape(len(few), SETS, 3)
            low, high = np.percentile([relative_rmse(images[:, i], self.mean[::21]) for i in range(SETS)], [5, 95])
            self._known[count] = share @ self.moments, float(low), float(high)
        return self._known[count]

    def square_by_cosine(self) -> np.ndarray:
        """The mean square (P, 3) of the contribution of a sample whose direction is drawn by the cosine."""
        return self.cosine @ (self.light**2 * (math.pi * self.probability * self.luminance / self.flux)[:, None])


@dataclass(frozen=True)
class Population:
    """Samples that stand for all that can be drawn from a map.

    - ``row``, ``column``: (S,), place in the map in pixels; centres are whole numbers
    - ``direction``: (S, 3)
    - ``light``: (S, 3), radiance of a white surface that faces this sample and is lit by it alone
    - ``luminance``: (S,), of the pixel
    - ``flux``: total luminance x solid angle of the map
    - ``probability``: (S,)
    """

    row: np.ndarray
    column: np.ndarray
    direction: np.ndarray
    light: np.ndarray
    luminance: np.ndarray
    flux: float
    probability: np.ndarray


def population(envmap: EnvironmentMap, count: int) -> Population:
    """``count`` samples: half of them by the light, half all over the sphere, so that unlikely ones are included."""
    height, width = envmap.height, envmap.width
    area = solid_angles(height, width)[:, None]
    light = envmap.radiance.mean(axis=2, dtype=np.float64)
    flux = light * area
    total = float(flux.sum())
    even = area * (light > 0)
    mixed = flux / total + even / even.sum()
    steps = np.cumsum(mixed)
    index = np.searchsorted(steps, (np.arange(count) + 0.5) / count * steps[-1]).clip(max=mixed.size - 1)
    probability = flux.reshape(-1)[index] / mixed.reshape(-1)[index]
    y, x = index // width, index % width
    within = np.random.default_rng(0).random((2, count)) - 0.5  # some programs draw from the whole area of a pixel
    row, column = y + within[0], x + within[1]
    towards = directions(np.pi * (row + 0.5) / height, 2 * np.pi * (column + 0.5) / width)
    colour = envmap.radiance[y, x].astype(np.float64) / light[y, x, None]
    each = colour * (total / math.pi)
    return Population(row, column, towards, each, light[y, x], total, probability / probability.sum())


def moments_of_each(cosine: np.ndarray, basis: np.ndarray, light: np.ndarray, probability: np.ndarray) -> np.ndarray:
    """Moments (S, 45), less their mean, of images lit by a single sample, from the cosines (P, S) of the samples."""
    of_cosine = cosine.T @ basis / len(basis)
    result = (of_cosine[:, :, None] * light[:, None, :]).reshape(len(light), -1)
    return result - probability @ result


def noise_of(basis: np.ndarray, residual: np.ndarray, side: int) -> np.ndarray:
    """The covariance of the moments that the noise of single pixels in ``residual`` (P, 3) causes."""
    mask = disc_mask(side)
    image = np.zeros((side, side, 3))
    image[mask] = residual - basis @ (basis.T @ residual / len(residual))
    rough = image - _box(image, 5) / np.maximum(_box(mask[..., None].astype(float), 5), 1)
    rough[~mask] = 0
    # A wide pixel filter makes neighbours alike, so their noise averages out less. Uniform blocks are not noise.
    whole = side // 4 * 4
    blocks = image[:whole, :whole].reshape(whole // 4, 4, whole // 4, 4, 3).sum(axis=(1, 3))
    alike = max(1.0, float((blocks**2).sum() / max((rough**2).sum(), 1e-300)))
    values = rough[mask]
    count, size = basis.shape[1], len(values)
    result = np.zeros((count, 3, count, 3))
    for c in range(3):
        for d in range(3):
            result[:, c, :, d] = (basis * (values[:, [c]] * values[:, [d]])).T @ basis
    return result.reshape(3 * count, 3 * count) * ((alike if alike < 16 else 1.0) / size**2)


def _box(image: np.ndarray, side: int) -> np.ndarray:
    """Sums over the ``side`` x ``side`` pixels around each pixel; outside the image they are 0."""
    before = side // 2 + 1
    sums = np.pad(image, ((before, side // 2), (before, side // 2), (0, 0))).cumsum(axis=0).cumsum(axis=1)
    return sums[side:, side:] - sums[side:, :-side] - sums[:-side, side:] + sums[:-side, :-side]
