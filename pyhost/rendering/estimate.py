"""The error of a Monte Carlo image without the exact one, from a few independent images of the same scene.

Let X_i be N independent images with the same mean, such as those of N seeds. Their average M is the result, and its
error is estimated from their spread, whatever points each of them is made from. With the covariance S of the three
channels of a pixel over the images, and sums over pixels,

    V = sum of tr(S) / N          estimates the squared error E of M
    V / (sum of M^2 - V)          estimates the square of its relative RMSE

How far E may be from V: E - V is the mean over i != j of x_i . x_j, where x_i is the error of X_i, so its variance is

    2 tr(C^2) / (N (N - 1))

whatever the distribution of x_i, where C is the covariance of all pixels. Fresh samples make pixels independent, so
tr(C^2) is the sum over pixels of tr(S^2) with the true S. Two estimates of it are made, and the larger one is taken.
The first is unbiased and uses each pixel by itself; it misses rare bright samples unless two of them fall in one pixel.
The second, tr(S S') over pairs of different pixels nearby, assumes that their covariances are alike. A normal error
would make E / V follow the F distribution with k and k (N - 1) degrees of freedom, k = tr(C)^2 / tr(C^2), which has
this variance. Its quantiles give the interval.

Source: Owen, Monte Carlo theory, methods and examples, chapters 2 and 17 (replicated randomised QMC); Satterthwaite, An
Approximate Distribution of Estimates of Variance Components (1946); Himeno and Yamada, Estimations for Some Functions
of Covariance Matrix in High Dimension under Non-normality (2014), on tr(C^2); Pharr, Jakob, Humphreys, Physically Based
Rendering, 4th ed., 2.1.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from .. import checks
from ..disc import check_resolution, disc_mask
from ..errors import LightdomeError
from ..float_range import to_float32

NEARBY = 4  # pixels side by side that share a covariance, nearly
PIXELS = 2**14  # that are worked on at a time
PAIRS = (0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)  # of channels: the entries of S
TWICE = np.array([1.0, 1, 1, 2, 2, 2])  # how often each is in the whole matrix
Z = 2.0  # a normal variable is within +-Z standard deviations in 95.4 % of cases
ROUNDING = 1e-6  # relative error of an image by single precision, which no spread shows


@dataclass(frozen=True, eq=False)
class ErrorEstimate:
    """The average of independent images, and its error as their spread tells it.

    - ``image``: (R, R, 3) float32, radiance
    - ``error``: (R, R) float32, radiance: the standard error of each pixel, root mean square of the channels; 0 outside
      the sphere
    - ``rmse``: the relative RMSE over the sphere's pixels, as :mod:`lightdome.evaluation.metrics` has it;
      infinite if noise hides the image
    - ``interval``: the relative RMSE's interval of 95 %
    """

    image: np.ndarray
    error: np.ndarray
    rmse: float
    interval: tuple[float, float]


def estimate_error(images: Iterable[np.ndarray]) -> ErrorEstimate:
    """Average ``images``, at least four of shape (R, R, 3), and estimate the error of the average.

    The images must be independent, with the same number of samples, and pixels must not share samples. Light that no
    sample has found is in neither the image nor its error. Raises :class:`LightdomeError` for fewer than four images,
    for other shapes, and for values on the sphere that are not finite.
    """
    try:
        given = list(images)
    except TypeError:
        raise LightdomeError(f"an error estimate needs a list of images, got {checks.told(images)}") from None
    count = len(given)
    if count < 4:
        raise LightdomeError(f"an error estimate needs at least four independent images, got {count}")
    resolution = check_resolution(len(checks.array("an image", given[0], ("R", "R", 3))))
    flat = [checks.array("an image", image, (resolution, resolution, 3)).reshape(-1, 3) for image in given]
    inside = np.flatnonzero(disc_mask(resolution))
    mean = np.zeros((resolution**2, 3))
    error = np.zeros(resolution**2)
    power = spread = 0.0  # sums of M^2 and tr(S)
    neighbours = own = weighted = 0.0  # sums for tr(C^2), from pixels nearby and from each alone, and of M . S M
    for first in range(0, len(inside), PIXELS):
        at = inside[first : first + PIXELS]
        values = np.empty((count, 3, len(at)))
        for image, of_image in zip(flat, values, strict=True):
            of_image[:] = image.take(at, axis=0).T
        if not np.isfinite(values).all():
            raise LightdomeError("an image must hold finite numbers, got infinity or NaN")
        average = values.mean(axis=0)
        values -= average
        S = np.stack([(values[:, c] * values[:, d]).sum(axis=0) for c, d in PAIRS]) / (count - 1)
        variance = S[:3].sum(axis=0)
        mean[at] = average.T
        error[at] = np.sqrt(variance / (3 * count))
        power += float((average**2).sum())
        spread += float(variance.sum())
        neighbours += _sum_of_products(S, S)
        fourth = (np.einsum("ncp,ncp->np", values, values) ** 2).sum() / (count - 1)
        own += float((count - 1) * (count - 2) * (TWICE @ S**2).sum() + (variance**2).sum() - count * fourth)
        weighted += _sum_of_products(np.stack([average[c] * average[d] for c, d in PAIRS]), S)
    own *= (count - 1) / (count * (count - 2) * (count - 3))
    rmse, interval = _relative(power, spread / count, max(own, neighbours), weighted, count)
    shape = (resolution, resolution)
    return ErrorEstimate(to_float32(mean.reshape(*shape, 3)), to_float32(error.reshape(shape)), rmse, interval)


class Spread:
    """The spread of independent arrays of the same mean, added one by one (Welford 1962)."""

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.count, self.squares = 0, 0.0
        self.mean = np.zeros(shape)

    def add(self, values: np.ndarray) -> None:
        """Add an array."""
        self.count += 1
        before = values - self.mean
        self.mean += before / self.count
        self.squares += float((before * (values - self.mean)).sum())

    def of_one(self) -> float | None:
        """The relative RMSE to expect of one of them; None if there are fewer than two."""
        if self.count < 2:
            return None
        variance = self.squares / (self.count - 1)
        return _ratio(float((self.mean**2).sum()), variance, self.count) ** 0.5


def _ratio(power: float, variance: float, count: int) -> float:
    """``variance`` over the squares of the true image, from the sum ``power`` of those of the average of ``count``."""
    if variance == 0:
        return 0.0
    signal = power - variance / count
    return variance / signal if signal > 0 else math.inf


def _sum_of_products(A: np.ndarray, B: np.ndarray) -> float:
    """The sum over pixels of tr(A B), from estimates (6, P) of the matrices of pixels side by side.

    Each matrix is multiplied with those of other pixels nearby, whose errors are independent of its own.
    """
    own = TWICE @ (A * B)
    if len(own) == 1:
        return float(own[0])
    starts = np.arange(max(1, len(own) // NEARBY)) * NEARBY  # the last one has the rest, too
    sizes = np.diff(np.append(starts, len(own)))
    together = [np.add.reduceat(each, starts, axis=1) for each in (A, B)]
    pairs = TWICE @ (together[0] * together[1]) - np.add.reduceat(own, starts)
    return float((pairs / (sizes - 1)).sum())


def _relative(
    power: float, squared: float, products: float, weighted: float, count: int
) -> tuple[float, tuple[float, float]]:
    """The relative RMSE and its interval, from sums over pixels; ``squared`` is V."""
    ratio = _ratio(power, count * squared, count) / count
    if ratio == 0:
        return 0.0, (0.0, ROUNDING)
    if math.isinf(ratio):
        return math.inf, (0.0, math.inf)
    signal = power - squared
    # The variance of log E / V, and of the logarithm of the signal, which matters only if the noise is as large.
    variance = 2 * products / (count * (count - 1)) / squared**2 * (1 + ratio) ** 2
    variance += 4 * max(0.0, weighted - products / count) / (count * signal**2)
    k = 2 * count / ((count - 1) * variance) if variance > 0 else math.inf
    rmse = math.sqrt(ratio)
    low, high = (rmse * math.sqrt(quantile) for quantile in _f_quantiles(k, k * (count - 1)))
    return rmse, (max(0.0, low - ROUNDING), high + ROUNDING)


def _f_quantiles(one: float, other: float) -> tuple[float, float]:
    """The quantiles 2.5 % and 97.5 % of the F distribution with these degrees of freedom.

    By the normal approximation of its cube root (Paulson 1942; Abramowitz and Stegun 26.6.15).
    """
    a, b = 2 / (9 * one), 2 / (9 * other)
    # (1 - b) y - (1 - a) = +-Z sqrt(b y^2 + a), y = F^(1/3)
    square, product = (1 - b) ** 2 - Z**2 * b, (1 - a) * (1 - b)
    rest = (1 - a) ** 2 - Z**2 * a
    if square <= 0:
        return 0.0, math.inf
    root = math.sqrt(max(0.0, product**2 - square * rest))
    return max(0.0, (product - root) / square) ** 3, ((product + root) / square) ** 3
