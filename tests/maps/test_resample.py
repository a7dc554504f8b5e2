"""The resampler keeps flux, constants, and the place of every light, from any projection to any other."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import stiff_radiance
from lightdome.errors import LightdomeError
from lightdome.maps.projections import PROJECTIONS, Projection
from lightdome.maps.resample import resample

LATLONG = PROJECTIONS["latlong"]
TURN = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
WAYS = [
    *((name, 12, "latlong", 16, None) for name in PROJECTIONS),
    *(("latlong", 16, name, 12, None) for name in PROJECTIONS),
    ("latlong", 16, "latlong", 16, TURN),
    ("latlong", 8, "latlong", 48, TURN),
    ("latlong", 48, "latlong", 8, TURN),
    ("mirror", 15, "angular", 20, -TURN),
]


def flux(image: np.ndarray, projection: str) -> np.ndarray:
    return np.tensordot(PROJECTIONS[projection].solid_angles(image.shape[:2]), image.astype(np.float64), 2)


def directions(projection: str, shape: tuple[int, int]) -> np.ndarray:
    y, x = np.indices(shape) + 0.5
    return PROJECTIONS[projection].directions(x, y, shape)


@pytest.mark.parametrize(("source", "size", "target", "target_size", "turn"), WAYS)
def test_flux_and_constants_are_kept(source, size, target, target_size, turn) -> None:
    a, b = PROJECTIONS[source], PROJECTIONS[target]
    shape, used = b.shape(target_size), b.used(b.shape(target_size))
    radiance = stiff_radiance(*a.shape(size))  # its values outside a probe's disc must not matter
    result = resample(radiance, a, b, shape, turn)
    np.testing.assert_allclose(flux(result, target), flux(radiance, source), rtol=1e-6)
    assert result.min() >= 0
    assert not result[~used].any()
    constant = np.full((*a.shape(size), 3), 0.7, np.float32) * a.used(a.shape(size))[..., None]
    np.testing.assert_allclose(resample(constant, a, b, shape, turn)[used], 0.7, rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("name", PROJECTIONS)
@pytest.mark.parametrize("to_it", [True, False])
def test_a_bright_pixel_keeps_its_energy_and_direction(name: str, to_it: bool) -> None:
    """To within half a pixel, of the larger kind; on a background, so that a factor on the whole image would show.

    At poles, seams, edges and rims, and also for a latitude-longitude map that is turned.
    """
    turn = TURN if name == "latlong" else np.eye(3)
    source, target = ("latlong", name) if to_it else (name, "latlong")
    a, b = PROJECTIONS[source], PROJECTIONS[target]
    size = {"latlong": 16, "angular": 23, "mirror": 23, "octahedral": 22}
    shape, to = (p.shape(size.get(p.name, 10)) for p in (a, b))
    used = np.argwhere(a.used(shape))
    height, width = shape
    edges = used[(used[:, 0] % (height // 2) < 2) | (used[:, 1] % (width // 2) < 2)]
    bright = edges[:: max(1, len(edges) // 8)]
    solid_angles, after, area = a.solid_angles(shape), directions(target, to), b.solid_angles(to)
    for first in range(0, len(bright), 3):  # each in a channel of its own
        three = bright[first : first + 3]
        radiance = np.ones((*shape, 3), np.float32)
        radiance[(*three.T, range(len(three)))] += 1e4
        result = resample(radiance, a, b, to, turn).astype(np.float64)
        for channel, (j, i) in zip(np.moveaxis(result, 2, 0), three, strict=False):
            assert np.median(channel[area > 0]) == pytest.approx(1, abs=1e-5)  # the rest is unchanged
            excess = (channel - 1) * area
            assert excess.sum() == pytest.approx(1e4 * solid_angles[j, i], rel=1e-5)
            mean = np.tensordot(excess, after, 2)
            y, x = (np.arange(16) + 0.5)[:, None] / 16 + j, (np.arange(16) + 0.5) / 16 + i
            before = turn @ np.tensordot(a.density(x, y, shape) + np.zeros((16, 16)), a.directions(x, y, shape), 2)
            mean, before = (vector / np.linalg.norm(vector) for vector in (mean, before))
            column, row = (int(at) for at in b.positions(before, to))
            pixel = max(longer_side(a, j, i, shape), longer_side(b, row, column, to))
            assert np.linalg.norm(mean - before) <= pixel / 2


def longer_side(projection: Projection, j: int, i: int, shape: tuple[int, int]) -> float:
    """From side to side through the middle of a pixel, across or down."""
    x, y = i + np.array([1e-6, 1 - 1e-6, 0.5, 0.5]), j + np.array([0.5, 0.5, 1e-6, 1 - 1e-6])
    left, right, top, bottom = projection.directions(x, y, shape)
    return max(np.linalg.norm(right - left), np.linalg.norm(bottom - top))


def test_an_image_that_stays_as_it_is_keeps_its_bits() -> None:
    radiance = stiff_radiance(6, 11)
    assert np.array_equal(resample(radiance, LATLONG, LATLONG, (6, 11), np.eye(3)), radiance)


def test_half_the_size_is_the_mean_by_solid_angle() -> None:
    radiance = stiff_radiance(16, 32)
    area = LATLONG.solid_angles((16, 32))[..., None]
    sums = (radiance * area).reshape(8, 2, 16, 2, 3).sum(axis=(1, 3))
    expected = sums / area.reshape(8, 2, 16, 2, 1).sum(axis=(1, 3))
    result = resample(radiance, LATLONG, LATLONG, (8, 16))
    np.testing.assert_allclose(result, expected, rtol=0.03, atol=1e-6 * expected.max())


def test_a_turned_smooth_map_is_that_map_in_turned_directions() -> None:
    light = np.array([0.36, 0.48, 0.8])
    shape = (48, 96)
    smooth = np.exp(3 * directions("latlong", shape) @ light)[..., None] * np.ones(3)
    result = resample(smooth, LATLONG, LATLONG, shape, TURN)
    expected = np.exp(3 * directions("latlong", shape) @ (TURN @ light))
    assert np.sqrt(np.mean((result[..., 0] / expected - 1) ** 2)) < 0.03  # since each source pixel is constant


@pytest.mark.parametrize(
    ("words", "change"),
    [
        ("6:1", {"target": PROJECTIONS["cube-strip-horizontal"]}),
        ("3:4", {"source": PROJECTIONS["cube-cross"]}),
        ("finite", {"radiance": np.full((4, 8, 3), np.nan)}),
        ("orthogonal", {"rotation": np.ones((3, 3))}),
        ("orthogonal", {"rotation": np.full((3, 3), np.nan)}),
        (r"\(3, 3\)", {"rotation": np.ones(3)}),
        (r"\(H, W, 3\)", {"radiance": np.ones((4, 8))}),
        ("2:1", {"radiance": np.ones((0, 8, 3))}),
    ],
)
def test_what_cannot_be_resampled_is_refused(words: str, change: dict) -> None:
    arguments = {"radiance": np.ones((4, 8, 3)), "source": LATLONG, "target": LATLONG, "shape": (4, 8)} | change
    with pytest.raises(LightdomeError, match=words):
        resample(**arguments)
