"""Known mistakes in renderers of environment light, and the image that each of them converges to.

A light sample is drawn with probability q and adds (albedo / pi) max(0, n . w) (L / I) Phi / N to a pixel with normal
n, where I = (R + G + B) / 3 and Phi is the sum of I x solid angle. If q is proportional to I sin(theta), the sum
converges to the exact image. With a mistake it converges to another image. A cause describes that image in one of these
ways:

- ``effect``: from the map's radiance (H, W, 3), float64, to the radiance of the map whose exact image appears instead
- ``placed``: the angles theta and phi that the program gives to row y and column x of an H x W map
- ``surface``: from the irradiance, as a function of a vector, and the normals to the irradiance that the image shows
- ``picture``: from the pixels of the exact image to those in the file

The mistakes were found in student solutions and in bug reports about renderers.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..maps.geometry import solid_angles
from .laws import CHANGES, LAWS, right

Effect = Callable[[np.ndarray], np.ndarray]
Placed = Callable[[np.ndarray, np.ndarray, int, int], tuple[np.ndarray, np.ndarray]]
Irradiance = Callable[[np.ndarray], np.ndarray]  # from vectors (N, 3) of any length to (N, 3)


@dataclass(frozen=True)
class Cause:
    """A mistake: its ``name``, ``what`` it is, how it is ``seen`` in an image, and ``where`` in the code it is made."""

    name: str
    what: str
    seen: str
    where: str
    effect: Effect | None = None
    placed: Placed | None = None
    surface: Callable[[Irradiance, np.ndarray], np.ndarray] | None = None
    picture: Callable[[np.ndarray], np.ndarray] | None = None
    any_brightness: bool = False  # only the shape of the image identifies it
    rough_brightness: bool = False  # its brightness is known only roughly, because its samples vary so much
    in_pictures: bool | None = None  # True: only in PNG and PPM files; False: only in other files; None: in all
    by_pixels: bool = False  # it depends on single pixels, so a reduced map does not show it


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Finding:
    """What a check found.

    - ``agrees``: True, False, or None if that cannot be told
    - ``verdict``: one line that says so, with the causes if they are known
    - ``causes``: the mistakes that explain the result
    - ``orientation``: how the result is turned or mirrored, or whose convention it follows; "" if it is not turned
    """

    agrees: bool | None
    verdict: str
    causes: tuple[Cause, ...] = ()
    orientation: str = ""

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self.verdict}>"

    @property
    def cause(self) -> Cause | None:
        """The first of the causes, None if there is none."""
        return next(iter(self.causes), None)

    def to_dict(self) -> dict[str, object]:
        """The same for JSON."""
        return {
            "agrees": self.agrees,
            "verdict": self.verdict,
            "cause": self.cause and self.cause.name,
            "causes": [{"name": c.name, "what": c.what, "seen": c.seen, "where": c.where} for c in self.causes],
            "orientation": self.orientation,
        }


def centred(y: np.ndarray, x: np.ndarray, H: int, W: int) -> tuple[np.ndarray, np.ndarray]:
    """The correct angles theta and phi, those of pixel centres."""
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


def _scaled(of_theta: float, of_phi: float) -> Placed:
    def placed(y: np.ndarray, x: np.ndarray, H: int, W: int) -> tuple[np.ndarray, np.ndarray]:
        theta, phi = centred(y, x, H, W)
        return of_theta * theta, of_phi * phi

    return placed


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
        "the pixel weights lack sin(theta), or the density lacks the pixel's solid angle",
        "too much light from straight up and straight down, the poles of the map",
        "where the weights for the CDFs are computed, and where p(x, y) is divided by the solid angle",
        _drawn_by("no sin(theta)"),
        any_brightness=True,
    ),
    Cause(
        "p of a pixel used as a density",
        "the radiance is divided by p(x, y), a pixel's probability, instead of p(x, y) / solid angle of the pixel",
        "thousands of times too bright, with too much light from straight up and straight down",
        "where a sample's contribution is divided by its density",
        lambda L: L / solid_angles(*L.shape[:2])[:, None, None],
        any_brightness=True,
        rough_brightness=True,
    ),
    Cause(
        "sin(theta) twice",
        "sin(theta) is in the weights twice, or in both the weights and a sample's contribution",
        "too little light from above and below",
        "where the weights for the CDFs are computed, and where the samples are summed",
        _drawn_by("sin(theta) twice"),
        any_brightness=True,
    ),
    Cause(
        "theta over half its range",
        "theta runs from 0 to pi / 2 over the rows instead of 0 to pi",
        "all light comes from above; the lower half of the sphere is dark",
        "where theta is computed: pi (y + 1/2) / H, not pi / 2",
        placed=_scaled(0.5, 1),
    ),
    Cause(
        "theta over twice its range",
        "theta runs from 0 to 2 pi over the rows instead of 0 to pi",
        "light from the lower half of the map arrives from above, on the opposite side",
        "where theta is computed: pi (y + 1/2) / H, not 2 pi",
        placed=_scaled(2, 1),
    ),
    Cause(
        "phi over half its range",
        "phi runs from 0 to pi over the columns instead of 0 to 2 pi",
        "all light comes from one side",
        "where phi is computed: 2 pi (x + 1/2) / W, not pi",
        placed=_scaled(1, 0.5),
    ),
    Cause(
        "x and y swapped",
        "phi is computed from the row and theta from the column",
        "lamps are in entirely wrong places",
        "where a pixel (x, y) becomes (phi, theta), or where an array is indexed [x][y]",
        placed=lambda y, x, H, W: (np.pi * (x + 0.5) / W, 2 * np.pi * (y + 0.5) / H),
    ),
    Cause(
        "pixel edges for centres",
        "the direction of a pixel is that of its upper left corner",
        "the light is turned by half a pixel, which shows only with small maps",
        "where theta and phi are computed: pi (y + 1/2) / H and 2 pi (x + 1/2) / W; the halves are missing",
        placed=lambda y, x, H, W: (np.pi * y / H, 2 * np.pi * x / W),
    ),
    Cause(
        "W - 1 for W",
        "phi or theta is divided by the last index instead of the number of pixels",
        "the light is turned, by up to a pixel at the right end of the map",
        "where phi is computed: 2 pi (x + 1/2) / W, not / (W - 1)",
        placed=lambda y, x, H, W: (np.pi * y / max(H - 1, 1), 2 * np.pi * x / max(W - 1, 1)),
    ),
    Cause(
        "one random number for row and column",
        "the number that picks the row also picks the column",
        "only pixels along a curve through the map are ever drawn, and most lamps are missing",
        "where the two random numbers of a sample are generated",
        _drawn_by("one random number for row and column"),
        by_pixels=True,
    ),
    Cause(
        "row CDF of another row",
        "the column is drawn from the CDF of a neighbouring row",
        "light is spread out; the edges of lamps are too bright",
        "where the CDF of the row is looked up: its offset is row x width",
        _drawn_by("row CDF of another row"),
        by_pixels=True,
    ),
    Cause(
        "CDF starts at row 1",
        "the CDF over rows has no entry for row 0, so the search returns the row below the right one",
        "the light comes from one row too low, which shows only with small maps",
        "where the prefix sum starts, and what the search returns",
        _drawn_by("CDF starts at row 1"),
        by_pixels=True,
    ),
    Cause(
        "CDF sorted",
        "the weights were sorted before they were summed",
        "all light comes from one side, the right columns of the map",
        "where the CDF is built: the pixels must keep their order",
        _drawn_by("CDF sorted"),
    ),
    Cause(
        "luminance of Rec. 709",
        "pixels are drawn by 0.2126 R + 0.7152 G + 0.0722 B, but divided by (R + G + B) / 3",
        "coloured lamps are too bright or too dark",
        "where luminance is computed: the CDFs and the contribution of a sample must use the same definition",
        _drawn_by("luminance of Rec. 709"),
        any_brightness=True,
    ),
    Cause(
        "map clipped to 1",
        "the values of the map were clipped to 1 before sampling, as in an 8-bit picture",
        "lamps are far too weak",
        "where the map is read or converted",
        CHANGES["map clipped to 1"],
    ),
    Cause(
        "map clipped to 255",
        "the values of the map were clipped to 255",
        "the sun or the brightest lamps are too weak",
        "where the map is read or converted",
        CHANGES["map clipped to 255"],
    ),
    Cause(
        "map gamma-encoded",
        "the values of the map were raised to 1 / 2.2, as for a display",
        "little contrast: lamps are too weak, walls too bright",
        "where the map is read: radiance is linear",
        CHANGES["map gamma-encoded"],
    ),
    Cause(
        "gamma decoded from linear values",
        "the values of the map were raised to 2.2, although they are linear",
        "lamps are far too strong compared with the rest",
        "where the map is read: radiance is linear",
        CHANGES["gamma decoded from linear values"],
        any_brightness=True,
    ),
    Cause(
        "channels swapped",
        "red and blue are swapped",
        "warm light looks cold",
        "where the file is read or written: some libraries store channels in the order B, G, R",
        lambda L: L[..., ::-1],
    ),
    Cause(
        "image gamma-encoded",
        "the values of the image were raised to 1 / 2.2, as for a display",
        "too bright, with little contrast",
        "where the image is written: a .pfm or .exr file holds linear radiance",
        picture=lambda pixels: np.maximum(pixels, 0) ** (1 / 2.2),
        in_pictures=False,
    ),
    Cause(
        "image clipped to 1",
        "values above 1 were clipped before the image was written",
        "flat white areas",
        "where the image is written: a .pfm or .exr file can hold any radiance",
        picture=lambda pixels: np.minimum(pixels, 1.0),
        in_pictures=False,
    ),
    Cause(
        "picture not gamma-encoded",
        "the picture holds linear values; a .png or .ppm file needs them raised to 1 / 2.2 or encoded as sRGB",
        "too dark, with too much contrast",
        "where values from 0 to 1 become integers from 0 to 255",
        picture=lambda pixels: np.maximum(pixels, 0) ** 2.2,
        in_pictures=True,
    ),
    Cause(
        "picture gamma-encoded twice",
        "the values of the picture were raised to 1 / 2.2 twice, or by the program and again by its image library",
        "too pale, with little contrast",
        "where values from 0 to 1 become integers from 0 to 255",
        picture=lambda pixels: np.maximum(pixels, 0) ** (1 / 2.2),
        in_pictures=True,
    ),
    Cause(
        "cosine not clamped",
        "light from behind the surface is subtracted: max(0, n . w) lacks its max",
        "the side facing away from the light is black or negative, and the rest is too dark",
        "where n . w is computed",
        surface=_unclamped,
    ),
    Cause(
        "absolute cosine",
        "|n . w| is used instead of max(0, n . w)",
        "the side facing away from the light is as bright as the side facing it",
        "where n . w is computed",
        surface=_both_sides,
    ),
    Cause(
        "normals not normalised",
        "the normal is (x, y, 1) instead of (x, y, sqrt(1 - x^2 - y^2))",
        "the rim of the sphere is too bright, and the sphere looks flat",
        "where the normal of a pixel is computed",
        surface=_flat,
    ),
    Cause(
        "normals without square root",
        "the z of the normal is 1 - x^2 - y^2, without the square root",
        "the rim of the sphere is too dark where light comes from the front",
        "where the normal of a pixel is computed",
        surface=_no_root,
    ),
)
