"""The cases of the stability table, one per line: maps, random numbers, images, reflectances at their extremes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import pairwise, product
from typing import Any

import numpy as np

from .. import reference
from ..disc import disc_mask
from ..errors import LightdomeError
from ..float_range import LARGEST
from ..fresnel.equations import brewster_angle, critical_angle, fresnel
from ..lighting.exact import exact
from ..lighting.harmonics import project, shade_harmonics
from ..lighting.median_cut import median_cut
from ..lighting.shade import shade, shade_samples
from ..maps.envmap import EnvironmentMap
from ..opencl import memory
from ..opencl.device import Device
from ..rendering.per_pixel import ESTIMATORS, render
from ..sampling.distribution import build_distribution
from ..sampling.strips import strip_borders
from .stability import Case, Figures, image_figures, measure_map

Map = np.ndarray  # (H, W, 3) float32
Maps = Callable[[], Sequence[Map]]

HEIGHT, WIDTH = 64, 128
PLACES = list(product((0, HEIGHT // 2, HEIGHT - 1), (0, WIDTH // 2 - 1, WIDTH - 1)))
R = 33  # resolution of images


# ---- maps ----


def even(height: int = HEIGHT, width: int = WIDTH, value: float = 1.0) -> Map:
    return np.full((height, width, 3), value, np.float32)


def log_normal(sigma: float, height: int = HEIGHT, width: int = WIDTH) -> Map:
    return np.exp(np.random.default_rng(1).normal(0, sigma, (height, width, 3))).astype(np.float32)


def log_normals(sigmas: Sequence[float]) -> list[Map]:
    return [log_normal(sigma) for sigma in sigmas]


def lit_at(places: Sequence[tuple[Any, Any]], light: object = 1.0, ground: float = 0.0) -> list[Map]:
    """A map per place, which is a pixel or slices of rows and columns: ``light`` there, on a uniform ``ground``."""
    maps = [even(value=ground) for _ in places]
    for radiance, (y, x) in zip(maps, places, strict=True):
        radiance[y, x] = light
    return maps


def sun_in_a_sky() -> list[Map]:
    sky = np.linspace(1.5, 0.1, HEIGHT)[:, None, None] * np.array([0.4, 0.6, 1.0]) * np.ones((1, WIDTH, 1))
    sky[20:22, 37:39] = (2e5, 1.8e5, 1.5e5)
    return [sky.astype(np.float32)]


def two_suns() -> list[Map]:
    maps = []
    for ground in (0.0, 1e-12):
        for second in ((50, 100), (10, 100)):
            radiance = even(value=ground)
            radiance[10, 20], radiance[second] = 1, 1e-10
            maps.append(radiance)
    return maps


def ramps(axis: int) -> list[Map]:
    """From 1e-42 to 1e38 and back, along rows (0) or columns (1) of the map."""
    ramp = np.logspace(-42, 38, (HEIGHT, WIDTH)[axis]).astype(np.float32)
    return [
        even() * (r[:, None, None] if axis == 0 else r[None, :, None]) for r in (ramp, np.ascontiguousarray(ramp[::-1]))
    ]


def checkerboards() -> list[Map]:
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH]
    boards = [(y // size + x // size + phase) % 2 for size in (1, 2, 16) for phase in (0, 1)]
    return [np.repeat(board[..., None], 3, axis=2).astype(np.float32) for board in boards]


def subnormal() -> list[Map]:
    quanta = np.random.default_rng(2).integers(0, 2**23, (HEIGHT, WIDTH, 3))
    return [np.ldexp(quanta, -149).astype(np.float32), even(value=2.0**-149)]


def largest() -> list[Map]:
    noise = np.random.default_rng(3).uniform(0.2, 1, (HEIGHT, WIDTH, 3)) * LARGEST
    return [noise.astype(np.float32), even(value=LARGEST)]


def both_ends() -> list[Map]:
    mixed = np.where(np.random.default_rng(4).random((HEIGHT, WIDTH, 1)) < 0.5, subnormal()[0], largest()[0])
    return [mixed.astype(np.float32), *lit_at(PLACES, LARGEST, 2.0**-149)]


def huge_at_the_pole() -> list[Map]:
    radiance = even(8192, 2, 2.0**-9 * 1.37)
    radiance[0, 0] = 2.0**127
    return [radiance]


def of_shapes(*shapes: tuple[int, int]) -> list[Map]:
    return [log_normal(2, *shape) for shape in shapes]


def one_channel() -> list[Map]:
    return [log_normal(2) * np.eye(3, dtype=np.float32)[c] for c in range(3)]


def primaries() -> list[Map]:
    choice = np.random.default_rng(5).integers(0, 3, (HEIGHT, WIDTH))
    return [np.eye(3, dtype=np.float32)[choice] * log_normal(2), np.eye(3, dtype=np.float32)[choice] * 1e20]


# ---- checks other than maps ----


def ends(maps: Maps, device: Device, _: int) -> Iterator[Figures]:
    """Points at 0, just below 1, and at and next to each step of each CDF, against integer arithmetic."""
    for radiance in maps():
        distribution = build_distribution(device, EnvironmentMap(radiance))
        rows = memory.download(device, distribution.cdf.rows)
        marginal = memory.download(device, distribution.cdf.marginal)
        table = memory.download(device, distribution.cdf.strips).astype(np.int64)
        first, strips = table[:, 0], table[:, 3]
        size = np.diff(first, append=2**32)
        borders = strip_borders(distribution.envmap.width)
        cdfs = [rows[:, begin:end] for begin, end in pairwise(borders)]

        points = []
        for entry in np.flatnonzero(size):
            down = _telling(marginal[strips[entry]])
            points.append(np.stack(np.meshgrid(_next_to(first[entry : entry + 1]), down), axis=-1).reshape(-1, 2))
            for y in np.flatnonzero(np.diff(marginal[strips[entry]], prepend=0)):
                edges = first[entry] - (-_edges(cdfs[strips[entry]][y]) * size[entry] >> 32)
                across = _next_to(edges)
                points.append(np.stack([across, np.full_like(across, _edges(marginal[strips[entry]])[y] - 1)], axis=1))
        u = np.concatenate(points)
        samples = distribution.sample_at(u / 2.0**32)

        expected = []
        for across, down in u.tolist():
            entry = np.searchsorted(first, across, side="right") - 1
            strip = strips[entry]
            y = np.searchsorted(marginal[strip], down * int(marginal[strip, -1]) >> 32, side="right")
            rest = (across - int(first[entry])) * (2**64 // int(size[entry])) >> 32
            cdf = cdfs[strip][y]
            expected.append((borders[strip] + np.searchsorted(cdf, rest * int(cdf[-1]) >> 32, side="right"), y))
        x, y = np.array(expected).T
        p = reference.probability(radiance)[y, x]
        yield {
            "wrong": float(np.count_nonzero((samples.pixel != expected).any(axis=1))),
            "zero": float(np.count_nonzero(~samples.radiance.any(axis=1))),
            "p": float(np.abs(samples.probability / p - 1).max()),
            "nonfinite": float(np.count_nonzero(~np.isfinite(samples.probability))),
        }


def _edges(cdf: np.ndarray) -> np.ndarray:
    """The first points, fractions of 2^32, above each step of a CDF; 2^32 for the last."""
    total = int(cdf[-1])
    return np.array([-(-(int(c) << 32) // total) for c in cdf])


def _telling(cdf: np.ndarray) -> np.ndarray:
    return _next_to(_edges(cdf))


def _next_to(edges: np.ndarray) -> np.ndarray:
    """These points and their neighbours, and points at both ends and in the middle."""
    u = np.concatenate([[0, 2**31, 2**32 - 2**8, 2**32 - 1], edges - 1, edges, edges + 1])
    return np.unique(u[(u >= 0) & (u < 2**32)])


def black(device: Device, _: int) -> Iterator[Figures]:
    """Sampling reports that there is no light, and every image is black."""
    envmap = EnvironmentMap(even(value=0))
    distribution = build_distribution(device, envmap)
    images = [exact(device, envmap, R), *(next(render(distribution, [1], R, estimator=e))[1] for e in ESTIMATORS)]
    yield {"wrong": float(sum(np.count_nonzero(image) for image in images)) + _not_refused(distribution.sample, 1)}


def impossible(device: Device, _: int) -> Iterator[Figures]:
    """Luminance 0 with a colour needs a negative channel, which is refused like NaN and infinity."""
    for bad in ((1, -1, 0), (np.nan, 0, 0), (0, np.inf, 0)):
        yield {"wrong": _not_refused(EnvironmentMap, lit_at(PLACES[:1], bad, 1.0)[0])}


def _not_refused(call: Callable[..., object], *arguments: object) -> float:
    try:
        call(*arguments)
    except LightdomeError:
        return 0.0
    return 1.0


def albedos(device: Device, _: int) -> Iterator[Figures]:
    radiance = log_normal(4)
    for albedo in (0.0, 1.0, 1.5, 1e6):
        image = exact(device, EnvironmentMap(radiance), R, albedo)
        yield image_figures(image, partial(reference.exact, radiance, albedo=albedo))


def resolutions(device: Device, _: int) -> Iterator[Figures]:
    radiance = log_normal(4)
    distribution = build_distribution(device, EnvironmentMap(radiance))
    for resolution in (1, 2, 3):
        yield image_figures(exact(device, distribution.envmap, resolution), partial(reference.exact, radiance))
        for estimator in ESTIMATORS:
            ((_, image),) = render(distribution, [4], resolution, estimator=estimator)
            yield {"nonfinite": float(np.count_nonzero(~np.isfinite(image)))}


def large_image(device: Device, _: int) -> Iterator[Figures]:
    direction = np.random.default_rng(6).normal(size=(4, 3))
    yield from lights(direction / np.linalg.norm(direction, axis=1, keepdims=True), 4096)(device, 0)


def lights(direction: object, resolution: int = R) -> Callable[[Device, int], Iterator[Figures]]:
    """The sphere under given directions, compared with the cosine; no pixel may be below 0."""
    w = np.atleast_2d(np.asarray(direction, np.float64))
    w = w.astype(np.float32).astype(np.float64)
    flux = np.pi * np.linspace(1, 2, 3 * len(w)).reshape(-1, 3)

    def check(device: Device, _: int) -> Iterator[Figures]:
        for brute_force in (False, True):
            image = shade(device, w, flux, resolution, brute_force=brute_force)
            figures = image_figures(image, lambda normals: np.maximum(normals @ w.T, 0) @ flux / np.pi)
            figures["wrong"] += np.count_nonzero(image < 0)
            yield figures

    return check


def behind(device: Device, _: int) -> Iterator[Figures]:
    """Light from exactly behind reaches no pixel."""
    image = shade(device, np.array([[0, 0, -1]]), np.ones((1, 3)), R)
    yield {"wrong": float(np.count_nonzero(image)), "nonfinite": float(np.count_nonzero(~np.isfinite(image)))}


def one_sample(device: Device, _: int) -> Iterator[Figures]:
    distribution = build_distribution(device, EnvironmentMap(log_normal(4)))
    for seed in range(50):
        samples = distribution.sample(1, seed)
        density = reference.probability(distribution.envmap.radiance)[samples.pixel[0, 1], samples.pixel[0, 0]]
        density /= reference.pixel_solid_angles(HEIGHT, WIDTH)[samples.pixel[0, 1], 0]
        truth = partial(
            reference.shade, direction=samples.direction, radiance=samples.radiance, density=np.array([density])
        )
        yield image_figures(shade_samples(device, samples, R), truth)


def furnace(device: Device, _: int) -> Iterator[Figures]:
    """Uniform light: `bsdf` and exact areas give the map's colour, exact centres do so up to (pi / H)^2 / 8."""
    colour = np.array([0.2, 0.5, 0.9], np.float32)
    for height in (64, 256):
        radiance = even(height, 2 * height) * colour
        distribution = build_distribution(device, EnvironmentMap(radiance))
        image = exact(device, distribution.envmap, R)
        yield image_figures(image, partial(reference.exact, radiance))
        off = np.abs(image[disc_mask(R)] / colour - 1).max()
        yield {"wrong": float(off > (np.pi / height) ** 2 / 8 + 1e-6)}
        ((_, sampled),) = render(distribution, [64], R, estimator="bsdf")
        for image in (sampled, exact(device, distribution.envmap, R, pixels="areas")):
            yield image_figures(image, lambda normals: np.ones_like(normals) * colour.astype(np.float64))


def areas(device: Device, _: int) -> Iterator[Figures]:
    """The map's pixels as areas, where centres are far off or light is concentrated, against quadrature."""
    lamps = np.eye(128, dtype=np.float32)[::18].reshape(-1, 8, 16, 1).repeat(3, axis=3)
    sun = np.full((16, 32, 3), 1e-12, np.float32)
    sun[5, 23] = 1
    for radiance in (*lamps, sun, *of_shapes((1, 1), (1, 40), (3, 5), (40, 1))):
        image = exact(device, EnvironmentMap(radiance), 11, pixels="areas")
        yield image_figures(image, partial(reference.exact_areas, radiance))


def estimators(maps: Maps, device: Device, _: int) -> Iterator[Figures]:
    """All methods on hard maps: finite, and not negative; `product` above -0.1 of the maximum, harmonics anywhere."""
    for radiance in maps():
        distribution = build_distribution(device, EnvironmentMap(radiance))
        cut = median_cut(distribution, 16)
        images = {e: next(render(distribution, [16], R, estimator=e))[1] for e in ESTIMATORS}
        images["cut"] = shade(device, cut.direction, cut.flux, R)
        images["harmonics"] = shade_harmonics(device, project(device, distribution.envmap, 8), R)
        for method, image in images.items():
            least = {"product": -0.1 * float(image.max()), "harmonics": -np.inf}.get(method, 0.0)
            negative = np.count_nonzero(image < least)
            yield {"wrong": float(negative), "nonfinite": float(np.count_nonzero(~np.isfinite(image)))}


def one_sun(device: Device, _: int) -> Iterator[Figures]:
    """One sun outshines all else: one sample of `light` or `product` gives the image, as does a median-cut light."""
    for radiance in lit_at([(20, 40), (40, 90), (32, 100)], 1e20, 1.0):
        distribution = build_distribution(device, EnvironmentMap(radiance))
        cut = median_cut(distribution, 1)
        images = [shade(device, cut.direction, cut.flux, R)]
        images += [next(render(distribution, [16], R, estimator=e))[1] for e in ("light", "product")]
        for image in images:
            yield image_figures(image, partial(reference.exact, radiance))


RIGHT_ANGLE = np.pi / 2


def angles_near(n_i: float, n_t: float) -> np.ndarray:
    """Angles everywhere, and ever closer (1e-12 and less) to 0, 90 degrees, Brewster's and the critical angle."""
    close = np.r_[0, 10.0 ** np.arange(-16, -2)]
    special = [a for a in (brewster_angle(n_i, n_t), critical_angle(n_i, n_t)) if a is not None]
    near = [close, RIGHT_ANGLE - close, *(a * (1 + sign * close) for a in special for sign in (-1, 1))]
    theta = np.unique(np.concatenate([np.linspace(0, RIGHT_ANGLE, 10), *near]))
    return theta[(theta >= 0) & (theta < RIGHT_ANGLE)]


def reflectance(*etas: float) -> Callable[[Device, int], Iterator[Figures]]:
    """R_p and R_s entering and leaving media of ``etas``, against the textbook formulas in 60 digits; R in [0, 1]."""

    def check(_: Device, __: int) -> Iterator[Figures]:
        for n_i, n_t in [pair for eta in etas for pair in ((1.0, eta), (eta, 1.0))]:
            theta = angles_near(n_i, n_t)
            values = np.stack(fresnel(theta, n_i, n_t), axis=1)
            error = 0.0
            for angle, computed in zip(theta, values, strict=True):
                slack = 2 * np.spacing(angle)
                around = [
                    [float(r) for r in reference.fresnel(max(a, 0.0), n_i, n_t)]
                    for a in (angle - slack, angle, angle + slack)
                ]
                low, high = np.min(around, axis=0), np.max(around, axis=0)
                if abs(angle - (brewster_angle(n_i, n_t) or np.inf)) <= 2 * slack:
                    low[0] = 0.0  # the zero of R_p lies in between
                # Near zeros (Brewster's angle, equal indices) errors are absolute: cancellation eats the 60 digits.
                off = np.maximum(low - computed, computed - high) / np.maximum(high, 1e-40)
                error = max(error, float(off.max()))
            at_90 = fresnel(RIGHT_ANGLE, n_i, n_t)
            yield {
                "fresnel": error,
                "wrong": float(
                    np.count_nonzero((values < 0) | (values > 1))
                    + (tuple(map(float, at_90)) != (float(n_i != n_t),) * 2)
                ),
                "nonfinite": float(np.count_nonzero(~np.isfinite(values))),
            }

    return check


# ---- the table ----


def _maps(group: str, name: str, maps: Maps, large: bool = False, needs: int = 0) -> Case:
    def check(device: Device, draws: int) -> Iterator[Figures]:
        parts = maps()
        return (measure_map(device, radiance, -(-draws // len(parts))) for radiance in parts)

    return Case(name, group, check, maps, large, needs)


def _constant(height: int) -> Case:
    maps = partial(lambda height: [even(height, 2 * height, 0.1)], height)
    return _maps("shapes", f"{2 * height} x {height}, even", maps, large=True, needs=24 * height**2)


def _hard() -> list[Map]:
    return [*largest(), *subnormal(), *ramps(0), *ramps(1), *lit_at(PLACES, 1e20, 1.0), *lit_at(PLACES), log_normal(8)]


CASES: list[Case] = [
    *(
        _maps("bright pixel", f"a pixel {ratio} times brighter, 9 places", partial(lit_at, PLACES, float(ratio), 1.0))
        for ratio in ("1e4", "1e8", "1e12", "1e20")
    ),
    _maps("bright pixel", "the sun in a sky", sun_in_a_sky),
    _maps("bright pixel", "two suns, 1e10 apart in strength", two_suns),
    _maps("ramps", "80 orders of magnitude, column to column", partial(ramps, 1)),
    _maps("ramps", "80 orders of magnitude, row to row", partial(ramps, 0)),
    *(_maps("ramps", f"log-normal noise, sigma {sigma}", partial(log_normals, [sigma])) for sigma in (1, 2, 4, 6, 8)),
    _maps("zeros", "a single lit pixel, 9 places", partial(lit_at, PLACES)),
    _maps("zeros", "all zero but the last pixel, 1e-30", partial(lit_at, [(-1, -1)], 1e-30)),
    _maps("zeros", "a single lit row", partial(lit_at, [(y, slice(None)) for y in (0, 31, 63)])),
    _maps("zeros", "a single lit column", partial(lit_at, [(slice(None), x) for x in (0, 63, 127)])),
    _maps("zeros", "zero rows between lit ones", lambda: lit_at([(slice(i, None, n), slice(None)) for i, n in
                                                                 ((0, 2), (1, 2), (5, 16))])),
    _maps("zeros", "checkerboards", checkerboards),
    Case("everything zero", "zeros", black),
    _maps("ends of float32", "subnormal pixels", subnormal),
    _maps("ends of float32", "pixels near the maximum", largest),
    _maps("ends of float32", "both in one map", both_ends),
    _maps("ends of float32", "the maximum at the pole of 8192 rows", huge_at_the_pole),
    _maps("shapes", "1 x 1, 1 x W, H x 1", lambda: of_shapes((1, 1), (1, 2), (1, 40), (1, 1000), (2, 1), (1000, 1))),
    _maps("shapes", "odd sizes", lambda: of_shapes((3, 5), (7, 13), (21, 43), (61, 127))),
    _maps("shapes", "next to a vector of 16", lambda: of_shapes((15, 31), (16, 32), (17, 33), (33, 47), (31, 49))),
    _maps("shapes", "next to a block", lambda: of_shapes((127, 255), (128, 256), (129, 257), (9, 1023), (9, 1025))),
    _maps("shapes", "not 2:1", lambda: of_shapes((64, 64), (128, 64), (10, 300), (300, 10))),
    _maps("shapes", "4096 x 2048, log-normal", lambda: of_shapes((2048, 4096)), large=True),
    _constant(8192),
    _constant(16384),
    _maps("colour", "one channel only", one_channel),
    _maps("colour", "saturated primaries", primaries),
    Case("luminance zero with a colour, NaN, infinity", "colour", impossible),
    *(
        Case(name, "random numbers", partial(ends, maps))
        for name, maps in {
            "edges of CDFs: log-normal, sigma 8": lambda: [log_normal(8, 21, 43)],
            "edges of CDFs: a pixel 1e12 times brighter": lambda: lit_at(PLACES[4:6], 1e12, 1.0),
            "edges of CDFs: checkerboard, lit pixels": lambda: [checkerboards()[1], *lit_at(PLACES)],
            "edges of CDFs: 80 orders of magnitude": lambda: [*ramps(0), *ramps(1)],
        }.items()
    ),
    Case("albedo 0, 1, 1.5, 1e6", "rendering", albedos),
    Case("resolution 1, 2, 3", "rendering", resolutions),
    Case("resolution 4096", "rendering", large_image, large=True),
    Case("one sample", "rendering", one_sample),
    Case("light exactly behind", "rendering", behind),
    Case("light exactly at the rim", "rendering", lights([[1, 0, 0], [0, -1, 0], [0.6, 0.8, 0]])),
    Case("white furnace", "rendering", furnace),
    Case("the map's pixels as areas", "rendering", areas),
    Case("every estimator on the maps above", "rendering", partial(estimators, _hard)),
    Case("one sun of 1e20: samples are the image", "rendering", one_sun),
    Case("eta 1 - 1e-7, 1, 1 + 1e-7", "Fresnel", reflectance(1 - 1e-7, 1.0, 1 + 1e-7)),
    Case("eta 1.4, 2.4, 10", "Fresnel", reflectance(1.4, 2.4, 10.0)),
    Case("eta 1e3, 1e6", "Fresnel", reflectance(1e3, 1e6)),
]  # fmt: skip
