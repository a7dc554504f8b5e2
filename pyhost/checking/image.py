"""Does another renderer's image of the diffuse sphere agree with the exact one, and if not, what went wrong?

The sphere is found in the image, and the moments of image and exact image are compared. They may differ by as much as
those of an unbiased estimator with N samples (:mod:`lightdome.checking.statistics`). If they differ by more, the image
is compared with explanations: a factor on the brightness, a mirror or a turn, and what each known mistake converges to
(:mod:`lightdome.checking.causes`). The verdict names the explanation that fits, unless others fit equally well.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from typing import Literal

import numpy as np

from .. import checks
from ..disc import disc_mask
from ..errors import LightdomeError
from ..evaluation.metrics import relative_rmse
from ..lighting.exact import exact, exact_kept
from ..maps.envmap import EnvironmentMap
from ..maps.geometry import directions, solid_angles
from ..opencl.device import Device
from ..progress import Progress
from .causes import CAUSES, Cause, Finding, Irradiance, Placed, centred
from .disc import find_disc, seen_in
from .files import GAMMA
from .statistics import (
    Expected,
    Population,
    Sampling,
    Spread,
    moments,
    moments_of_each,
    noise_of,
    normals,
    population,
    zernike,
)
from .turn import Orientation, find_orientation, table_of

GRID = 63  # pixels across the disc in the images of hypotheses
FEW = 4  # covariances use every fourth of those pixels
DRAWN = 1024  # samples from which the covariance of a mistake is computed
MAP_ROWS = 512  # to which a map is reduced to compute the image of a mistake
BLOCKS = 64  # rows of blocks that replace the map's pixels in that image
MAP_ROWS_OF_PAIRS, BLOCKS_OF_PAIRS = 128, 16  # the same for two mistakes at once, since there are many pairs
LIMIT = 5.0  # standard deviations beyond which an image is biased
EXPLAINED = 0.1  # share of the deviations that an explanation may leave: mistakes change the spread of samples
EXPLAINED_BY_TWO = 0.04  # the same for two mistakes: among so many pairs, one may fit by chance
CLEAR = 1.0  # standard deviations by which the best explanation must beat the others
CONVERGED = 0.005  # relative RMSE up to which an image agrees if its number of samples is not known
PRECISION = 1e-3  # relative error of moments that rounding and other pixel filters may cause
PICTURE_PRECISION = 3e-2  # the same for pictures, whose encoding may differ a little from gamma 2.2
WHITE = 254.5 / 255  # encoded value from which a picture may be clipped
FEWEST = 16  # samples assumed at least, if their number is not known
TIMES = 30  # an explanation must then fit even with this many times the samples for which the image would agree
MOST_DRAWN = 2**20  # samples; with more, the moments are normally distributed, and no sets are drawn
EVENTS = 50  # with fewer hits of lamps in an image, a missing lamp proves nothing
FLIPS: dict[str, tuple[slice, slice]] = {
    "mirrored left to right": np.s_[:, ::-1],
    "upside down": np.s_[::-1, :],
    "turned by 180 degrees in the image": np.s_[::-1, ::-1],
}
FACTORS = {
    math.pi: "the 1 / pi of the BRDF is missing",
    1 / math.pi: "divided by pi twice",
    2 * math.pi: "the 1 / pi of the BRDF is missing, and there is an extra factor of 2",
    1 / (2 * math.pi): "there is an extra factor of 1 / (2 pi), the uniform density over the hemisphere",
    4 * math.pi: "there is an extra factor of 4 pi, the area of the sphere",
    1 / (4 * math.pi): "divided by the area of the sphere, 4 pi",
    math.pi**2: "there is an extra factor of pi, and the 1 / pi of the BRDF is missing",
    2.0: "there is an extra factor of 2",
    0.5: "a factor of 2 is missing",
}


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ImageCheck(Finding):
    """What :func:`check_image` found.

    - ``factor``: (3,), brightness of each channel relative to the exact image; 1 if it is right
    - ``disc``: centre x, centre y and radius of the sphere, in pixels from the upper left corner of the image
    - ``relative_rmse``; ``bias``: (3,), relative, by channel; ``largest_error``: of radiance, at ``largest_at`` (x, y).
      These compare the image, as it is, with the exact one
    - ``deviations``: by how many standard deviations the moments of the image are off
    - ``expected``: the error expected with so many samples, if their number was given
    - ``image``, ``exact``: (R, R, 3), the images that were compared
    - ``file_shape``: height and width of the image as it was given
    """

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

    def to_dict(self) -> dict[str, object]:
        """The same for JSON, without the images."""
        return super().to_dict() | {
            "factor_rgb": [float(f) for f in self.factor],
            "disc_centre_x_pixels": self.disc[0],
            "disc_centre_y_pixels": self.disc[1],
            "disc_radius_pixels": self.disc[2],
            "relative_rmse": self.relative_rmse,
            "bias_relative_rgb": [float(b) for b in self.bias],
            "largest_error_radiance": self.largest_error,
            "largest_error_at_pixel": list(self.largest_at),
            "deviations": self.deviations,
            "expected": self.expected
            and {
                "samples": self.expected.count,
                "per_pixel": self.expected.per_pixel,
                "relative_rmse_mean": self.expected.mean,
                "relative_rmse_5_percent": self.expected.low,
                "relative_rmse_95_percent": self.expected.high,
            },
        }


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

    - ``samples``: number of samples, if all pixels share them
    - ``spp``: number of samples per pixel, if each pixel has fresh ones
    - ``linear``: False for the decoded values, 0 to 1, of a picture: its brightness is ignored then, and values of 1
      are taken as clipped

    Without ``samples`` and ``spp`` the image must be the exact one within 0.5 %, or differ only by the noise of single
    pixels. Raises :class:`LightdomeError` for another shape, for values that are not finite, if both numbers are given,
    and for a black map.
    """
    checks.instance("the device", device, Device)
    checks.instance("the map", envmap, EnvironmentMap)
    image = checks.array("the image", image, ("h", "w", 3), np.float32)
    if samples is not None and spp is not None:
        raise LightdomeError("give samples, which all pixels share, or spp, samples per pixel, but not both")
    count = (
        None if samples is None and spp is None else checks.whole("a number of samples", samples or spp, 1, 2**31 - 1)
    )
    albedo, linear = checks.albedo(albedo), checks.flag("linear", linear)
    if not (envmap.peak > 0 and albedo > 0):
        raise LightdomeError("the map is black or the albedo 0: every image of it is black")
    return Reference(device, envmap, albedo).check(image, count, spp is not None, linear)


@dataclass(frozen=True)
class _Hypothesis:
    """An explanation, with the image that it expects: the ``pixels`` (P, 3) of a disc of :data:`GRID` pixels.

    - ``covariance``: of the moments of one sample; None if it is that of the correct image
    - ``factors``: number of free factors on the brightness: none, 1, or 3 for one per channel
    - ``is_named``: whether the factor is one of a known mistake
    """

    pixels: np.ndarray
    causes: tuple[Cause, ...] = ()
    orientation: Orientation | None = None
    covariance: np.ndarray | None = None
    factors: int = 0
    is_named: bool = False

    @property
    def simplicity(self) -> float:
        """By how many standard deviations it must fit better than the simplest hypothesis."""
        factors = 1.0 if self.is_named else 2.0 * self.factors**0.5
        if any(cause.rough_brightness for cause in self.causes):
            factors = 0.0
        return factors + 1.0 * len(self.causes) + 1.5 * (self.orientation is not None)


def _reduced(envmap: EnvironmentMap, rows: int) -> EnvironmentMap:
    """The map, reduced to at most so many rows."""
    height, width = envmap.height, envmap.width
    step = -(-height // rows)
    if step == 1:
        return envmap
    area = solid_angles(height, width)[:, None, None].astype(np.float32)
    across = np.add.reduceat(envmap.radiance, np.arange(0, width, step), axis=1)
    across /= np.diff(np.arange(0, width + step, step).clip(max=width))[:, None]
    first = np.arange(0, height, step)
    return EnvironmentMap(np.add.reduceat(across * area, first) / np.add.reduceat(area, first))


class Reference:
    """What images lit by a map are checked against; one serves many images. See :func:`check_image` for arguments."""

    def __init__(self, device: Device, envmap: EnvironmentMap, albedo: float = 1.0) -> None:
        self.device, self.envmap, self.albedo = device, envmap, albedo
        self.grid = normals(GRID)
        self.basis = zernike(self.grid)
        self.mask = disc_mask(GRID)
        self.sampling = Sampling(envmap, albedo, self.grid)
        self.right = self._pixels(exact(device, envmap, GRID, albedo))

    def check(
        self, image: np.ndarray, count: int | None = None, per_pixel: bool = False, linear: bool = True
    ) -> ImageCheck:
        """Check an image (h, w, 3) with ``count`` samples, which its pixels share unless ``per_pixel``."""
        if min(image.shape[:2]) < 16:
            raise LightdomeError(
                f"the image must have at least 16 x 16 pixels, got {image.shape[1]} x {image.shape[0]}"
            )
        bad = ~np.isfinite(image).all(axis=2)
        if bad.any():
            y, x = np.argwhere(bad)[0]
            raise LightdomeError(f"{bad.sum()} pixels of the image are NaN or infinite, the first at x = {x}, y = {y}")
        return _Check(self, image, count, per_pixel, linear).result()

    def _pixels(self, image: np.ndarray) -> np.ndarray:
        return image[self.mask].astype(np.float64)

    @cached_property
    def small(self) -> EnvironmentMap:
        """The map, reduced for single mistakes."""
        return _reduced(self.envmap, MAP_ROWS)

    @cached_property
    def smaller(self) -> EnvironmentMap:
        """The map, reduced for pairs of mistakes."""
        return _reduced(self.envmap, MAP_ROWS_OF_PAIRS)

    def blocks(self, radiance: np.ndarray, rows: int = BLOCKS) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """One light per block of pixels, in so many rows: its row (N,) and column (N,) in the map, and flux (N, 3)."""
        height, width = radiance.shape[:2]
        flux = (radiance * solid_angles(height, width)[:, None, None]).reshape(-1, 3)
        y, x = np.divmod(np.arange(height * width), width)
        step = max(1, height // rows)
        block = (y // step) * (-(-width // step)) + x // step
        light = flux.mean(axis=1)
        sums = np.bincount(block, light)
        lit = sums > 0
        row, column = (np.bincount(block, light * at)[lit] / sums[lit] for at in (y, x))
        total = np.stack([np.bincount(block, flux[:, c])[lit] for c in range(3)], axis=1)
        return *self._own(row, column, height, width), total

    def _own(self, row: np.ndarray, column: np.ndarray, height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
        """Places in a map of another size as places in this map; pixel centres are whole numbers."""
        own = self.envmap
        return (row + 0.5) * (own.height / height) - 0.5, (column + 0.5) * (own.width / width) - 0.5

    def _light(self, radiance: np.ndarray, placed: Placed = centred, rows: int = BLOCKS) -> Irradiance:
        """The radiance of a surface lit by the blocks of a map, as a function of normals (N, 3) of any length."""
        row, column, flux = self.blocks(radiance.astype(np.float64), rows)
        direction = directions(*placed(row, column, self.envmap.height, self.envmap.width)).astype(np.float32)
        flux = (flux * (self.albedo / math.pi)).astype(np.float32)

        def irradiance(vector: np.ndarray) -> np.ndarray:
            parts = np.array_split(vector.astype(np.float32), 1 + len(vector) // 1024)
            return np.concatenate([np.maximum(0, part @ direction.T) @ flux for part in parts])

        return irradiance

    @cached_property
    def light(self) -> Irradiance:
        return self._light(self.small.radiance)

    @cached_property
    def seen(self) -> np.ndarray:
        """The pixels of the disc lit by blocks."""
        return self.light(self.grid)

    @cached_property
    def seen_smaller(self) -> np.ndarray:
        return self._light(self.smaller.radiance, rows=BLOCKS_OF_PAIRS)(self.grid)

    @cached_property
    def table(self) -> np.ndarray:
        return table_of(self.light)

    @cached_property
    def causes(self) -> list[_Hypothesis]:
        """The known mistakes that this map can show."""
        return self._made([(cause,) for cause in CAUSES], "simulating known mistakes")

    @cached_property
    def pairs(self) -> list[_Hypothesis]:
        """Two of the mistakes at once; those of reading the map, which are last in the list, come first."""
        shown = [made.causes[0] for made in self.causes]
        return self._made(list(combinations(reversed(shown), 2)), "simulating pairs of mistakes")

    def _made(self, lists: Sequence[tuple[Cause, ...]], label: str) -> list[_Hypothesis]:
        result = []
        with Progress(label) as progress:
            for n, causes in enumerate(lists, 1):
                if made := self._with(causes):
                    result.append(made)
                progress.update(n / len(lists))
        return result

    def _with(self, causes: tuple[Cause, ...]) -> _Hypothesis | None:
        """The disc with these mistakes, or None if they exclude each other or one makes no difference with this map."""
        placed = [cause.placed for cause in causes if cause.placed] or [centred]
        surface = [cause.surface for cause in causes if cause.surface] or [lambda light, normal: light(normal)]
        picture = [cause.picture for cause in causes if cause.picture] or [lambda pixels: pixels]
        if max(len(placed), len(surface), len(picture)) > 1:
            return None
        single = len(causes) == 1
        small, seen, rows = (
            (self.small, self.seen, BLOCKS) if single else (self.smaller, self.seen_smaller, BLOCKS_OF_PAIRS)
        )
        radiance = small.radiance.astype(np.float64)
        for cause in causes:
            if cause.effect:
                if cause.by_pixels and small is not self.envmap:
                    return None
                with np.errstate(over="ignore"):
                    changed = np.minimum(cause.effect(radiance), np.finfo(np.float32).max)
                if np.array_equal(changed.astype(np.float32), radiance.astype(np.float32)):
                    return None
                radiance = changed
        pixels = self.right + surface[0](self._light(radiance, placed[0], rows), self.grid) - seen
        made = _Hypothesis(picture[0](pixels), causes)
        if not single or causes[0].picture:  # the covariance of the correct image is close enough
            return made
        drawn = self.drawn
        if causes[0].effect:
            drawn = population(EnvironmentMap(radiance), DRAWN)
            row, column = self._own(drawn.row, drawn.column, small.height, small.width)
            drawn = replace(drawn, row=row, column=column)
        towards = directions(*placed[0](drawn.row, drawn.column, self.envmap.height, self.envmap.width))
        cosine = surface[0](lambda vector: np.maximum(0, vector @ towards.T), self.grid[::FEW])
        return replace(made, covariance=self.covariance(cosine, drawn))

    @cached_property
    def drawn(self) -> Population:
        return population(self.envmap, DRAWN)

    def covariance_of(self, direction: np.ndarray, drawn: Population) -> np.ndarray:
        """The covariance of the moments of one sample, if samples come from these directions."""
        return self.covariance(np.maximum(0, self.grid[::FEW] @ direction.T), drawn)

    def covariance(self, cosine: np.ndarray, drawn: Population) -> np.ndarray:
        """The covariance of the moments of one sample, given the cosines of samples with every fourth normal."""
        each = moments_of_each(cosine, self.basis[::FEW], drawn.light * self.albedo, drawn.probability)
        return (each * drawn.probability[:, None]).T @ each

    @cached_property
    def factors(self) -> dict[float, str]:
        """Factors on the brightness that mistakes cause, with their reasons."""
        area = solid_angles(self.envmap.height, self.envmap.width)
        rows = self.envmap.radiance.mean(axis=2, dtype=np.float64).sum(axis=1)
        flux = float((rows * area).sum())
        named = {
            **FACTORS,
            1 / flux: "the total flux of the map is missing",
            float(rows.sum()) / flux: "the sum of luminance without solid angles is used as the total flux",
        }
        if abs(self.albedo - 1) > 0.01:
            named |= {1 / self.albedo: "the albedo is missing", math.pi / self.albedo: "albedo / pi is missing"}
        return named


class _Check:
    def __init__(
        self, reference: Reference, image: np.ndarray, count: int | None, per_pixel: bool, linear: bool
    ) -> None:
        self.reference, self.count, self.per_pixel, self.linear = reference, count, per_pixel, linear
        self.file_shape = image.shape[:2]
        self.disc = find_disc(image)
        self.image = seen_in(image, self.disc)
        side = len(self.image)
        mask = disc_mask(side)
        self.normal, self.pixels = normals(side), self.image[mask]
        self.basis, self.grid_basis = zernike(self.normal), reference.basis
        self.precision = PRECISION if linear else PICTURE_PRECISION
        self.valid, self.is_white = np.ones(len(self.pixels), bool), False
        if not linear:  # leave out what may be clipped to white
            self.valid = (self.pixels < WHITE**GAMMA).all(axis=1)
            self.is_white = self.valid.mean() < 0.2
            self.valid |= self.is_white
            at = (2 * np.arange(GRID) + 1) * side // (2 * GRID)
            valid = np.ones((side, side), bool)
            valid[mask] = self.valid
            self.basis = self.basis * self.valid[:, None]
            self.grid_basis = self.grid_basis * valid[at[:, None], at][reference.mask][:, None]
        both: tuple[Literal["centres", "areas"], ...] = ("centres", "areas")  # both are right: take the closer one
        images = [exact_kept(reference.device, reference.envmap, side, pixels) for pixels in both]
        self.exact = min(
            (image.astype(np.float64) * reference.albedo for image in images),
            key=lambda e: float(((e[mask] - self.pixels) ** 2).sum()) if linear else 0.0,
        )
        self.truth = self.exact[mask]
        sampling = reference.sampling
        self.expected = sampling.expected(count, per_pixel) if count else None
        self.shared = count is not None and not per_pixel
        self.moments = moments(self.basis, self.pixels)
        self.true_moments = moments(self.basis, self.truth)
        self.of_samples = count if self.shared else None  # number of samples that all pixels share
        self.spread = self._spread()

    @cached_property
    def noise(self) -> np.ndarray:
        """The covariance of the moments that the noise of single pixels causes."""
        return noise_of(self.basis, self.pixels - self.truth, len(self.image))

    def _spread(self, drawn: bool = True) -> Spread:
        """The spread over correct images, measured with ``drawn`` sets of samples where that is fast."""
        covariance, sampling = self._covariance(self.true_moments), self.reference.sampling
        if self.of_samples is None or self.of_samples > MOST_DRAWN or not drawn:
            floor = self.precision**2 * float(self.true_moments @ self.true_moments)
            share = 1 - floor / np.linalg.eigvalsh(covariance)
            return Spread(max(1.0, float(share.sum())))
        sets = sampling.sets(self.of_samples)
        return Spread.of(np.einsum("si,si->s", sets, np.linalg.solve(covariance, sets.T).T))

    def _covariance(self, expected: np.ndarray, of_one: np.ndarray | None = None, factor: float = 1.0) -> np.ndarray:
        """The covariance of moments with the mean ``expected``, from the covariance ``of_one`` sample."""
        true_size = float(self.true_moments @ self.true_moments)
        size = max(float(expected @ expected), 1e-12 * true_size)
        floor = np.eye(len(expected)) * (self.precision**2 * size)
        if self.of_samples is None:
            return self.noise + floor
        if of_one is None:
            return self.reference.sampling.covariance * (size / true_size / self.of_samples) + floor
        return of_one * (factor**2 / self.of_samples) + floor

    def _unscaled(self, hypothesis: _Hypothesis) -> np.ndarray:
        """The moments that a hypothesis expects, before factors."""
        return self.true_moments + moments(self.grid_basis, hypothesis.pixels - self.reference.right)

    def factor(self, hypothesis: _Hypothesis) -> np.ndarray:
        """The factors on the brightness of the channels that fit best, (3,)."""
        expected = self._unscaled(hypothesis)
        if not hypothesis.factors:
            return np.ones(3)
        split = np.zeros((len(expected), hypothesis.factors))  # the order of moments is (polynomial, channel)
        split[np.arange(len(expected)), np.arange(len(expected)) % hypothesis.factors] = expected
        rough = float(self.moments @ expected) / max(float(expected @ expected), 1e-300)
        weighted = np.linalg.solve(self._covariance(expected * rough, hypothesis.covariance, rough), split)
        return np.resize(np.linalg.lstsq(split.T @ weighted, weighted.T @ self.moments, rcond=None)[0], 3)

    def off(self, hypothesis: _Hypothesis) -> float:
        """The standard deviations between the image and a hypothesis with its best factors."""
        factor = self.factor(hypothesis)
        expected = self._unscaled(hypothesis) * np.resize(factor, self.moments.shape)
        covariance = self._covariance(expected, hypothesis.covariance, float(factor.mean()))
        difference = self.moments - expected
        return self.spread.deviations(float(difference @ np.linalg.solve(covariance, difference)))

    def hypotheses(self) -> list[_Hypothesis]:
        """All explanations with at most one mistake."""
        reference = self.reference
        scales = (0, 1, 3) if self.linear else (1,)
        result = [_Hypothesis(reference.right, factors=scale) for scale in scales if scale]
        orientation = find_orientation(reference.table, self.normal, self.pixels)
        if str(orientation):
            turned = reference.right + reference.light(reference.grid @ orientation.matrix.T) - reference.seen
            covariance = reference.covariance_of(reference.drawn.direction @ orientation.matrix, reference.drawn)
            result += [
                _Hypothesis(turned, orientation=orientation, covariance=covariance, factors=scale)
                for scale in scales[:2]
            ]
        return [self._named(h) for h in result] + self._scaled(reference.causes)

    def _scaled(self, mistaken: Sequence[_Hypothesis]) -> list[_Hypothesis]:
        """The same with the factors that each may have, without those that are impossible."""
        result = []
        for one in mistaken:
            if any(cause.in_pictures is not None and cause.in_pictures == self.linear for cause in one.causes):
                continue
            free = not self.linear or any(cause.any_brightness for cause in one.causes)
            result += [replace(one, factors=n) for n in ((1,) if free else (0, 1))]
        return [h for h in result if self._is_as_bright(h)]

    def _is_as_bright(self, hypothesis: _Hypothesis) -> bool:
        """Whether the brightness is near that of the cause, if that is known roughly."""
        is_known = self.linear and any(cause.rough_brightness for cause in hypothesis.causes)
        return not is_known or 0.6 < self.factor(hypothesis)[0] < 1.6

    def pairs(self) -> list[tuple[float, _Hypothesis]]:
        """Explanations by two mistakes, a flipped image among them, and the standard deviations that each leaves."""
        reference = self.reference
        result = [(self.off(h), h) for h in self._scaled(reference.pairs)]
        for name, flip in FLIPS.items():
            other = _Check(reference, self.image[flip], self.count, self.per_pixel, self.linear)
            other.of_samples, other.spread = self.of_samples, self.spread
            for h in other._scaled(reference.causes):
                whole = np.zeros((GRID, GRID, 3))
                whole[reference.mask] = h.pixels
                turned = replace(
                    h, pixels=whole[flip][reference.mask], orientation=Orientation(name, 0.0), covariance=None
                )
                result.append((other.off(h), turned))
        return result

    def _named(self, hypothesis: _Hypothesis) -> _Hypothesis:
        """The same, with ``is_named``."""
        if hypothesis.factors != 1 or not self.linear:
            return hypothesis
        return replace(hypothesis, is_named=bool(self._reason(float(self.factor(hypothesis)[0]))))

    def result(self) -> ImageCheck:
        right = _Hypothesis(self.reference.right, factors=0 if self.linear else 1)
        off = self.off(right)
        factor = 1.0 if self.linear else float(self.factor(right)[0])
        used = self.valid
        rmse = relative_rmse(self.pixels[used], self.truth[used] * factor) if factor else 1.0
        told = self._teller(off, rmse)
        if not self.pixels.any():
            return told(False, "does not agree: the image is black", right)
        if self.is_white:
            return told(None, "cannot tell: nearly all of the picture is white; use a lower exposure", right)
        if off < LIMIT:
            return told(True, self._agreement(rmse), right)
        if self.count is None and rmse < CONVERGED:
            return told(True, f"agrees: relative RMSE {rmse:.2%}", right)
        if not self.shared:
            by_cosine, noisy, events = self._by_cosine()
            if by_cosine < LIMIT and noisy:
                return told(
                    True, f"agrees: relative RMSE {rmse:.2%}, as expected if directions are drawn by the cosine", right
                )
            if by_cosine < LIMIT and events < EVENTS:
                return told(
                    None,
                    f"cannot tell: relative RMSE {rmse:.2%}; if directions are drawn by the cosine, so few of them may"
                    " miss some lamps of this map; use an image with more pixels or more samples per pixel"
                    + (", and give their number with --samples or --spp" if self.count is None else ""),
                    right,
                )
        most = self._samples_that_agree(right) if self.count is None else 0
        if self.count is None:
            self.of_samples = max(FEWEST, most) * TIMES
            self.spread = self._spread()
        tried = sorted(((self.off(h) + h.simplicity, h) for h in self.hypotheses()), key=lambda pair: pair[0])
        explains = max(LIMIT, EXPLAINED * off)
        score, best = tried[0]
        if score - best.simplicity < explains:
            name = self._explanation(best)
            rivals = self._rivals(tried)
            if not rivals:
                return told(False, f"does not agree; {name}", best)
            others = ", or ".join(self._explanation(h) for h in rivals)
            return told(False, f"does not agree; either {name}, or {others}", right)
        if self.image.any(axis=2).mean() > 0.95:
            return told(None, "cannot tell: this does not look like a sphere on a black background", right)
        if most:
            return told(
                None,
                f"cannot tell: relative RMSE {rmse:.2%}, which would be right if all pixels share {most} samples or"
                " fewer; give the number of samples with --samples, or per pixel with --spp",
                right,
            )
        pairs = sorted(((left + h.simplicity, h) for left, h in self.pairs()), key=lambda pair: pair[0])
        score, best = pairs[0]
        if score - best.simplicity < max(LIMIT, EXPLAINED_BY_TWO * off) and not self._is_odd(best):
            rivals = self._rivals(pairs)
            if not rivals:
                return told(False, f"does not agree; two mistakes: {self._explanation(best)}", best)
            closest = ", or ".join(" with ".join(filter(None, self._name(h))) for h in (best, *rivals[:2]))
            return told(False, f"does not agree; more than one mistake; closest: {closest}", right)
        return told(False, f"biased by {off:.0f} standard deviations; no known mistake explains it", right)

    def _is_odd(self, best: _Hypothesis) -> bool:
        """Whether the two mistakes also need a factor that no known mistake explains."""
        free = not self.linear or any(cause.any_brightness for cause in best.causes)
        return bool(best.factors) and not free and not self._reason(float(self.factor(best)[0]))

    def _rivals(self, tried: Sequence[tuple[float, _Hypothesis]]) -> list[_Hypothesis]:
        """Other explanations that fit nearly as well as the first."""
        score, best = tried[0]
        rivals = {self._name(h): h for other, h in reversed(tried[1:]) if other < score + CLEAR}
        rivals.pop(self._name(best), None)
        return list(reversed(rivals.values()))

    def _samples_that_agree(self, hypothesis: _Hypothesis) -> int:
        """The largest power of two for which the image would agree with so many shared samples, or 0."""
        for power in range(30, 3, -1):
            self.of_samples = 2**power
            self.spread = self._spread(drawn=False)
            if self.off(hypothesis) < LIMIT / 2:
                return self.of_samples
        return 0

    def _by_cosine(self) -> tuple[float, bool, float]:
        """Suppose that directions are drawn by the cosine.

        Returns by how many standard deviations the image is then off, whether it is noisy enough for that, and how many
        equally strong samples would carry all of its light.
        """
        sampling, basis = self.reference.sampling, self.reference.basis
        square = sampling.square_by_cosine()
        count = (self.count or 1) * len(self.pixels)
        drawn = np.zeros((basis.shape[1], 3, basis.shape[1], 3))
        for c in range(3):
            drawn[:, c, :, c] = (basis * square[:, [c]]).T @ basis / (len(basis) * count)
        of_pixels = drawn.reshape(self.noise.shape)
        noisy = float(np.trace(self.noise) / np.trace(of_pixels))
        difference = self.moments - self.true_moments
        covariance = of_pixels * min(1.5 * noisy, 1) + self._covariance(self.true_moments)
        size = float(difference @ np.linalg.solve(covariance, difference))
        events = count * float((sampling.mean**2).mean() / square.mean())
        return Spread(len(difference)).deviations(size), noisy > 0.2, events

    def _agreement(self, rmse: float) -> str:
        if self.expected is None:
            return f"agrees: relative RMSE {rmse:.2%}, only noise"
        e = self.expected
        per = "samples per pixel" if e.per_pixel else "samples"
        within = "less than" if rmse < e.low else "within what" if rmse <= e.high else "more than"
        drawn = " drawn in proportion to the light" if rmse > 2 * e.high else ""
        return (
            f"agrees: relative RMSE {rmse:.2%}, {within} {e.count} {per}{drawn} leave ({e.mean:.2%}, expected"
            f" {e.low:.2%} to {e.high:.2%})"
        )

    def _name(self, hypothesis: _Hypothesis) -> tuple[str, ...]:
        """The causes and the orientation."""
        return *(cause.name for cause in hypothesis.causes), str(hypothesis.orientation or "")

    def _explanation(self, best: _Hypothesis) -> str:
        said = [f"{cause.name}: {cause.what}" for cause in best.causes]
        if best.orientation:
            said.append(best.orientation.told())
        factor = self.factor(best)
        if best.factors and self.linear and not any(cause.any_brightness for cause in best.causes):
            if best.factors == 1:
                reason = self._reason(float(factor[0])) or "; no known mistake explains it"
                said.append(f"{factor[0]:.4g} times too bright{reason}")
            else:
                said.append("red {:.4g}, green {:.4g}, blue {:.4g} times too bright, otherwise right".format(*factor))
        return "; ".join(said) or "only the brightness is wrong"

    def _reason(self, factor: float) -> str:
        """ ": " and why an image may be ``factor`` times too bright, or ""."""
        tolerance = 0.02 if not self.expected else max(0.02, 2 * self.expected.mean)
        close = [(abs(math.log(factor / value)), name) for value, name in self.reference.factors.items() if factor > 0]
        distance, name = min(close, default=(math.inf, ""))
        return f": {name}" if distance < tolerance else ""

    def _teller(self, off: float, rmse: float) -> Callable[[bool | None, str, _Hypothesis], ImageCheck]:
        """A function from whether the image agrees, the verdict, and the best hypothesis to the result."""
        shape = len(self.exact)

        def told(agrees: bool | None, verdict: str, best: _Hypothesis) -> ImageCheck:
            factor = self.factor(_Hypothesis(best.pixels, factors=1)) if not self.linear else np.ones(3)
            expected = self._unscaled(best)
            found, of_best = self.moments.reshape(-1, 3), expected.reshape(-1, 3)
            by_channel = (found * of_best).sum(axis=0) / np.maximum((of_best**2).sum(axis=0), 1e-300)
            truth = self.exact * factor if self.linear else np.minimum(self.exact * factor, 1)
            mean = truth[disc_mask(shape)].mean(axis=0)
            bias = np.divide(self.pixels.mean(axis=0) - mean, mean, out=np.zeros(3), where=mean > 0)
            error = np.abs(np.where(disc_mask(shape)[..., None], self.image - truth, 0)).max(axis=2)
            y, x = np.unravel_index(error.argmax(), error.shape)
            return ImageCheck(
                agrees=agrees,
                verdict=verdict,
                causes=best.causes,
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

        return told
