"""In which pixels of a map do directions lie? The values that belong to the directions reveal their convention.

A convention is a signed permutation of the axes, followed by a turn about the vertical by quarters or by whole columns.
Twelve of the permutations differ by more than such a turn. The convention that fits best is the one in which most
directions have the value of their pixel; on a tie, lightdome's own wins, then the presets of
:mod:`lightdome.maps.conventions`.

Programs that compute the direction of a pixel wrongly put directions elsewhere, for example on the corners of pixels.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from ..maps.conventions import PRESETS
from ..maps.rotation import rotation_matrix
from .causes import Cause
from .laws import CHANGES

FEW = 96  # directions with which conventions are tried
SAME = 1e-3  # allowed relative difference of values, which may have been printed with few digits
FITS = 0.9  # share of the directions that must fit
ON_LATTICE = 3e-5  # radians; allowed error of a direction

# The permutations of axes that differ by more than a turn about +y.
_AXES = {
    "": np.diag([1.0, 1, 1]),
    "mirrored front to back, as if phi ran the other way": np.diag([1.0, 1, -1]),
    "upside down": np.diag([1.0, -1, 1]),
    "turned by 180 degrees, upside down": np.diag([1.0, -1, -1]),
    "with z up, as in many textbooks": np.array([[1.0, 0, 0], [0, 0, 1], [0, 1, 0]]),
    "with z up, and mirrored": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
    "with z down": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),
    "with z down, and mirrored": np.array([[1.0, 0, 0], [0, 0, -1], [0, -1, 0]]),
    "with x up": np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, 1]]),
    "with x up, and mirrored": np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]]),
    "with x down": np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]]),
    "with x down, and mirrored": np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, -1]]),
}


@dataclass(frozen=True)
class Turn:
    """From a file's directions to lightdome's: one of :data:`_AXES`, then a shift by a share of the map's width."""

    axes: str
    shift: float

    @property
    def matrix(self) -> np.ndarray:
        return rotation_matrix(-360 * self.shift) @ _AXES[self.axes]

    @property
    def preset(self) -> str | None:
        """The preset with the same axes, or None."""
        for name, preset in PRESETS.items():
            matrix = rotation_matrix(-90 * preset.quarters) @ np.array(preset.axes).T
            if np.abs(matrix - self.matrix).max() < 1e-6:
                return name
        return None

    @property
    def is_wrong(self) -> bool:
        """Whether directions are turned, and not as in any preset."""
        return bool(str(self)) and self.preset is None

    def __str__(self) -> str:
        if self.preset:
            return "" if self.preset == "lightdome" else f"the convention of {self.preset}"
        if np.abs(self.matrix - np.diag([-1, 1, 1])).max() < 1e-6:
            return "mirrored left to right"
        if np.abs(self.matrix + np.eye(3)).max() < 1e-6:
            return "directions point away from the light"
        yaw = f"the map turned by {360 * self.shift % 360:.4g} degrees about the vertical" if self.shift else ""
        return " and ".join(part for part in (self.axes, yaw) if part)


# ---- Lattices: from places v and u, 0 to H and 0 to W, to rows and columns ----

Lattice = Callable[[np.ndarray, int], np.ndarray]


def _inside(at: np.ndarray, count: int) -> np.ndarray:
    return np.floor(at)


def _edges(at: np.ndarray, count: int) -> np.ndarray:
    return np.round(at)


def _last(at: np.ndarray, count: int) -> np.ndarray:
    return np.round(at * ((count - 1) / count))


@dataclass(frozen=True)
class Geometry:
    """How a program places the direction of a pixel, with the ``name`` of its mistake, "" for none."""

    name: str
    rows: Lattice = _inside
    columns: Lattice = _inside
    scale: tuple[float, float] = (1, 1)  # by which v and u are too small
    swapped: bool = False

    def pixels(self, v: np.ndarray, u: np.ndarray, height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
        """The rows and columns, integers, in which places lie."""
        if self.swapped:
            v, u = u * (height / width), v * (width / height)
        y = self.rows(v * self.scale[0], height).astype(np.int64)
        x = self.columns(u * self.scale[1], width).astype(np.int64)
        return np.clip(y, 0, height - 1), x % width


RIGHT = Geometry("")
_EDGES, _LAST = "pixel edges for centres", "W - 1 for W"
LATTICES = (
    Geometry(_EDGES, _edges, _edges),
    Geometry(_LAST, _last, _last),
    Geometry(_LAST, _edges, _last),
    Geometry(_LAST, _last, _edges),
    Geometry(_EDGES, _edges, _inside),
    Geometry(_EDGES, _inside, _edges),
    Geometry(_LAST, _inside, _last),
    Geometry(_LAST, _last, _inside),
)
GEOMETRIES = (
    *LATTICES,
    Geometry("theta over half its range", scale=(2, 1)),
    Geometry("phi over half its range", scale=(1, 2)),
    Geometry("x and y swapped", swapped=True),
)


def on_lattice(geometry: Geometry, v: np.ndarray, u: np.ndarray, height: int, width: int) -> bool:
    """Whether all places lie on the lattice of the geometry."""
    sine = np.sin(np.pi * v / height)
    for lattice, at, count, size in (
        (geometry.rows, v, height, np.pi / height),
        (geometry.columns, u, width, sine * (2 * np.pi / width)),
    ):
        if lattice is not _inside:
            at = at if lattice is _edges else at * ((count - 1) / count)
            if not (np.abs(at - np.round(at)) * size < ON_LATTICE).all():
                return False
    return True


def at_centres(v: np.ndarray, u: np.ndarray, height: int, width: int) -> bool:
    """Whether all places are centres of pixels."""
    down = np.abs(v - np.floor(v) - 0.5) * np.pi / height
    across = np.abs(u - np.floor(u) - 0.5) * np.sin(np.pi * v / height) * (2 * np.pi / width)
    return bool((np.maximum(down, across) < ON_LATTICE).all())


def places(direction: np.ndarray, height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Where directions (N, 3) lie in the map: v from 0 at the top to H, u from 0 to W."""
    x, y, z = direction.T
    v = np.arctan2(np.hypot(x, z), y) * (height / np.pi)
    return v, np.arctan2(z, x) * (width / (2 * np.pi)) % width


@dataclass(frozen=True)
class Fit:
    """How directions and their values fit the map: the share ``fitting`` once values are divided by ``factor``."""

    turn: Turn
    geometry: Geometry = RIGHT
    change: str = ""  # of the values: a name in CHANGES
    factor: float = 1.0
    fitting: float = 0.0


def _preference(turn: Turn) -> int:
    return 0 if turn.preset == "lightdome" else 1 if turn.preset else 2


def turns() -> list[Turn]:
    """All turns by quarters: lightdome's own first, then those of presets."""
    return sorted((Turn(axes, k / 4) for axes in _AXES for k in range(4)), key=_preference)


def find_fit(radiance: np.ndarray, direction: np.ndarray, values: np.ndarray) -> Fit:
    """The convention in which unit vectors (N, 3) have the ``values`` (N, C) of their pixels in a map (H, W, C)."""
    chosen = _few(values)
    direction, value = direction[chosen], values[chosen].sum(axis=1)
    sums = radiance.sum(axis=2)
    width = sums.shape[1]
    quarters = [k / 4 for k in range(4)]
    columns = quarters + [k / width for k in range(width) if (4 * k) % width]

    def search(
        maps: Iterable[tuple[str, np.ndarray]], geometries: Iterable[Geometry], shifts: list[float], free: bool = False
    ) -> Fit | None:
        best: tuple[float, int, Fit] | None = None
        for change, image in maps:
            for geometry in geometries:
                for axes in _AXES:
                    for fit in _fits(image, direction, value, geometry, axes, shifts, free):
                        rank = fit.fitting, -_preference(fit.turn)
                        if best is None or rank > best[:2]:
                            best = *rank, Fit(fit.turn, geometry, change, fit.factor, fit.fitting)
        return best[2] if best and best[0] >= FITS else None

    maps = [(name, change(radiance).sum(axis=2)) for name, change in CHANGES.items()]
    found = (
        search([("", sums)], [RIGHT], columns)
        or search([(name, image) for name, image in maps if not np.array_equal(image, sums)], [RIGHT], quarters)
        or search([("", sums)], GEOMETRIES, quarters)
        or (search([("", sums)], [RIGHT], columns, free=True) if len(np.unique(value)) > 2 else None)
    )
    return found or Fit(Turn("", 0.0))


def _few(values: np.ndarray) -> np.ndarray:
    """The indices of a few rows, with different values if possible, as these say more."""
    _, first = np.unique(values, axis=0, return_index=True)
    rng = np.random.default_rng(0)
    if len(first) >= FEW:
        return rng.choice(first, FEW, replace=False)
    others = np.setdiff1d(np.arange(len(values)), first)
    return np.concatenate([first, rng.permutation(others)[: FEW - len(first)]])


def _fits(
    image: np.ndarray,
    direction: np.ndarray,
    value: np.ndarray,
    geometry: Geometry,
    axes: str,
    shifts: list[float],
    free: bool,
) -> Iterator[Fit]:
    """The best shift for these axes, and the best by quarters, since only those can be presets."""
    height, width = image.shape
    v, u = places(direction @ _AXES[axes].T, height, width)
    u = (u[:, None] + np.array(shifts) * width) % width
    y, x = geometry.pixels(np.broadcast_to(v[:, None], u.shape), u, height, width)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.log(value[:, None]) - np.log(image[y, x])
    ratio[(value[:, None] == 0) & (image[y, x] == 0)] = 0
    ratio[~np.isfinite(ratio)] = 1e9
    middle = np.median(ratio, axis=0) if free else np.zeros(len(shifts))
    share = (np.abs(ratio - middle) < SAME).mean(axis=0)
    for k in {int(share.argmax()), int(share[:4].argmax())}:
        yield Fit(Turn(axes, shifts[k]), factor=float(np.exp(middle[k].clip(-600, 600))), fitting=float(share[k]))


def likeliest(weight: np.ndarray, direction: np.ndarray) -> Turn:
    """The turn by quarters that puts drawn directions on the brightest pixels, if that is beyond doubt.

    ``weight`` (H, W) is proportional to the density per steradian.
    """
    height, width = weight.shape
    log = np.log(weight / weight.mean() + 1e-3)
    few = direction[
        np.random.default_rng(0).permutation(len(direction))[:4096]
    ]  # at random: every second point of a sequence may lie in one half

    def of(turn: Turn) -> np.ndarray:
        v, u = places(few @ turn.matrix.T, height, width)
        return log[RIGHT.pixels(v, u, height, width)]

    own = of(Turn("", 0.0))
    best, result = 6.0, Turn("", 0.0)
    for turn in turns():
        better = of(turn) - own
        spread = better.std() / math.sqrt(len(few))
        if better.mean() > 0.1 and spread > 0 and better.mean() / spread > best:
            best, result = better.mean() / spread * (1 + 1e-9), turn
    return result


CAUSES_OF_PLACES = (
    Cause(
        "directions not normalised",
        "the length of the directions is not 1",
        "lights are too strong or too weak by that length",
        "where the direction is computed",
    ),
    Cause(
        "radiance of other pixels",
        "the radiance is not that of the pixel in the sample's direction, in any convention",
        "lamps are in the wrong places or have the wrong colours",
        "where the radiance is looked up or the direction computed; or the samples belong to another map",
    ),
    Cause(
        "radiance scaled",
        "the radiance is that of the map times a factor",
        "the image is too bright or too dark",
        "where the map is read or the radiance written",
    ),
)
