"""Float32's range: powers of two that keep light inside it, and images that stop at its ends."""

from __future__ import annotations

import math

import numpy as np

LARGEST = float(np.finfo(np.float32).max)
LARGEST_HALF = float(np.finfo(np.float16).max)


def light_exponent(total: float) -> int:
    """An e for which sums of light / 2^e stay in float32's range, where ``total`` is the largest that can occur.

    It is 0, and costs nothing, unless ``total`` is near an end of the range.
    """
    exponent = math.frexp(total)[1]
    return 0 if -60 <= exponent <= 120 else exponent


def to_float32(image: np.ndarray, exponent: int = 0) -> np.ndarray:
    """``image`` x 2^exponent in float32; what lies beyond its largest number becomes that number."""
    if exponent:
        image = np.ldexp(image.astype(np.float64), exponent)
    with np.errstate(over="ignore"):  # to infinity, and back
        result = image.astype(np.float32)
    return np.clip(result, -LARGEST, LARGEST, out=result)
