"""Rank-1 lattices: the points (i, g i) / n modulo 1, i = 0 .. n - 1, with a generator g that suits n.

A shifted lattice errs by the sum of an integrand's Fourier coefficients at the frequencies (h, k) != 0 of its dual,
h + g k = 0 modulo n. So a good g has no dual frequency with a small product |h k|. (Zaremba's figure of merit;
Niederreiter, Random Number Generation and Quasi-Monte Carlo Methods, 1992, 5.1; Sloan and Joe, Lattice Methods for
Multiple Integration, 1994.)
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

ALL_UP_TO = 1024  # points; beyond, generators are tried near n / phi^2, whose lattice is good but seldom the best
TRIED = 512


def figure_of_merit(n: int, generators: np.ndarray) -> np.ndarray:
    """The least product |h k| of dual frequencies h, k != 0, for each of ``generators``, (G,) int64, prime to ``n``."""
    # Such an h and k are the remainder and the factor of a step of Euclid's algorithm.
    before, rest = np.full_like(generators, n), generators % n
    factor_before, factor = np.zeros_like(generators), np.ones_like(generators)
    merit = np.full_like(generators, n)
    while (going := rest > 0).any():
        merit = np.where(going, np.minimum(merit, factor * rest), merit)
        quotient = before // np.maximum(rest, 1)
        before, rest = rest, np.where(going, before - quotient * rest, 0)
        factor_before, factor = factor, factor_before + quotient * factor
    return merit


@lru_cache
def generator(n: int) -> int:
    """The generator of the lattice of ``n`` points, 1 <= n < 2^31: prime to ``n``, with the best figure of merit."""
    if n <= ALL_UP_TO:
        tried = np.arange(1, n // 2 + 2)
    else:
        tried = round(n * 0.3819660112501051) + np.arange(-TRIED // 2, TRIED // 2)
    tried = tried[np.gcd(tried, n) == 1]
    return int(tried[np.argmax(figure_of_merit(n, tried))])
