"""Projections: how the pixels of a square, a cross or a strip cover the sphere of directions.

A projection maps positions in an image of ``shape`` (H, W) to directions and back. Positions are in pixels, x from the
left edge and y from the top edge, so the pixel in row j and column i has its centre at (i + 1/2, j + 1/2). Directions
are lightdome's: unit vectors with +y up. "Looks along -z" means that the middle of an image, or of a face, shows the
direction -z, with +x on its right and +y at its top, as a camera would see it.

- ``latlong``, 2:1: x is phi, y is theta, see :mod:`lightdome.maps.geometry`. The middle shows -x; -z is three quarters
  of the way from left to right.
- ``angular``, 1:1: a disc that looks along -z. The distance from the middle is the angle to -z, pi on the rim:
  r = acos(-z) / pi. Debevec, Light Probe Image Gallery (1998), which writes acos(z) where its text turns away from -z.
- ``mirror``, 1:1: a mirrored ball seen from afar, r = sin(acos(-z) / 2), as in skylibs: the middle shows -z, and +x is
  on the right. (A photograph of a ball has left and right exchanged.) Equal areas are equal solid angles.
- ``cube-cross``, 3:4, and ``cube-cross-horizontal``, 4:3: the faces left, front (-z) and right in a row, with up above
  and down below the front. The back is below that, upside down, or to the right of the right face. As in HDRShop.
- ``cube-strip``, 1:6, and ``cube-strip-horizontal``, 6:1: the faces +x, -x, +y, -y, +z, -z, each seen from inside. +y
  and -y have +x on their right; +y has -z at its bottom, -y has -z at its top.
- ``cube-openexr``, 1:6: the same faces, as OpenEXR defines ``envmap = cube`` (``ImfEnvmap.cpp``): the centres of a
  face's outer pixels lie on its edges, so that these are half pixels.
- ``octahedral``, 1:1: PBRT-v4's equal-area square. The middle shows +y, the right side +x and the lower side +z; see
  :mod:`lightdome.pbrt.equal_area`.

A disc uses the pixels whose centres lie in it. Other parts of the disc count towards the neighbouring pixel closer to
the middle, so that the solid angles of the used pixels sum to 4 pi.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from .. import checks
from . import geometry
from .image_source import MAX_PIXELS

NODES = 6  # nodes of Gauss-Legendre quadrature along the side of a pixel
TINY = 1e-300


@dataclass(frozen=True)
class Projection(ABC):
    """One of :data:`PROJECTIONS`: its ``name``, and ``aspect``, columns and rows as multiples of a size."""

    name: str
    aspect: tuple[int, int]

    def shape(self, size: int) -> tuple[int, int]:
        """(H, W) of an image of this ``size``: the side of a square or cube face, or a latlong's rows."""
        largest = math.isqrt(MAX_PIXELS // (self.aspect[0] * self.aspect[1]))
        size = checks.whole(f"the size of the {self.name} map", size, self.smallest, largest)
        return self.aspect[1] * size, self.aspect[0] * size

    def fits(self, shape: tuple[int, int]) -> bool:
        """Whether an image of ``shape`` (H, W) can have this projection."""
        (width, height), size = self.aspect, shape[0] // self.aspect[1]
        return shape == (height * size, width * size) and size >= self.smallest

    @property
    def smallest(self) -> int:
        """The smallest size."""
        return 1

    @property
    def tiles(self) -> tuple[int, int]:
        """Rows and columns of tiles within which neighbours in the image are neighbours on the sphere."""
        return 1, 1

    @property
    @abstractmethod
    def coverage(self) -> float:
        """Roughly, the number of used pixels divided by the square of the size."""

    @abstractmethod
    def directions(self, x: np.ndarray, y: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
        """Unit vectors (..., 3) float64 at positions ``x``, ``y``, which are broadcast."""

    @abstractmethod
    def positions(self, direction: np.ndarray, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
        """The positions x and y of unit vectors (..., 3)."""

    @abstractmethod
    def density(self, x: np.ndarray, y: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
        """Steradians per pixel area at positions ``x``, ``y``; 0 where the image is unused."""

    @abstractmethod
    def solid_angles(self, shape: tuple[int, int]) -> np.ndarray:
        """Solid angles of the pixels, (H, W) float64, steradians, 0 for unused pixels; they sum to 4 pi."""

    def owners(self, shape: tuple[int, int]) -> np.ndarray | None:
        """The pixel that each pixel counts towards, (H W,) indices row by row; None if each counts as itself."""
        return None

    def used(self, shape: tuple[int, int]) -> np.ndarray:
        """Whether each pixel is used, (H, W) bool."""
        return self.solid_angles(shape) > 0


@dataclass(frozen=True)
class LatLong(Projection):
    """Latitude and longitude; any shape, stretched over the whole sphere."""

    def fits(self, shape: tuple[int, int]) -> bool:
        return min(shape) >= 1

    @property
    def coverage(self) -> float:
        return 2.0

    def directions(self, x: np.ndarray, y: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
        return geometry.directions(np.pi / shape[0] * y, 2 * np.pi / shape[1] * x)

    def positions(self, direction: np.ndarray, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
        x, y, z = np.moveaxis(direction, -1, 0)
        turns = np.arctan2(z, x) / (2 * np.pi)
        theta = np.arctan2(np.sqrt(x * x + z * z), y)  # acos would lose half the digits near the poles
        return (turns + (turns < 0)) * shape[1], theta * (shape[0] / np.pi)

    def density(self, x: np.ndarray, y: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
        height, width = shape
        return (2 * np.pi**2 / (height * width)) * np.sin(np.pi / height * y) + 0 * x

    def solid_angles(self, shape: tuple[int, int]) -> np.ndarray:
        return np.repeat(geometry.solid_angles(*shape)[:, None], shape[1], axis=1)


@dataclass(frozen=True)
class _Disc(Projection):
    """A disc around -z; r is the distance from its middle, 1 on its rim."""

    @property
    def coverage(self) -> float:
        return np.pi / 4

    @abstractmethod
    def _polar(self, r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """sin(theta) / r and cos(theta), where theta is the angle to -z."""

    @abstractmethod
    def _radius(self, sine: np.ndarray, cosine: np.ndarray) -> np.ndarray:
        """r for the angle to -z with this sine and cosine."""

    @abstractmethod
    def _per_area(self, r: np.ndarray) -> np.ndarray:
        """Steradians per area of the disc, whose radius is 1."""

    @abstractmethod
    def _cap(self, r: np.ndarray) -> np.ndarray:
        """(1 - cos(theta)) / r^2: the solid angle within r, divided by 2 pi r^2."""

    def directions(self, x: np.ndarray, y: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
        across, up = np.broadcast_arrays(2 * x / shape[1] - 1, 1 - 2 * y / shape[0])
        r = np.hypot(across, up)
        scale, cosine = self._polar(np.minimum(r, 1))
        scale = scale / np.maximum(r, 1)
        return np.stack([scale * across, scale * up, -cosine], axis=-1)

    def positions(self, direction: np.ndarray, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
        x, y, z = np.moveaxis(direction, -1, 0)
        sine = np.hypot(x, y)
        scale = self._radius(sine, -z) / np.maximum(sine, TINY)
        up = np.where((sine == 0) & (z > 0), 1.0, scale * y)
        return (1 + scale * x) * (shape[1] / 2), (1 - up) * (shape[0] / 2)

    def density(self, x: np.ndarray, y: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
        r = np.hypot(2 * x / shape[1] - 1, 1 - 2 * y / shape[0])
        return np.where(r < 1, self._per_area(np.minimum(r, 1)), 0) * (4 / (shape[0] * shape[1]))

    def solid_angles(self, shape: tuple[int, int]) -> np.ndarray:
        owners = self.owners(shape)
        whole = self._within_disc(shape[0])
        return np.bincount(owners, whole.ravel(), whole.size).reshape(shape)

    def _within_disc(self, side: int) -> np.ndarray:
        """Solid angle of each pixel's part of the disc, by Green's theorem: (1 - cos(theta)) d psi around it."""
        edge = np.linspace(-1, 1, side + 1)
        level, begin, end = edge[:, None], edge[:-1], edge[1:]
        chord = np.sqrt(np.maximum(0, 1 - level**2))
        first, last = (np.clip(x, -chord, chord) for x in (begin, end))
        inside = np.zeros((side + 1, side))
        for node, weight in zip(*np.polynomial.legendre.leggauss(NODES), strict=True):
            inside += weight / 2 * self._cap(np.hypot((first + last + node * (last - first)) / 2, level))
        turns = [np.arctan2(x, np.abs(level)) for x in (begin, end, first, last)]
        beyond = 2 * np.sign(level) * (turns[1] - turns[0] - turns[3] + turns[2])
        part = np.diff(level * inside * (last - first) + beyond, axis=0)
        nearest = np.maximum(0, np.maximum(begin, -end))
        return np.where(np.hypot(nearest, nearest[:, None]) < 1, np.maximum(part + part.T, 0), 0)

    def owners(self, shape: tuple[int, int]) -> np.ndarray:
        side = shape[0]
        j, i = np.indices(shape)
        for _ in range(4):  # more than enough for pixels that reach into the disc
            down, right = 2 * j + 1 - side, 2 * i + 1 - side
            outside = down**2 + right**2 > side**2
            steep = np.abs(down) >= np.abs(right)
            j = j - np.where(outside & steep, np.sign(down), 0)
            i = i - np.where(outside & ~steep, np.sign(right), 0)
        return (j * side + i).ravel()


@dataclass(frozen=True)
class Angular(_Disc):
    """r is the angle to -z, divided by pi."""

    def _polar(self, r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.pi * np.sinc(r), np.cos(np.pi * r)

    def _radius(self, sine: np.ndarray, cosine: np.ndarray) -> np.ndarray:
        return np.arctan2(sine, cosine) / np.pi

    def _per_area(self, r: np.ndarray) -> np.ndarray:
        return np.pi**2 * np.sinc(r)

    def _cap(self, r: np.ndarray) -> np.ndarray:
        return np.pi**2 / 2 * np.sinc(r / 2) ** 2


@dataclass(frozen=True)
class Mirror(_Disc):
    """r is the sine of half the angle to -z."""

    def _polar(self, r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return 2 * np.sqrt(1 - r * r), 1 - 2 * r * r

    def _radius(self, sine: np.ndarray, cosine: np.ndarray) -> np.ndarray:
        # Half of 1 - cosine, without cancellation.
        return np.where(cosine > 0, sine / np.sqrt(2 * (1 + np.abs(cosine))), np.sqrt((1 - cosine) / 2))

    def _per_area(self, r: np.ndarray) -> np.ndarray:
        return np.full_like(r, 4.0)

    def _cap(self, r: np.ndarray) -> np.ndarray:
        return np.full_like(r, 2.0)


# The directions in the middle of each face, to its right, and below.
_FACES = {
    "+x": ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
    "-x": ((-1, 0, 0), (0, 0, -1), (0, -1, 0)),
    "+y": ((0, 1, 0), (1, 0, 0), (0, 0, -1)),
    "-y": ((0, -1, 0), (1, 0, 0), (0, 0, 1)),
    "+z": ((0, 0, 1), (-1, 0, 0), (0, -1, 0)),
    "-z": ((0, 0, -1), (1, 0, 0), (0, -1, 0)),
    "+z turned": ((0, 0, 1), (1, 0, 0), (0, 1, 0)),
}


@dataclass(frozen=True)
class Cube(Projection):
    """Six faces in rows and columns: ``faces`` names them, with None for an empty place.

    With ``on_edges``, the centres of a face's outer pixels lie on its edges.
    """

    faces: tuple[tuple[str | None, ...], ...]
    on_edges: bool = False

    @property
    def smallest(self) -> int:
        return 2 if self.on_edges else 1

    @property
    def tiles(self) -> tuple[int, int]:
        return len(self.faces), len(self.faces[0])

    @property
    def coverage(self) -> float:
        return 6.0

    def _face(self, shape: tuple[int, int]) -> tuple[int, float, float]:
        """The side in pixels, the position of the face's edge in it, and the pixels from edge to edge."""
        side = shape[0] // len(self.faces)
        return (side, 0.5, side - 1.0) if self.on_edges else (side, 0.0, float(side))

    def _in_face(
        self, x: np.ndarray, y: np.ndarray, shape: tuple[int, int]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The face's number, row by row, and the position in it, from -1 to 1 to the right and down."""
        side, start, span = self._face(shape)
        rows, columns = self.tiles
        x, y = np.broadcast_arrays(x, y)
        column, row = (np.clip(a // side, 0, n - 1).astype(np.intp) for a, n in ((x, columns), (y, rows)))
        right, down = (2 * (a - n * side - start) / span - 1 for a, n in ((x, column), (y, row)))
        return row * columns + column, right, down

    def directions(self, x: np.ndarray, y: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
        face, right, down = self._in_face(x, y, shape)
        axes = [_FACES[name] if name else np.zeros((3, 3)) for row in self.faces for name in row]
        middle, to_right, to_bottom = np.moveaxis(np.array(axes, np.float64), 1, 0)
        vector = middle[face] + right[..., None] * to_right[face] + down[..., None] * to_bottom[face]
        return vector / np.sqrt(1 + right**2 + down**2)[..., None]

    def positions(self, direction: np.ndarray, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
        side, start, span = self._face(shape)
        size = np.abs(direction)
        axis = np.argmax(size, axis=-1)
        x, y = np.zeros(axis.shape), np.zeros(axis.shape)
        for row, names in enumerate(self.faces):
            for column, name in enumerate(names):
                if name:
                    middle, to_right, to_bottom = np.array(_FACES[name], np.float64)
                    along = int(np.argmax(np.abs(middle)))
                    here = (axis == along) & (direction[..., along] * middle[along] > 0)
                    vector = direction[here] / size[here][:, along, None]
                    for at, n, axis_to in ((x, column, to_right), (y, row, to_bottom)):
                        exact = n * side + start + span * (1 + vector @ axis_to) / 2
                        at[here] = np.minimum(exact, np.nextafter((n + 1) * side, 0))  # not into the next face
        return x, y

    def density(self, x: np.ndarray, y: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
        face, right, down = self._in_face(x, y, shape)
        is_face = np.array([name is not None for row in self.faces for name in row])
        on_it = is_face[face] & (np.maximum(np.abs(right), np.abs(down)) <= 1)
        return on_it * (2 / self._face(shape)[2]) ** 2 / (1 + right**2 + down**2) ** 1.5

    def solid_angles(self, shape: tuple[int, int]) -> np.ndarray:
        side, start, span = self._face(shape)
        edge = np.clip(2 * (np.arange(side + 1) - start) / span - 1, -1, 1)
        product = edge * edge[:, None]
        corner = np.arctan2(product, np.sqrt(1 + edge**2 + edge[:, None] ** 2))
        of_face = np.diff(np.diff(corner, axis=0), axis=1)
        return np.kron([[float(name is not None) for name in row] for row in self.faces], of_face)


@dataclass(frozen=True)
class Octahedral(Projection):
    """PBRT-v4's equal-area square: Clarberg (2008); Pharr, Jakob, Humphreys, 4th ed., 3.8.3; their z is our y."""

    @property
    def coverage(self) -> float:
        return 1.0

    def directions(self, x: np.ndarray, y: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
        u, v = np.broadcast_arrays(2 * x / shape[1] - 1, 2 * y / shape[0] - 1)
        distance = 1 - np.abs(u) - np.abs(v)  # from the diagonal, below 0 in the lower hemisphere
        r = 1 - np.abs(distance)
        phi = np.pi / 4 * (1 + (np.abs(v) - np.abs(u)) / np.maximum(r, TINY))
        sine = r * np.sqrt(np.maximum(0, 2 - r * r))
        up = np.copysign(1 - r * r, distance)
        return np.stack([np.copysign(np.cos(phi), u) * sine, up, np.copysign(np.sin(phi), v) * sine], axis=-1)

    def positions(self, direction: np.ndarray, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
        x, y, z = np.moveaxis(direction, -1, 0)
        r = np.hypot(x, z) / np.sqrt(1 + np.abs(y))
        v = r * np.arctan2(np.abs(z), np.abs(x)) * (2 / np.pi)
        u = r - v
        u, v = np.where(y < 0, 1 - v, u), np.where(y < 0, 1 - u, v)
        return (1 + np.copysign(u, x)) * (shape[1] / 2), (1 + np.copysign(v, z)) * (shape[0] / 2)

    def density(self, x: np.ndarray, y: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
        return np.full(np.broadcast_shapes(np.shape(x), np.shape(y)), 4 * np.pi / (shape[0] * shape[1]))

    def solid_angles(self, shape: tuple[int, int]) -> np.ndarray:
        return np.full(shape, 4 * np.pi / (shape[0] * shape[1]))


_CROSS = ((None, "+y", None), ("-x", "-z", "+x"), (None, "-y", None), (None, "+z turned", None))
_CROSS_HORIZONTAL = ((None, "+y", None, None), ("-x", "-z", "+x", "+z"), (None, "-y", None, None))
_STRIP = tuple((name,) for name in ("+x", "-x", "+y", "-y", "+z", "-z"))

PROJECTIONS: dict[str, Projection] = {
    projection.name: projection
    for projection in (
        LatLong("latlong", (2, 1)),
        Angular("angular", (1, 1)),
        Mirror("mirror", (1, 1)),
        Cube("cube-cross", (3, 4), _CROSS),
        Cube("cube-cross-horizontal", (4, 3), _CROSS_HORIZONTAL),
        Cube("cube-strip", (1, 6), _STRIP),
        Cube("cube-strip-horizontal", (6, 1), (tuple(name for (name,) in _STRIP),)),
        Cube("cube-openexr", (1, 6), _STRIP, on_edges=True),
        Octahedral("octahedral", (1, 1)),
    )
}
