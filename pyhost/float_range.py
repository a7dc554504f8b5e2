"""Float32's range: powers of two that keep light inside it, and images clamped to it."""

from __future__ import annotations

import math

import numpy as np

LARGEST = float(np.finfo(np.float32).max)
LARGEST_HALF = float(np.finfo(np.float16).max)


def light_exponent(total: float) -> int:
    """An exponent e that keeps sums of light / 2^e in float32's range; ``total`` is the largest sum that can occur.

    It is 0, and costs nothing, unless ``total`` is near an end of the range.
    """
    exponent = math.frexp(total)[1]
    return 0 if -60 <= exponent <= 120 else exponent


def to_float32(image: np.ndarray, exponent: int = 0) -> np.ndarray:
    """``image`` x 2^exponent in float32; values beyond float32's range are clamped to it."""
    if exponent:
        image = np.ldexp(image.astype(np.float64), exponent)
    with np.errstate(over="ignore"):  # infinities are clamped below
        result = image.astype(np.float32)
    return np.clip(result, -LARGEST, LARGEST, out=result)
