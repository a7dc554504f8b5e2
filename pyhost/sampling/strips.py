"""Vertical strips of a map, of which sampling picks one first: points that are neighbours then mostly stay neighbours.

``clkernels/common/strips.clh`` has the formulas.
"""

from __future__ import annotations

from itertools import accumulate, pairwise

import numpy as np

LANES = 16  # strips begin at multiples of it, so that vectors of a row stay whole
MOST = 8  # strips, as in strips.clh; twice as many would gain a few percent
WHOLE = 2**32  # points


def strip_bits(width: int) -> int:
    """Maps of ``width`` columns have 2^bits strips."""
    return min(MOST, max(1, width // LANES)).bit_length() - 1


def strip_borders(width: int) -> np.ndarray:
    """The first column of each strip, and ``width``: (S + 1,) int64."""
    count = 1 << strip_bits(width)
    return np.array([*(width // LANES * s // count * LANES for s in range(count)), width])


def strip_table(weights: np.ndarray) -> np.ndarray:
    """The table from which strips of these ``weights``, (S,) float64, are picked: (S, 4) uint32."""
    sums = [0.0, *accumulate(weights.tolist())]
    first = [round(WHOLE * (part / sums[-1])) if sums[-1] else 0 for part in sums]
    entries = []
    for strip, (begin, end) in enumerate(pairwise(first)):
        if end > begin:
            inverse = WHOLE**2 // (end - begin)
            entries.append((begin, inverse // WHOLE % WHOLE, inverse % WHOLE, strip))
    # Strips that no point picks are left out, and copies of the first entry, which the search passes over, fill up.
    entries = entries or [(0, 1, 0, 0)]
    return np.array([entries[0]] * (len(weights) - len(entries)) + entries, np.uint32)
