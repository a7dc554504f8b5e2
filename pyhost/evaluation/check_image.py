"""Does another renderer's image of the diffuse sphere agree with the exact one, and if not, what went wrong?

The convention of the image is found first: where the sphere lies in it, mirrors and turns, one factor on the
brightness. What is left is compared with what an unbiased estimator of N samples leaves. Errors of shared samples are
smooth, and those of fresh samples per pixel are not, so bias and noise are told apart by moments of the image: its
products with Zernike polynomials up to degree 4. Of N samples that are drawn as the light is, their covariance is known
from the map; of an image with noise of its own, from that noise.

Sources: Pharr, Jakob, Humphreys, Physically Based Rendering, 4th ed., 2.1 and 2.2 (variance); Born and Wolf, Principles
of Optics, 9.2 (Zernike polynomials); Wilson and Hilferty (1931) for the tail of chi-square.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .. import checks
from ..disc import disc_mask
from ..errors import LightdomeError
from ..lighting.exact import exact, exact_kept
from ..maps.envmap import EnvironmentMap
from ..maps.geometry import column_angles, directions, row_angles, solid_angles
from ..opencl.device import Device
from ..sampling.distribution import build_distribution
from .check_causes import CAUSES, Cause, Irradiance, luminance
from .metrics import relative_rmse

DEGREE = 4  # of the polynomials
GRID = 63  # pixels across the disc, of images of single samples
SAMPLES = 4096  # that the variance of one is taken from
MAX_SIDE = 511  # pixels, of images as compared
LIMIT = 5.0  # standard deviations, from which on an image is biased
CONVERGED = 0.005  # relative RMSE, up to which an image without a number of samples agrees
PRECISION = 1e-3  # of a moment: what rounding, other integrals and other pixel filters may change
FACTORS = {
    math.pi: "the 1 / pi of the BRDF is missing",
    1 / math.pi: "divided by pi twice",
    2 * math.pi: "2 pi for 1: the 1 / pi of the BRDF is missing, and a 2 is too much",
    1 / (2 * math.pi): "a density of the hemisphere, 1 / (2 pi), is multiplied and should not be",
    4 * math.pi: "the area of the sphere, 4 pi, is multiplied and should not be",
    1 / (4 * math.pi): "divided by the area of the sphere, 4 pi",
    math.pi**2: "multiplied by pi, and the 1 / pi of the BRDF is missing",
    2.0: "twice too bright",
    0.5: "half as bright as it should be",
}


@dataclass(frozen=True)
class Expected:
    """The relative RMSE that ``count`` samples leave: its mean, and the limits of nine of ten images."""

    count: int
    per_pixel: bool
    mean: float
    low: float
    high: float


@dataclass(frozen=True)
class ImageCheck:
    """What :func:`check_image` found.

    - ``agrees``: True, False, or None where it cannot be told
    - ``verdict``: a line that says so, with the cause if it is known
    - ``cause``: the mistake that explains the image, else None
    - ``orientation``: how the image is turned or mirrored, "" for not at all
    - ``factor``: (3,), what the image is multiplied by, by channel; 1 where it is right
    - ``disc``: centre x, centre y and radius of the sphere in the file's image, pixels from its upper left corner
    - ``relative_rmse``, ``bias`` (3,) relative by channel, ``largest_error`` (radiance) at ``largest_at`` (x, y): of
      the image as it is, against the exact one
    - ``deviations``: by how many standard deviations the image's moments are off; NaN where nothing says how many are
      right
    - ``expected``: what so many samples leave, if a number was given
    - ``image``, ``exact``: (R, R, 3), as compared
    - ``file_shape``: height and width of the image as it was given
    """

    agrees: bool | None
    verdict: str
    cause: Cause | None
    orientation: str
    factor: np.ndarray
    disc: tuple[float, float, float]
    relative_rmse: float
    bias: np.ndarray
    largest_error: float
    largest_at: tuple[int, int]
    deviations: float
    expected: Expected | None
    image: np.ndarray
    exact: np.ndarray
    file_shape: tuple[int, int]
    notes: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, object]:
        """Everything but the images, for JSON."""
        return {
            "agrees": self.agrees,
            "verdict": self.verdict,
            "cause": self.cause and self.cause.name,
            "orientation": self.orientation,
            "factor_rgb": [float(f) for f in self.factor],
            "disc_centre_x_pixels": self.disc[0],
            "disc_centre_y_pixels": self.disc[1],
            "disc_radius_pixels": self.disc[2],
            "relative_rmse": self.relative_rmse,
            "bias_relative_rgb": [float(b) for b in self.bias],
            "largest_error_radiance": self.largest_error,
            "largest_error_at_pixel": list(self.largest_at),
            "deviations": None if math.isnan(self.deviations) else self.deviations,
            "expected": self.expected
            and {
                "samples": self.expected.count,
                "per_pixel": self.expected.per_pixel,
                "relative_rmse_mean": self.expected.mean,
                "relative_rmse_5_percent": self.expected.low,
                "relative_rmse_95_percent": self.expected.high,
            },
            "notes": list(self.notes),
        }


def normals(resolution: int) -> np.ndarray:
    """Unit normals of the disc's pixels, (P, 3) float64, in the order of ``image[disc_mask(resolution)]``."""
    y, x = np.nonzero(disc_mask(resolution))
    a, b = (2 * x + 1 - resolution) / resolution, (resolution - 2 * y - 1) / resolution
    return np.stack([a, b, np.sqrt(np.maximum(0, 1 - a * a - b * b))], axis=1)


def zernike(normal: np.ndarray) -> np.ndarray:
    """Zernike polynomials up to degree 4 over the disc, orthonormal in the mean: (P, 15)."""
    radius, angle = np.hypot(normal[:, 0], normal[:, 1]), np.arctan2(normal[:, 1], normal[:, 0])
    columns = []
    for n in range(DEGREE + 1):
        for m in range(-n, n + 1, 2):
            k = np.arange((n - abs(m)) // 2 + 1)
            weights = [(-1) ** i * math.comb(n - i, i) * math.comb(n - 2 * i, (n - abs(m)) // 2 - i) for i in k]
            radial = sum(w * radius ** (n - 2 * i) for w, i in zip(weights, k, strict=True))
            turn = np.cos(m * angle) if m >= 0 else np.sin(-m * angle)
            columns.append(radial * turn * math.sqrt((n + 1) * (1 if m == 0 else 2)))
    return np.stack(columns, axis=1)


class Model:
    """What one sample drawn as the light is does to the image of a map."""

    def __init__(self, device: Device, envmap: EnvironmentMap, albedo: float) -> None:
        normal = normals(GRID)
        samples = build_distribution(device, envmap).sample(SAMPLES, seed=0, sequence="sobol")
        cosine = np.maximum(0, normal @ samples.direction.T.astype(np.float64))  # (P, S)
        light = samples.flux * (SAMPLES * albedo / math.pi)  # of a set of that sample alone
        of_cosine = cosine.T @ zernike(normal) / len(normal)
        moments = (of_cosine[:, :, None] * light[:, None, :]).reshape(SAMPLES, -1)
        self.covariance = np.cov(moments.T)
        mean = cosine @ light / SAMPLES
        self.variance = float(((cosine**2) @ (light**2) / SAMPLES - mean**2).mean() / (mean**2).mean())
        self._few = cosine[::7], light, mean[::7]

    def expected(self, count: int, per_pixel: bool) -> Expected:
        """The relative RMSE that ``count`` samples leave."""
        mean = math.sqrt(self.variance / count)
        if per_pixel:  # many pixels, each with its own error: it hardly varies
            return Expected(count, True, mean, 0.9 * mean, 1.1 * mean)
        rng, taken = np.random.default_rng(0), min(count, 1024)
        cosine, light, exact = self._few
        errors = []
        for _ in range(200):
            chosen = rng.integers(0, SAMPLES, taken)
            image = cosine[:, chosen] @ light[chosen] / taken
            errors.append(relative_rmse(image, exact) * math.sqrt(taken / count))
        low, high = np.percentile(errors, [5, 95])
        return Expected(count, False, mean, float(low), float(high))


def moments(basis: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Mean products of the disc's pixels (P, 3) with ``basis`` (P, 15): (45,)."""
    return (basis.T @ pixels / len(pixels)).reshape(-1)


def noise_of(basis: np.ndarray, residual: np.ndarray, side: int) -> np.ndarray:
    """Covariance of the moments by noise of single pixels, from what is rough in ``residual`` (P, 3)."""
    mask = disc_mask(side)
    image = np.zeros((side, side, 3))
    image[mask] = residual - basis @ (basis.T @ residual / len(residual))
    rough = image - _box(image, 5) / np.maximum(_box(mask[..., None].astype(float), 5), 1)
    rough[~mask] = 0
    # Neighbours that are alike, as after a wide pixel filter, average out less.
    whole = side // 4 * 4
    blocks = image[:whole, :whole].reshape(whole // 4, 4, whole // 4, 4, 3).sum(axis=(1, 3))
    alike = max(1.0, float((blocks**2).sum() / max((rough**2).sum(), 1e-300)))
    values = rough[mask]
    count, size = basis.shape[1], len(values)
    result = np.zeros((count, 3, count, 3))
    for c in range(3):
        for d in range(3):
            result[:, c, :, d] = (basis * (values[:, [c]] * values[:, [d]])).T @ basis
    return result.reshape(3 * count, 3 * count) * (min(alike, 16.0) / size**2)


def _box(image: np.ndarray, side: int) -> np.ndarray:
    """Sums over ``side`` x ``side`` pixels round each pixel; outside the image is 0."""
    before = side // 2 + 1
    sums = np.pad(image, ((before, side // 2), (before, side // 2), (0, 0))).cumsum(axis=0).cumsum(axis=1)
    return sums[side:, side:] - sums[side:, :-side] - sums[:-side, side:] + sums[:-side, :-side]


def deviations(difference: np.ndarray, covariance: np.ndarray, size: float) -> float:
    """How far off a normal number would be, in standard deviations, to be as unlikely as ``difference`` of moments.

    ``size`` is the length of the moments, of which :data:`PRECISION` is always allowed.
    """
    values, vectors = np.linalg.eigh(covariance)
    floor = (PRECISION * size) ** 2
    freedom = max(1.0, float((np.maximum(values, 0) / (np.maximum(values, 0) + floor)).sum()))
    share = float(((vectors.T @ difference) ** 2 / (np.maximum(values, 0) + floor)).sum()) / freedom
    return (share ** (1 / 3) - (1 - 2 / (9 * freedom))) / math.sqrt(2 / (9 * freedom))


def find_disc(image: np.ndarray) -> tuple[float, float, float]:
    """Centre (x, y) and radius of the sphere, in pixels from the upper left corner, on a black background.

    It is the smallest circle about all that is not black: of a sphere that is lit from one side, too, as the ends of
    its terminator lie opposite each other. Without a black background it is the largest circle in the middle.
    """
    height, width = image.shape[:2]
    whole = width / 2, height / 2, min(height, width) / 2
    lit = (image != 0).any(axis=2)
    rows = np.flatnonzero(lit.any(axis=1))
    if len(rows) < 3 or lit.mean() > 0.95:
        return whole
    first, last = lit.argmax(axis=1)[rows], width - 1 - lit[:, ::-1].argmax(axis=1)[rows]
    points = np.concatenate([np.stack([x, rows], axis=1) for x in (first, last)], dtype=np.float64)
    points += 0.5
    centre = points.mean(axis=0)
    for step in range(1, 5000):  # Badoiu and Clarkson (2003)
        away = points - centre
        furthest = int((away**2).sum(axis=1).argmax())
        centre = centre + away[furthest] / (step + 1)
    radius = float(np.sqrt(((points - centre) ** 2).sum(axis=1).max())) + 0.05
    # A pixel counts by its centre: a circle that is the image's own within a pixel is that one.
    if max(abs(centre[0] - whole[0]), abs(centre[1] - whole[1]), abs(radius - whole[2])) < 1.5:
        return whole
    diameter, corner = round(2 * radius), np.round(centre - radius)
    snapped = corner + diameter / 2
    if abs(diameter - 2 * radius) < 0.6 and np.abs(snapped - centre).max() < 0.3:  # a whole image inside another
        return float(snapped[0]), float(snapped[1]), diameter / 2
    return float(centre[0]), float(centre[1]), radius


def seen_in(image: np.ndarray, disc: tuple[float, float, float]) -> np.ndarray:
    """The square of the sphere's diameter, (R, R, 3), R at most :data:`MAX_SIDE`; a larger one is taken in strides."""
    x, y, radius = disc
    whole = 2 * round(radius) if abs(2 * radius - round(2 * radius)) > 1e-9 else round(2 * radius)
    side = whole
    stride = -(-side // MAX_SIDE)
    side //= stride
    scale = 2 * radius / side
    across = x - radius + scale * (np.arange(side) + 0.5) - 0.5
    down = y - radius + scale * (np.arange(side) + 0.5) - 0.5
    if stride > 1 or (np.abs(across - np.round(across)).max() < 1e-6 and np.abs(down - np.round(down)).max() < 1e-6):
        rows, columns = (
            np.clip(np.round(v).astype(int), 0, n - 1) for v, n in zip((down, across), image.shape, strict=False)
        )
        return image[rows[:, None], columns].astype(np.float64)

    def spans(at: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        first = np.clip(np.floor(at).astype(int), 0, max(count - 2, 0))
        return first, np.minimum(first + 1, count - 1), np.clip(at - first, 0, 1)

    y0, y1, v = spans(down, image.shape[0])
    x0, x1, u = spans(across, image.shape[1])
    v, u = v[:, None, None], u[None, :, None]
    wide = image.astype(np.float64)
    upper = wide[y0[:, None], x0] * (1 - u) + wide[y0[:, None], x1] * u
    lower = wide[y1[:, None], x0] * (1 - u) + wide[y1[:, None], x1] * u
    return upper * (1 - v) + lower * v


def blocks_of(radiance: np.ndarray, rows: int) -> tuple[np.ndarray, np.ndarray]:
    """Lights of blocks of the map's pixels, about ``rows`` rows of them: mean directions (N, 3), and flux (N, 3)."""
    height, width = radiance.shape[:2]
    flux = (radiance * solid_angles(height, width)[:, None, None]).reshape(-1, 3)
    towards = directions(row_angles(height)[:, None], column_angles(width)[None]).reshape(-1, 3)
    y, x = np.arange(height) // max(1, height // rows), np.arange(width) // max(1, width // (2 * rows))
    block = (y[:, None] * (x[-1] + 1) + x).reshape(-1)
    count = int(block[-1]) + 1
    light = flux.mean(axis=1)
    sums = np.stack([np.bincount(block, light * towards[:, c], count) for c in range(3)], axis=1)
    total = np.stack([np.bincount(block, flux[:, c], count) for c in range(3)], axis=1)
    lit = total.any(axis=1)
    return sums[lit] / np.linalg.norm(sums[lit], axis=1, keepdims=True), total[lit]


def irradiance_of(direction: np.ndarray, flux: np.ndarray) -> Irradiance:
    """The irradiance of lights as a function of a vector: sum of flux max(0, n . w)."""

    def irradiance(vector: np.ndarray) -> np.ndarray:
        parts = np.array_split(vector, 1 + len(vector) // 1024)
        return np.concatenate([np.maximum(0, part @ direction.T) @ flux for part in parts])

    return irradiance


# How the normals of an image may be turned before they meet the light; y is up, z towards the camera.
TURNS = {
    "": np.diag([1.0, 1, 1]),
    "mirrored left to right": np.diag([-1.0, 1, 1]),
    "mirrored front to back, as if phi ran the other way": np.diag([1.0, 1, -1]),
    "upside down": np.diag([1.0, -1, 1]),
    "turned by 180 degrees in the image": np.diag([-1.0, -1, 1]),
    "turned by 90 degrees in the image": np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]]),
    "turned by 270 degrees in the image": np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]),
    "x and y exchanged in the image": np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, 1]]),
    "z taken for up": np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
    "z taken for down": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),
    "z taken for up, and mirrored": np.array([[-1.0, 0, 0], [0, 0, 1], [0, -1, 0]]),
    "z taken for down, and mirrored": np.array([[-1.0, 0, 0], [0, 0, -1], [0, 1, 0]]),
}


@dataclass(frozen=True)
class Orientation:
    """How normals are turned: by one of :data:`TURNS`, then by ``yaw`` degrees about +y."""

    turn: str
    yaw: float

    @property
    def matrix(self) -> np.ndarray:
        c, s = math.cos(math.radians(self.yaw)), math.sin(math.radians(self.yaw))
        return np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]]) @ TURNS[self.turn]

    def __str__(self) -> str:
        yaw = f"the map turned by {self.yaw:g} degrees about the vertical" if self.yaw else ""
        return " and ".join(part for part in (self.turn, yaw) if part)


def find_orientation(irradiance: Irradiance, normal: np.ndarray, pixels: np.ndarray) -> Orientation:
    """That which makes the irradiance most like ``pixels`` (P, 3) at ``normal`` (P, 3), brightness apart."""
    rows, columns = 90, 180
    table = irradiance(directions(row_angles(rows)[:, None], column_angles(columns)[None]).reshape(-1, 3))
    table = table.reshape(rows, columns, 3)

    def looked_up(vector: np.ndarray) -> np.ndarray:
        y = np.arccos(np.clip(vector[:, 1], -1, 1)) / np.pi * rows - 0.5
        x = np.arctan2(vector[:, 2], vector[:, 0]) / (2 * np.pi) * columns - 0.5
        y0, x0 = np.floor(y).astype(int), np.floor(x).astype(int)
        v, u = (y - y0)[:, None], (x - x0)[:, None]
        upper, lower = np.clip(y0, 0, rows - 1), np.clip(y0 + 1, 0, rows - 1)
        left, right = x0 % columns, (x0 + 1) % columns
        above = table[upper, left] * (1 - u) + table[upper, right] * u
        below = table[lower, left] * (1 - u) + table[lower, right] * u
        return above * (1 - v) + below * v

    few = slice(None, None, max(1, len(normal) // 400))
    normal, pixels = normal[few], pixels[few]
    size = (pixels**2).sum(axis=0)

    def unlike(orientation: Orientation) -> float:
        seen = looked_up(normal @ orientation.matrix.T)
        fitted = (seen * pixels).sum(axis=0) ** 2 / np.maximum((seen**2).sum(axis=0), 1e-300)
        return float((size - fitted).sum())

    best = min((Orientation(turn, yaw) for turn in TURNS for yaw in range(0, 360, 5)), key=unlike)
    finer = [Orientation(best.turn, (best.yaw + step / 2) % 360) for step in range(-10, 11)]
    best = min([best, *finer], key=unlike)
    # Quarter turns are what people make; of several ways to say the same, that without a turn of the map.
    quarters = [Orientation(turn, yaw) for yaw in (0, 90, 180, 270) for turn in TURNS]
    return next((near for near in quarters if np.abs(near.matrix - best.matrix).max() < math.radians(3)), best)


@dataclass(frozen=True)
class _Hypothesis:
    """An explanation: the image of the disc at :data:`GRID` pixels that it expects, (P, 3)."""

    pixels: np.ndarray
    cause: Cause | None = None
    orientation: Orientation | None = None
    scaled: bool = False

    @property
    def simplicity(self) -> float:
        """Standard deviations that a hypothesis must be better by than the simplest one."""
        return 2.0 * self.scaled + 1.0 * (self.cause is not None) + 1.5 * (self.orientation is not None)


def check_image(
    device: Device,
    image: np.ndarray,
    envmap: EnvironmentMap,
    *,
    samples: int | None = None,
    spp: int | None = None,
    albedo: float = 1.0,
    linear: bool = True,
) -> ImageCheck:
    """Compare ``image`` (h, w, 3), radiance of the diffuse sphere under ``envmap``, with the exact image.

    - ``samples``: how many samples all pixels share
    - ``spp``: how many fresh samples each pixel has
    - ``linear``: False for the values 0 to 1 of a picture for the eye, decoded: its brightness says nothing then, and
      values of 1 are clipped

    Without ``samples`` and ``spp`` the image must be the exact one within 0.5 %, or have the noise of single pixels
    alone. Raises :class:`LightdomeError` for another shape, for values that are not finite, for both numbers together,
    and for a black map.
    """
    checks.instance("the device", device, Device)
    checks.instance("the map", envmap, EnvironmentMap)
    image = checks.array("the image", image, ("h", "w", 3), np.float32)
    if samples is not None and spp is not None:
        raise LightdomeError("give the number of samples that all pixels share, or of those per pixel, not both")
    count = (
        None if samples is None and spp is None else checks.whole("a number of samples", samples or spp, 1, 2**31 - 1)
    )
    albedo, linear = checks.albedo(albedo), checks.flag("linear", linear)
    if min(image.shape[:2]) < 16:
        raise LightdomeError(f"the image must have at least 16 x 16 pixels, got {image.shape[1]} x {image.shape[0]}")
    if not np.isfinite(image).all():
        y, x = np.argwhere(~np.isfinite(image).all(axis=2))[0]
        bad = int((~np.isfinite(image).all(axis=2)).sum())
        raise LightdomeError(f"{bad} pixels of the image are NaN or infinite, the first at x = {x}, y = {y}")
    if not (envmap.peak > 0 and albedo > 0):
        raise LightdomeError(
            "the map is black, or the albedo 0: every image of it is black, and there is nothing to check"
        )
    return _Check(device, image, envmap, count, spp is not None, albedo, linear).result()


class _Check:
    def __init__(
        self,
        device: Device,
        image: np.ndarray,
        envmap: EnvironmentMap,
        count: int | None,
        per_pixel: bool,
        albedo: float,
        linear: bool,
    ) -> None:
        self.device, self.envmap, self.count, self.albedo, self.linear = device, envmap, count, albedo, linear
        self.file_shape = image.shape[:2]
        self.disc = find_disc(image)
        self.image = seen_in(image, self.disc)
        side = len(self.image)
        if not linear:
            self.image = seen_in(self.image, (side / 2, side / 2, side / 2))
        mask = disc_mask(side)
        self.normal, self.pixels = normals(side), self.image[mask]
        self.basis = zernike(self.normal)
        exact_images = [
            exact_kept(device, envmap, side, which).astype(np.float64) * albedo for which in ("centres", "areas")
        ]
        if linear:  # either integral is right: that which is closer
            self.exact = min(exact_images, key=lambda e: float(((e[mask] - self.pixels) ** 2).sum()))
        else:
            self.exact = exact_images[0]
        self.truth = self.exact[mask]
        self.model = Model(device, envmap, albedo)
        self.expected = self.model.expected(count, per_pixel) if count else None
        self.shared = count is not None and not per_pixel

        self.grid = normals(GRID)
        self.grid_basis = zernike(self.grid)
        self.grid_mask = disc_mask(GRID)
        self.true_grid = exact(device, envmap, GRID, albedo).astype(np.float64)[self.grid_mask]
        self.moments = moments(self.basis, self.pixels)
        self.true_moments = moments(self.basis, self.truth)
        self.size = float(np.linalg.norm(self.moments))
        self.noise = noise_of(self.basis, self.pixels - self.truth, side)

    def factor(self, hypothesis: _Hypothesis) -> float:
        """The factor on the brightness that fits best."""
        expected = self._expected(hypothesis)
        return float(self.moments @ expected / max(expected @ expected, 1e-300)) if hypothesis.scaled else 1.0

    def _expected(self, hypothesis: _Hypothesis) -> np.ndarray:
        return self.true_moments + moments(self.grid_basis, hypothesis.pixels - self.true_grid)

    def off(self, hypothesis: _Hypothesis) -> float:
        """Standard deviations between the image and what a hypothesis expects."""
        factor = self.factor(hypothesis)
        covariance = self.noise
        if self.shared:
            covariance = covariance + self.model.covariance * (factor**2 / self.count)
        return deviations(self.moments - factor * self._expected(hypothesis), covariance, self.size)

    def hypotheses(self) -> list[_Hypothesis]:
        """All explanations but the image's being right."""
        radiance = self.envmap.radiance.astype(np.float64)
        result = [_Hypothesis(self.true_grid, scaled=True)]
        light = irradiance_of(*blocks_of(radiance, 64))
        reflected = self.albedo / math.pi

        def seen(normal: np.ndarray) -> np.ndarray:
            return light(normal) * reflected

        orientation = find_orientation(light, self.normal, self.pixels)
        if str(orientation):
            turned = self.true_grid + seen(self.grid @ orientation.matrix.T) - seen(self.grid)
            result += [_Hypothesis(turned, orientation=orientation, scaled=scaled) for scaled in (False, True)]
        for cause in CAUSES:
            if cause.picture:
                pixels = cause.picture(self.true_grid)
            elif cause.surface:
                pixels = self.true_grid + reflected * cause.surface(light, self.grid) - seen(self.grid)
            else:
                assert cause.effect is not None
                with np.errstate(over="ignore"):
                    other = np.minimum(cause.effect(radiance), np.finfo(np.float32).max).astype(np.float32)
                if np.array_equal(other, self.envmap.radiance):
                    continue  # this map does not show it
                pixels = exact(self.device, EnvironmentMap(other), GRID, self.albedo).astype(np.float64)[self.grid_mask]
            scales = (False, True) if cause.exposed else (True,)
            result += [_Hypothesis(pixels, cause=cause, scaled=scaled) for scaled in scales]
        return result

    def result(self) -> ImageCheck:
        right = _Hypothesis(self.true_grid, scaled=not self.linear)
        off = self.off(right)
        rmse = relative_rmse(self.pixels * (1 if self.linear else 1 / self.factor(right)), self.truth)
        noisy = self.expected is not None and rmse > 2 * self.expected.high
        if off < LIMIT and not noisy:
            return self._told(True, self._agreement(rmse, off), right, off, rmse)
        if self.expected is None and rmse < CONVERGED:
            return self._told(True, f"agrees: relative RMSE {rmse:.2%}", right, off, rmse)
        tried = [(self.off(h), h) for h in self.hypotheses()]
        best_off, best = min(tried, key=lambda pair: pair[0] + pair[1].simplicity)
        explains = best_off < LIMIT or best_off < 0.25 * off
        if explains:
            return self._told(False, self._explanation(best), best, off, rmse)
        if self.expected is None:
            return self._told(
                None,
                f"cannot tell: relative RMSE {rmse:.2%}; give the number of samples with --samples or --spp",
                right,
                off,
                rmse,
            )
        if off < LIMIT:
            return self._told(
                True,
                f"agrees, with more noise than {self.expected.count} samples drawn as the light leave: relative RMSE"
                f" {rmse:.2%}, expected {self.expected.mean:.2%}",
                right,
                off,
                rmse,
            )
        return self._told(
            False, f"biased by {off:.0f} standard deviations, for no reason that is known here", right, off, rmse
        )

    def _agreement(self, rmse: float, off: float) -> str:
        if self.expected is None:
            return f"agrees: relative RMSE {rmse:.2%}, all of it noise"
        e = self.expected
        per = "samples per pixel" if e.per_pixel else "samples"
        within = "less than" if rmse < e.low else "within what" if rmse <= e.high else "little more than"
        return (
            f"agrees: relative RMSE {rmse:.2%}, {within} {e.count} {per} leave ({e.mean:.2%}, expected {e.low:.2%} to"
            f" {e.high:.2%})"
        )

    def _explanation(self, best: _Hypothesis) -> str:
        said = []
        if best.cause:
            said.append(f"{best.cause.name}: {best.cause.what}")
        if best.orientation:
            said.append(str(best.orientation))
        factor = self.factor(best)
        if best.scaled and self.linear and abs(factor - 1) > 0.01 and not (best.cause and not best.cause.exposed):
            said.append(self._brightness(factor))
        return "does not agree; " + "; ".join(said)

    def _brightness(self, factor: float) -> str:
        tolerance = 0.02 if not self.expected else max(0.02, 2 * self.expected.mean)
        area = solid_angles(self.envmap.height, self.envmap.width)[:, None]
        light = luminance(self.envmap.radiance.astype(np.float64))
        flux = float((light * area).sum())
        named = {
            **FACTORS,
            1 / flux: "the total flux of the map is missing",
            float(light.sum()) / flux: "the sum of luminance without solid angles is used for the total flux",
            self.albedo**-1: "the albedo is missing",
            math.pi / self.albedo: "albedo / pi is missing",
        }
        close = [(abs(math.log(factor / value)), name) for value, name in named.items() if factor > 0 and value != 1]
        distance, name = min(close, default=(math.inf, ""))
        if distance < tolerance:
            return f"{factor:.4g} times too bright: {name}"
        return f"{factor:.4g} times too bright, for no reason that is known here"

    def _told(self, agrees: bool | None, verdict: str, best: _Hypothesis, off: float, rmse: float) -> ImageCheck:
        factor = self.factor(best)
        expected = self._expected(best).reshape(-1, 3)
        found = self.moments.reshape(-1, 3)
        by_channel = (found * expected).sum(axis=0) / np.maximum((expected**2).sum(axis=0), 1e-300)
        truth = self.exact * (1 if self.linear else factor)
        mean = truth[disc_mask(len(truth))].mean(axis=0)
        bias = np.divide(self.pixels.mean(axis=0) - mean, mean, out=np.zeros(3), where=mean > 0)
        error = np.abs(np.where(disc_mask(len(truth))[..., None], self.image - truth, 0)).max(axis=2)
        y, x = np.unravel_index(error.argmax(), error.shape)
        return ImageCheck(
            agrees=agrees,
            verdict=verdict,
            cause=best.cause,
            orientation=str(best.orientation or ""),
            factor=by_channel,
            disc=self.disc,
            relative_rmse=rmse,
            bias=bias,
            largest_error=float(error[y, x]),
            largest_at=(int(x), int(y)),
            deviations=off,
            expected=self.expected,
            image=self.image,
            exact=truth,
            file_shape=self.file_shape,
        )
