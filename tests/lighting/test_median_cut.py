"""Median cut: the regions partition the map, hold equal energy, and their lights hold all of its flux."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import stiff_radiance
from lightdome import reference
from lightdome.errors import LightdomeError
from lightdome.lighting.exact import exact
from lightdome.lighting.median_cut import median_cut, regions
from lightdome.lighting.shade import shade
from lightdome.maps.envmap import EnvironmentMap
from lightdome.opencl.device import Device
from lightdome.sampling.distribution import build_distribution


def energy(radiance: np.ndarray) -> np.ndarray:
    """Each pixel's share of the map's energy, (H, W) float64."""
    return reference.probability(radiance)


def cover(found: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    covered = np.zeros(shape[:2], int)
    for x0, y0, x1, y1 in found:
        covered[y0:y1, x0:x1] += 1
    return covered


def sums(found: np.ndarray, values: np.ndarray) -> np.ndarray:
    return np.array([values[y0:y1, x0:x1].sum(axis=(0, 1)) for x0, y0, x1, y1 in found])


def smooth_radiance(height: int, width: int) -> np.ndarray:
    """Soft light from everywhere, three times as bright on one side."""
    direction = reference.directions(height, width)
    return (2 + direction @ np.array([[0.5, 0.1, 0.3], [0.3, 0.9, 0.2], [0.6, 0.1, 0.9]])).astype(np.float32)


@pytest.mark.parametrize("shape", [(21, 43), (1, 1), (1, 7), (9, 1), (2, 2), (64, 128), (16, 16)])
@pytest.mark.parametrize("count", [1, 2, 3, 17, 64, 500])
def test_regions_cover_the_map_once_and_none_is_black(device: Device, shape: tuple[int, int], count: int) -> None:
    radiance = stiff_radiance(*shape)
    radiance[0, 0] = 1
    found = regions(build_distribution(device, EnvironmentMap(radiance)), count)
    lit = radiance.any(axis=2)
    assert len(found) == min(count, lit.sum())
    assert (cover(found, radiance.shape) == 1).all()
    assert (sums(found, lit) > 0).all()


@pytest.mark.parametrize("count", [2, 3, 8, 37, 64, 100])
def test_regions_hold_equal_energy(device: Device, count: int) -> None:
    radiance = smooth_radiance(256, 512)
    p = energy(radiance)
    found = regions(build_distribution(device, EnvironmentMap(radiance)), count)
    share = sums(found, p) * count
    # A cut misses its target by half a row or column, up to pi / 256 of the width of the smallest regions.
    np.testing.assert_allclose(share, 1, atol=0.005 + 0.0015 * count)
    assert np.std(share) < 0.002 + 0.0005 * count


def cut_in_float64(radiance: np.ndarray, count: int) -> list[tuple[int, int, int, int]]:
    """The regions by definition: recursive, slow, and from sums over pixels alone."""
    height, width = radiance.shape[:2]
    p = energy(radiance)
    low, high = 0.0, 1 / count
    for _ in range(200):  # the cap is 1/N of what remains under it
        cap = (low + high) / 2
        low, high = (cap, high) if np.minimum(p, cap).sum() > count * cap else (low, cap)
    p = np.minimum(p, high)
    edge = np.pi * np.arange(height + 1) / height

    def cut(x0: int, y0: int, x1: int, y1: int, n: int) -> list[tuple[int, int, int, int]]:
        if n == 1:
            return [(x0, y0, x1, y1)]
        inside = p[y0:y1, x0:x1]
        nearest = np.pi / 2 if y0 < height / 2 < y1 else edge[y0] if y0 >= height / 2 else edge[y1]
        along_row = (x1 - x0) * 2 * np.pi / width * np.sin(nearest)
        first_axis = 0 if along_row >= (y1 - y0) * np.pi / height - 1e-9 else 1
        for axis in (first_axis, 1 - first_axis):
            before = np.cumsum(inside.sum(axis=axis))[:-1]
            allowed = (before > 0) & (before < before[-1:] + inside.sum(axis=axis)[-1])
            if allowed.any():
                break
        off = np.abs(before - inside.sum() * (n // 2) / n)
        k = int(np.argmin(np.where(allowed, off, np.inf))) + 1
        a = (x0, y0, x0 + k, y1) if axis == 0 else (x0, y0, x1, y0 + k)
        b = (x0 + k, y0, x1, y1) if axis == 0 else (x0, y0 + k, x1, y1)
        lit = [int((p[r[1] : r[3], r[0] : r[2]] > 0).sum()) for r in (a, b)]
        share = round(n * p[a[1] : a[3], a[0] : a[2]].sum() / inside.sum())
        share = min(max(share, 1, n - lit[1]), lit[0], n - 1)
        return cut(*a, share) + cut(*b, n - share)

    return cut(0, 0, width, height, count)


@pytest.mark.parametrize("count", [2, 4, 19, 64, 100])
@pytest.mark.parametrize("kind", ["smooth", "stiff", "mirrored"])
def test_regions_are_those_of_the_definition(device: Device, kind: str, count: int) -> None:
    radiance = smooth_radiance(64, 128) if kind == "smooth" else stiff_radiance(41, 83)
    radiance = radiance[::-1, ::-1] if kind == "mirrored" else radiance
    if kind == "smooth":
        radiance *= np.random.default_rng(2).uniform(0.9, 1.1, (64, 128, 1)).astype(np.float32)  # no ties
    found = regions(build_distribution(device, EnvironmentMap(radiance)), count)
    np.testing.assert_array_equal(found, cut_in_float64(radiance, count))


@pytest.mark.parametrize("at", [(13, 40), (0, 0), (31, 63)])
def test_one_bright_pixel_is_cut_out_and_spoils_no_other_cut(device: Device, at: tuple[int, int]) -> None:
    radiance = smooth_radiance(32, 64)
    radiance[at] = 1e12
    found = regions(build_distribution(device, EnvironmentMap(radiance)), 65)
    assert (cover(found, radiance.shape) == 1).all()
    p = radiance.astype(np.float64).sum(axis=2) * reference.pixel_solid_angles(32, 64)
    p[at] = 0
    rest = p.sum() / 64
    y, x = at
    holder = (found[:, 0] <= x) & (x < found[:, 2]) & (found[:, 1] <= y) & (y < found[:, 3])
    shares = sums(found, p) / rest
    assert shares[~holder].max() < 2
    assert shares[~holder].min() > 0.4
    assert shares[holder].max() < 1.2


def test_a_stiff_map_is_cut_where_exact_arithmetic_cuts_it(device: Device) -> None:
    # To the left of a pixel 1e12 times as bright, the cuts divide energies that float32 cannot add to that pixel's.
    radiance = np.zeros((1, 64, 3), np.float32)
    radiance[0, :, 0] = 1e-12
    radiance[0, 20] = 1
    radiance[0, 41:] = 0
    found = regions(build_distribution(device, EnvironmentMap(radiance)), 41)
    np.testing.assert_array_equal(found[:, 0], np.arange(41))  # each lit pixel its own region, in order
    found = regions(build_distribution(device, EnvironmentMap(radiance)), 5)
    # The bright pixel counts as one share of five, so two regions of ten lie on either side.
    np.testing.assert_array_equal(found[:, [0, 2]], [[0, 10], [10, 20], [20, 21], [21, 31], [31, 64]])


@pytest.mark.parametrize("count", [1, 7, 64])
def test_lights_hold_the_flux_and_the_centroid_of_their_regions(device: Device, count: int) -> None:
    radiance = stiff_radiance(21, 43)
    distribution = build_distribution(device, EnvironmentMap(radiance))
    lights, found = median_cut(distribution, count), regions(distribution, count)
    flux = radiance * reference.pixel_solid_angles(21, 43)[..., None]
    np.testing.assert_allclose(lights.flux, sums(found, flux), rtol=1e-6)
    np.testing.assert_allclose(lights.flux.sum(axis=0), flux.sum(axis=(0, 1)), rtol=1e-6)
    moment = sums(found, reference.directions(21, 43) * flux.sum(axis=2, keepdims=True))
    moment /= np.linalg.norm(moment, axis=1, keepdims=True)
    np.testing.assert_allclose(lights.direction, moment, atol=2e-6)


@pytest.mark.parametrize("power", [-120, 100])
def test_scaling_the_map_scales_the_lights_and_moves_no_cut(device: Device, power: int) -> None:
    radiance = np.maximum(smooth_radiance(20, 40), 1e-3)
    plain = build_distribution(device, EnvironmentMap(radiance))
    scaled = build_distribution(device, EnvironmentMap(np.ldexp(radiance, power)))
    np.testing.assert_array_equal(regions(plain, 50), regions(scaled, 50))
    np.testing.assert_allclose(median_cut(plain, 50).flux, np.ldexp(median_cut(scaled, 50).flux, -power), rtol=1e-6)


def test_as_many_lights_as_lit_pixels_are_the_map(device: Device) -> None:
    envmap = EnvironmentMap(stiff_radiance(9, 18))
    lights = median_cut(build_distribution(device, envmap), 10**6)
    assert len(lights) == envmap.radiance.any(axis=2).sum()
    image = shade(device, lights.direction, lights.flux, 31)
    np.testing.assert_allclose(image, exact(device, envmap, 31), rtol=1e-5, atol=1e-6 * image.max())


def test_lights_converge_to_the_exact_image_faster_than_samples(device: Device) -> None:
    envmap = EnvironmentMap(stiff_radiance(64, 128))
    target = exact(device, envmap, 32)
    distribution = build_distribution(device, envmap)
    errors = []
    for count in (16, 64, 256, 1024):
        lights = median_cut(distribution, count)
        errors.append(reference.relative_rmse(shade(device, lights.direction, lights.flux, 32), target))
    assert errors[0] < 0.15
    # Independent samples halve their error with each step; lights reduce it at least 2.5 times on average.
    assert errors[0] / errors[-1] > 2.5**3
    assert errors[-1] < 0.002


def test_light_from_all_sides_has_no_centroid_but_a_direction(device: Device) -> None:
    lights = median_cut(build_distribution(device, EnvironmentMap(np.ones((8, 16, 3)))), 1)
    np.testing.assert_allclose(np.linalg.norm(lights.direction, axis=1), 1, rtol=1e-6)
    np.testing.assert_allclose(lights.flux, 4 * np.pi, rtol=1e-6)


def test_a_black_map_is_refused_in_words(device: Device) -> None:
    with pytest.raises(LightdomeError, match="black"):
        median_cut(build_distribution(device, EnvironmentMap(np.zeros((4, 8, 3)))), 4)


@pytest.mark.parametrize("count", [0, -1, 2**22 + 1])
def test_other_counts_are_refused(device: Device, stiff: EnvironmentMap, count: int) -> None:
    with pytest.raises(LightdomeError, match="lights"):
        median_cut(build_distribution(device, stiff), count)


def test_errors_on_grace(device: Device, grace: EnvironmentMap) -> None:
    distribution = build_distribution(device, grace)
    target = exact(device, grace, 127)
    for count, known in ((16, 0.040), (64, 0.0070), (256, 0.0014), (1024, 0.00038)):
        lights = median_cut(distribution, count)
        error = reference.relative_rmse(shade(device, lights.direction, lights.flux, 127), target)
        assert error == pytest.approx(known, rel=0.1)


@pytest.mark.parametrize("step", [1, -1])
def test_a_pixel_far_below_the_total_is_still_lit(device: Device, step: int) -> None:
    # Each pixel is 2^-5 of its neighbour, before or after it, down to 2^-60 of the total. Some lie in whole vectors.
    radiance = np.zeros((1, 25, 3), np.float32)
    radiance[0, ::2] = np.ldexp(1.0, -5 * np.arange(13))[::step, None]
    for scale in (1, 2.0**-60, 2.0**50):
        found = regions(build_distribution(device, EnvironmentMap(radiance * np.float32(scale))), 13)
        assert (sums(found, radiance[..., 0] > 0) == 1).all()
        assert len(found) == 13


def test_beside_a_sun_a_region_keeps_the_flux_of_its_other_pixels(device: Device) -> None:
    radiance = np.full((3, 6000, 3), 1e-3, np.float32)
    radiance[1, 5] = 3e3
    lights = median_cut(build_distribution(device, EnvironmentMap(radiance)), 1)
    expected = radiance * reference.pixel_solid_angles(3, 6000)[..., None]
    np.testing.assert_allclose(lights.flux[0], expected.sum(axis=(0, 1)), rtol=1e-7)
