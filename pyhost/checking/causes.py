"""What goes wrong in renderers of environment light, and the image that each mistake converges to.

A light sample is drawn with probability q, and adds (albedo / pi) max(0, n . w) (L / I) Phi / N to a pixel of normal n,
where I = (R + G + B) / 3 and Phi is the sum of I x solid angle. If q is proportional to I sin(theta), the sum converges
to the exact image. A mistake in q, in the term or in the direction makes it converge to the exact image of another map,
which is what ``effect`` makes: from the radiance (H, W, 3) of a map, float64, to that of another map. A mistake in
the direction has ``placed``: the angles theta and phi of row y and column x of H and W. One on the side of the surface
has a ``surface``: from the irradiance as a function of a vector, and the normals, to the irradiance that it shows. One
in the image itself has a ``picture``, from the exact image's pixels to those it has.

The list was gathered from solutions of students and from reports of renderers' users.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..maps.geometry import solid_angles
from .laws import CHANGES, LAWS, right

Effect = Callable[[np.ndarray], np.ndarray]
Placed = Callable[[np.ndarray, np.ndarray, int, int], tuple[np.ndarray, np.ndarray]]
Irradiance = Callable[[np.ndarray], np.ndarray]  # of vectors (N, 3), which may have any length: (N, 3)


@dataclass(frozen=True)
class Cause:
    """A mistake: its ``name``, ``what`` it is, how it is ``seen`` in an image, and ``where`` in code people make it."""

    name: str
    what: str
    seen: str
    where: str
    effect: Effect | None = None
    placed: Placed | None = None
    surface: Callable[[Irradiance, np.ndarray], np.ndarray] | None = None
    picture: Callable[[np.ndarray], np.ndarray] | None = None
    factors: tuple[int, ...] = (0, 1)  # 0: its own brightness tells it apart; 1: with any other its shape does
    about: bool = False  # its brightness is known roughly, as the spread of its samples is large
    in_pictures: bool | None = None  # whether a PNG or PPM file shows it, or other files do; None for all
    by_pixels: bool = False  # it depends on single pixels, so that a smaller map does not show it


def centred(y: np.ndarray, x: np.ndarray, H: int, W: int) -> tuple[np.ndarray, np.ndarray]:
    """The right angles theta and phi, of the centres of pixels."""
    return np.pi * (y + 0.5) / H, 2 * np.pi * (x + 0.5) / W


def drawn_with(weight: np.ndarray, radiance: np.ndarray) -> np.ndarray:
    """The map whose exact image appears if pixels are drawn in proportion to ``weight`` (H, W) and summed as usual."""
    total = weight.sum()
    if not total > 0:
        return np.zeros_like(radiance)
    q, p = weight / total, right(radiance)
    return radiance * np.divide(q * p.sum(), p, out=np.zeros_like(p), where=p > 0)[..., None]


def _drawn_by(name: str) -> Effect:
    law = next(law for of, law in LAWS if of == name)
    return lambda L: drawn_with(law(L), L)


def _unclamped(irradiance: Irradiance, normal: np.ndarray) -> np.ndarray:
    return irradiance(normal) - irradiance(-normal)


def _both_sides(irradiance: Irradiance, normal: np.ndarray) -> np.ndarray:
    return irradiance(normal) + irradiance(-normal)


def _flat(irradiance: Irradiance, normal: np.ndarray) -> np.ndarray:
    return irradiance(np.stack([normal[:, 0], normal[:, 1], np.ones(len(normal))], axis=1))


def _no_root(irradiance: Irradiance, normal: np.ndarray) -> np.ndarray:
    return irradiance(normal * [1, 1, 0] + normal**2 * [0, 0, 1])


CAUSES = (
    Cause(
        "no sin(theta)",
        "the weights of pixels lack sin(theta), or the density lacks the pixel's solid angle",
        "too much light from the poles of the map, straight up and straight down",
        "where the luminance is multiplied for the CDFs, and where p(x, y) is divided by the solid angle",
        _drawn_by("no sin(theta)"),
        factors=(1,),
    ),
    Cause(
        "p of a pixel used as a density",
        "the radiance is divided by p(x, y), the probability of a pixel, and not by p(x, y) / solid angle of the pixel",
        "thousands of times too bright, and too much light from straight up and straight down",
        "where a sample's term is divided by its density",
        lambda L: L / solid_angles(*L.shape[:2])[:, None, None],
        factors=(1,),
        about=True,
    ),
    Cause(
        "sin(theta) twice",
        "sin(theta) is in the weights twice, or in the weights and in the term",
        "too little light from above and from below",
        "where the luminance is multiplied for the CDFs, and again in the sum over samples",
        _drawn_by("sin(theta) twice"),
        factors=(1,),
    ),
    Cause(
        "theta over half its range",
        "theta runs from 0 to pi / 2 over the rows and not to pi",
        "all light comes from above; the lower half of the sphere is dark",
        "theta = pi (y + 1/2) / H, not pi / 2",
        placed=lambda y, x, H, W: (np.pi / 2 * (y + 0.5) / H, 2 * np.pi * (x + 0.5) / W),
    ),
    Cause(
        "theta over twice its range",
        "theta runs from 0 to 2 pi over the rows and not to pi",
        "the lower half of the map lights the sphere from behind its true place",
        "theta = pi (y + 1/2) / H, not 2 pi",
        placed=lambda y, x, H, W: (2 * np.pi * (y + 0.5) / H, 2 * np.pi * (x + 0.5) / W),
    ),
    Cause(
        "phi over half its range",
        "phi runs from 0 to pi over the columns and not to 2 pi",
        "all light comes from one side",
        "phi = 2 pi (x + 1/2) / W, not pi",
        placed=lambda y, x, H, W: (np.pi * (y + 0.5) / H, np.pi * (x + 0.5) / W),
    ),
    Cause(
        "x and y swapped",
        "the row is used for phi and the column for theta",
        "lamps are at quite other places",
        "where a pixel (x, y) becomes (phi, theta), or an array is indexed [x][y]",
        placed=lambda y, x, H, W: (np.pi * (x + 0.5) / W, 2 * np.pi * (y + 0.5) / H),
    ),
    Cause(
        "pixel edges for centres",
        "a pixel's direction is that of its upper left corner",
        "the light is turned by half a pixel: seen on small maps only",
        "theta = pi (y + 1/2) / H and phi = 2 pi (x + 1/2) / W: the halves are missing",
        placed=lambda y, x, H, W: (np.pi * y / H, 2 * np.pi * x / W),
    ),
    Cause(
        "W - 1 for W",
        "phi or theta is scaled by the last index, and not by the number of pixels",
        "the light is turned, by up to a pixel at the map's right end",
        "phi = 2 pi (x + 1/2) / W, not / (W - 1)",
        placed=lambda y, x, H, W: (np.pi * y / max(H - 1, 1), 2 * np.pi * x / max(W - 1, 1)),
    ),
    Cause(
        "one random number for row and column",
        "the number that picks the row picks the column too",
        "only a curve of pixels through the map is ever drawn, and most lamps are never seen",
        "where the sample's two random numbers are made",
        _drawn_by("one random number for row and column"),
        by_pixels=True,
    ),
    Cause(
        "row CDF of another row",
        "the column is drawn from the CDF of a neighbouring row",
        "light is spread; edges of lamps shine wrongly",
        "where the row's CDF is looked up: its offset is row x width",
        _drawn_by("row CDF of another row"),
        by_pixels=True,
    ),
    Cause(
        "CDF starts at row 1",
        "the CDF over rows has no entry for row 0: the row found is one too far down",
        "the light is lower by a row: seen on small maps only",
        "where the prefix sum starts, and what the search returns",
        _drawn_by("CDF starts at row 1"),
        by_pixels=True,
    ),
    Cause(
        "CDF sorted",
        "the weights were sorted before they were summed",
        "all light comes from one side of the map, from its right columns",
        "where the CDF is built: the order must be that of the pixels",
        _drawn_by("CDF sorted"),
    ),
    Cause(
        "luminance of Rec. 709",
        "pixels are drawn by 0.2126 R + 0.7152 G + 0.0722 B, and divided by (R + G + B) / 3",
        "coloured lamps are too bright or too dark",
        "one definition of luminance must serve both the CDFs and the term",
        _drawn_by("luminance of Rec. 709"),
        factors=(1,),
    ),
    Cause(
        "map clipped to 1",
        "the map's values were clipped to 1 before sampling, as in an 8-bit picture",
        "lamps are far too weak",
        "where the map is read or converted",
        CHANGES["map clipped to 1"],
    ),
    Cause(
        "map clipped to 255",
        "the map's values were clipped to 255",
        "the sun or the brightest lamps are too weak",
        "where the map is read or converted",
        CHANGES["map clipped to 255"],
    ),
    Cause(
        "map gamma-encoded",
        "the map's values were raised to 1 / 2.2, as for a display",
        "little contrast: lamps too weak, walls too bright",
        "where the map is read: radiance is linear",
        CHANGES["map gamma-encoded"],
    ),
    Cause(
        "gamma decoded from linear values",
        "the map's values were raised to 2.2, though they are linear",
        "lamps are far too strong beside the rest",
        "where the map is read: radiance is linear",
        CHANGES["gamma decoded from linear values"],
        factors=(1,),
    ),
    Cause(
        "channels swapped",
        "red and blue are swapped",
        "warm light is cold",
        "where the file is read or written: some libraries have the order B, G, R",
        lambda L: L[..., ::-1],
    ),
    Cause(
        "image gamma-encoded",
        "the image holds values raised to 1 / 2.2, as for a display",
        "little contrast on the sphere, and too bright",
        "where the image is written: a .pfm or .exr holds linear radiance",
        picture=lambda pixels: np.maximum(pixels, 0) ** (1 / 2.2),
        in_pictures=False,
    ),
    Cause(
        "image clipped to 1",
        "values above 1 were clipped before the image was written",
        "flat white areas",
        "where the image is written: a .pfm or .exr holds any radiance",
        picture=lambda pixels: np.minimum(pixels, 1.0),
        in_pictures=False,
    ),
    Cause(
        "picture not gamma-encoded",
        "the picture holds linear values; a .png or .ppm needs them raised to 1 / 2.2 or encoded as sRGB",
        "too dark, with too much contrast",
        "where values from 0 to 1 become whole numbers from 0 to 255",
        picture=lambda pixels: np.maximum(pixels, 0) ** 2.2,
        in_pictures=True,
    ),
    Cause(
        "picture gamma-encoded twice",
        "the picture's values were raised to 1 / 2.2 twice, or encoded by the program and again by its library",
        "too pale, with little contrast",
        "where values from 0 to 1 become whole numbers from 0 to 255",
        picture=lambda pixels: np.maximum(pixels, 0) ** (1 / 2.2),
        in_pictures=True,
    ),
    Cause(
        "cosine not clamped",
        "lights behind the surface are subtracted: max(0, n . w) lacks its max",
        "the side away from the light is black or negative, and the rest too dark",
        "where n . w is used",
        surface=_unclamped,
    ),
    Cause(
        "absolute cosine",
        "|n . w| is used for max(0, n . w)",
        "the side away from the light shines as the side towards it does",
        "where n . w is used",
        surface=_both_sides,
    ),
    Cause(
        "normals not normalised",
        "the normal is (x, y, 1) and not (x, y, sqrt(1 - x^2 - y^2))",
        "the rim of the sphere is too bright, and its shape looks flat",
        "where a pixel's normal is made",
        surface=_flat,
    ),
    Cause(
        "normals without their root",
        "the normal's z is 1 - x^2 - y^2 and not the root of it",
        "the sphere's rim is too dark where light comes from the front",
        "where a pixel's normal is made",
        surface=_no_root,
    ),
)
