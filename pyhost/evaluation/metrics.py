"""Error metrics, convergence rates, and comparisons of methods.

:mod:`lightdome.reference` has an independent relative RMSE.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..disc import disc_mask

if TYPE_CHECKING:
    from .benchmark import MethodMeasurement

LEVELS = (0.1, 0.03, 0.01, 0.003)  # relative RMSE at which methods are compared


def relative_rmse(pixels: np.ndarray, exact: np.ndarray) -> float:
    """sqrt(mean((pixels - exact)^2)) / sqrt(mean(exact^2)), for arrays of equal shape, in float64."""
    truth = exact.astype(np.float64)  # squares may exceed float32's range
    return float(np.sqrt(((pixels - truth) ** 2).mean() / (truth**2).mean()))


def left_after_averaging(image: np.ndarray, exact: np.ndarray, side: int) -> float:
    """The relative RMSE that remains when both images are averaged over squares of ``side`` pixels.

    Only squares inside the sphere count; NaN if there are none, or if no light falls on them.
    """
    whole = len(exact) // side * side
    inside = disc_mask(len(exact))[:whole, :whole].reshape(whole // side, side, -1, side).all(axis=(1, 3))

    def squares(pixels: np.ndarray) -> np.ndarray:
        blocks = pixels[:whole, :whole].astype(np.float64).reshape(whole // side, side, -1, side, 3)
        return blocks.mean(axis=(1, 3))[inside]

    truth = squares(exact)
    return relative_rmse(squares(image), truth) if truth.any() else float("nan")


def half_quartile_distance(values: Sequence[float]) -> float:
    """Half the distance between the quartiles, as the spread that goes with a median."""
    return float(np.subtract(*np.percentile(values, [75, 25])) / 2)


def exponent(sizes: Sequence[float], values: Sequence[float]) -> float | None:
    """The b of the fit values ~ sizes^b, None for fewer than two sizes or values of zero."""
    if len(set(sizes)) < 2 or min(values) <= 0:
        return None
    return float(np.polyfit(np.log(sizes), np.log(values), 1)[0])


def slope(points: Sequence[MethodMeasurement]) -> float | None:
    """The exponent b of the fit rmse ~ count^b, None for fewer than two counts."""
    return exponent([m.count for m in points], [m.rmse for m in points])


def cheapest(points: Iterable[MethodMeasurement], error: float) -> MethodMeasurement | None:
    """The fastest measurement with at most ``error``, or None if there is none."""
    return min((m for m in points if m.rmse <= error), key=lambda m: m.wall_seconds, default=None)


def most_exact(points: Iterable[MethodMeasurement], seconds: float) -> MethodMeasurement | None:
    """The most accurate measurement of at most ``seconds``, or None if there is none."""
    return min((m for m in points if m.wall_seconds <= seconds), key=lambda m: m.rmse, default=None)


def pareto_front(points: Iterable[MethodMeasurement]) -> list[MethodMeasurement]:
    """The measurements that no other beats in both time and error, by increasing time."""
    front: list[MethodMeasurement] = []
    for point in sorted(points, key=lambda m: (m.wall_seconds, m.rmse)):
        if not front or point.rmse < front[-1].rmse:
            front.append(point)
    return front
