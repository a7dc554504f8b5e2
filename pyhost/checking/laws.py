"""The laws by which the pixels of a map are drawn: the correct one, and those of known mistakes.

A law gives the weights (H, W) of a map. Its name is that of its cause; if several laws share a name, images are
compared with the first of them.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..maps.geometry import row_angles

Law = Callable[[np.ndarray], np.ndarray]  # from radiance (H, W, 3) to weights (H, W)

# How a program may change the map's values by mistake.
CHANGES: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "map clipped to 1": lambda L: np.minimum(L, 1),
    "map clipped to 255": lambda L: np.minimum(L, 255),
    "map gamma-encoded": lambda L: L ** (1 / 2.2),
    "gamma decoded from linear values": lambda L: L**2.2,
}


def luminance(radiance: np.ndarray) -> np.ndarray:
    """I = (R + G + B) / 3, (H, W)."""
    return radiance.mean(axis=2)


def _sine(radiance: np.ndarray) -> np.ndarray:
    return np.sin(row_angles(len(radiance)))[:, None]


def right(radiance: np.ndarray) -> np.ndarray:
    """I sin(theta)."""
    return luminance(radiance) * _sine(radiance)


def _share(radiance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """p(y) up to a factor, (H, 1), and p(x | y), (H, W)."""
    weight = right(radiance)
    rows = weight.sum(axis=1, keepdims=True)
    return rows, np.divide(weight, rows, out=np.zeros_like(weight), where=rows > 0)


def _of_neighbour(step: int) -> Law:
    def weight(radiance: np.ndarray) -> np.ndarray:
        rows, share = _share(radiance)
        return rows * np.roll(share, step, axis=0)

    return weight


def _of_changed(change: Callable[[np.ndarray], np.ndarray]) -> Law:
    return lambda L: right(change(L))


def _rolled(step: int, axis: int) -> Law:
    return lambda L: np.roll(right(L), step, axis=axis)


def _shifted_rows(step: int) -> Law:
    def weight(radiance: np.ndarray) -> np.ndarray:
        rows, share = _share(radiance)
        return np.roll(rows, step, axis=0) * share

    return weight


def _same_number(radiance: np.ndarray) -> np.ndarray:
    """One u picks row y and column x: the weight is the overlap of their steps in the two CDFs."""
    rows, share = _share(radiance)
    down = np.concatenate([[0], np.cumsum(rows)])
    down /= max(down[-1], 1e-300)
    across = np.concatenate([np.zeros((len(rows), 1)), np.cumsum(share, axis=1)], axis=1)
    low = np.maximum(across[:, :-1], down[:-1, None])
    return np.maximum(0, np.minimum(across[:, 1:], down[1:, None]) - low) * (share > 0)


LAWS: tuple[tuple[str, Law], ...] = (
    ("no sin(theta)", luminance),
    ("sin(theta) twice", lambda L: right(L) * _sine(L)),
    ("luminance of Rec. 709", lambda L: L @ np.array([0.2126, 0.7152, 0.0722]) * _sine(L)),
    ("luminance of Rec. 709", lambda L: L @ np.array([0.299, 0.587, 0.114]) * _sine(L)),
    *((name, _of_changed(change)) for name, change in CHANGES.items()),
    ("theta over half its range", lambda L: luminance(L) * np.sin(row_angles(len(L)) / 2)[:, None]),
    ("one random number for row and column", _same_number),
    ("row CDF of another row", _of_neighbour(-1)),
    ("row CDF of another row", _of_neighbour(1)),
    ("CDF starts at row 1", _rolled(1, 0)),
    ("CDF starts at row 1", _rolled(-1, 0)),
    ("CDF starts at row 1", _shifted_rows(1)),
    ("CDF starts at row 1", _shifted_rows(-1)),
    ("CDF sorted", lambda L: np.sort(right(L), axis=1)),
    ("CDF sorted", lambda L: np.sort(right(L), axis=1)[:, ::-1]),
    ("rows drawn evenly", lambda L: _share(L)[1]),
    ("columns drawn evenly", lambda L: _share(L)[0] * np.ones(L.shape[:2])),
    ("column found one too far", _rolled(1, 1)),
    ("column found one too far", _rolled(-1, 1)),
    ("largest channel for the mean", lambda L: L.max(axis=2) * _sine(L)),
    ("one channel for the mean", lambda L: L[..., 0] * _sine(L)),
    ("one channel for the mean", lambda L: L[..., 1] * _sine(L)),
    ("one channel for the mean", lambda L: L[..., 2] * _sine(L)),
    ("pixels drawn evenly", lambda L: np.ones(L.shape[:2])),
    ("directions drawn evenly", lambda L: _sine(L) * np.ones(L.shape[:2])),
)


def laws(radiance: np.ndarray) -> list[tuple[str, np.ndarray]]:
    """The names and the probabilities (H, W), which sum to 1, of the mistakes that make a difference for this map."""
    truth = right(radiance)
    truth /= truth.sum()
    result = []
    for name, law in LAWS:
        with np.errstate(over="ignore"):
            weight = law(radiance)
        total = weight.sum()
        if np.isfinite(total) and total > 0 and np.abs(weight / total - truth).sum() > 1e-6:
            result.append((name, weight / total))
    return result
