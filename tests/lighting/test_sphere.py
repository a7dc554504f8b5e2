"""The sphere under directional lights meets the float64 sum, pixel by pixel."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import stiff_radiance
from lightdome import reference
from lightdome.disc import disc_mask, disc_tiles
from lightdome.errors import LightdomeError
from lightdome.lighting.exact import PIXELS, exact
from lightdome.lighting.harmonics import project
from lightdome.lighting.horizon import horizon_tables
from lightdome.lighting.lights import Lights
from lightdome.lighting.shade import SAMPLES_PER_ROW, shade, shade_samples
from lightdome.maps.envmap import EnvironmentMap
from lightdome.opencl.device import Device
from lightdome.sampling.distribution import build_distribution

RESOLUTIONS = [1, 2, 3, 10, 63, 64, 101]
TRUTH = {"centres": reference.exact, "areas": reference.exact_areas}


def inside(resolution: int) -> np.ndarray:
    return ~np.isnan(reference.normals(resolution)[..., 0])


@pytest.mark.parametrize("resolution", RESOLUTIONS)
@pytest.mark.parametrize(("pixels", "rows"), [(1, 1), (16, 1), (16, 4)])
def test_tiles_cover_the_disc_once(resolution: int, pixels: int, rows: int) -> None:
    covered = np.zeros((resolution + rows, resolution + pixels), int)
    for x, y in disc_tiles(resolution, pixels, rows):
        covered[y : y + rows, x : x + pixels] += 1
    np.testing.assert_array_equal(disc_mask(resolution), inside(resolution))
    assert (covered[:resolution, :resolution][disc_mask(resolution)] == 1).all()
    assert covered.max() == 1
    if pixels == rows == 1:
        assert covered.sum() == disc_mask(resolution).sum()  # nothing outside costs anything


@pytest.mark.parametrize("resolution", RESOLUTIONS)
@pytest.mark.parametrize("count", [1, 127, 300])
def test_shared_samples_meet_the_float64_sum(
    device: Device, stiff: EnvironmentMap, resolution: int, count: int
) -> None:
    samples = build_distribution(device, stiff).sample(count, seed=0)
    image = shade_samples(device, samples, resolution, albedo=0.7)
    mask = inside(resolution)
    expected = reference.shade(
        reference.normals(resolution)[mask], samples.direction, samples.radiance, samples.density, 0.7
    )
    assert np.abs(image[mask] - expected).max() < 2e-6 * expected.max()
    assert not image[~mask].any()


@pytest.mark.parametrize("resolution", [1, 16, 33, 200])
@pytest.mark.parametrize("count", [1, 15, 16, 17, 3000])
def test_skipping_pairs_changes_nothing(device: Device, stiff: EnvironmentMap, resolution: int, count: int) -> None:
    samples = build_distribution(device, stiff).sample(count, seed=2, sequence="sobol")
    image = shade(device, samples.direction, samples.flux, resolution)
    brute = shade(device, samples.direction, samples.flux, resolution, brute_force=True)
    assert np.abs(image - brute).max() <= 2e-6 * brute.max()


@pytest.mark.parametrize("brute_force", [False, True])
@pytest.mark.parametrize("count", [1, 17, 3000])
def test_grey_lights_give_the_same_image_from_one_channel(
    device: Device, stiff: EnvironmentMap, count: int, brute_force: bool
) -> None:
    samples = build_distribution(device, stiff).sample(count)
    grey, tint = np.repeat(samples.flux[:, :1], 3, axis=1), np.array([1, 1, 2], np.float32)
    images, omitted = [], []
    for flux in (grey, grey * tint):
        device.decisions.take()
        images.append(shade(device, samples.direction, flux, 50, brute_force=brute_force))
        omitted.append(not {d.what: d.used for d in device.decisions.take()}["separate channels"])
    assert omitted == [True, False]
    np.testing.assert_array_equal(images[0] * tint, images[1])


def test_lights_are_their_directions_and_fluxes(device: Device, stiff: EnvironmentMap) -> None:
    samples = build_distribution(device, stiff).sample(17)
    expected = shade(device, samples.direction, samples.flux, 20)
    for lights in (samples, Lights.of(samples)):
        np.testing.assert_array_equal(shade(device, lights, resolution=20), expected)
    for wrong in (samples.direction, None):
        with pytest.raises(LightdomeError, match="expected lights, or directions and fluxes"):
            shade(device, wrong)
    for flux in (samples.flux, 255):
        with pytest.raises(LightdomeError, match=r"lights have fluxes already, got .* as in resolution=255"):
            shade(device, samples, flux)


@pytest.mark.parametrize("pixels", ["centres", "areas"])
def test_a_map_that_is_on_the_device_gives_the_same_images(
    device: Device, gpu_shaped: Device, stiff: EnvironmentMap, pixels: str
) -> None:
    for each in (device, gpu_shaped):
        of_map = build_distribution(each, stiff).map
        np.testing.assert_array_equal(exact(each, of_map, 9, pixels=pixels), exact(each, stiff, 9, pixels=pixels))
        coefficients = project(each, of_map, 3).coefficients
        np.testing.assert_array_equal(coefficients, project(each, stiff, 3).coefficients)
    elsewhere = build_distribution(gpu_shaped, stiff).map
    np.testing.assert_array_equal(exact(device, elsewhere, 9), exact(device, stiff, 9))


def test_the_exact_image_meets_the_float64_sum(device: Device) -> None:
    radiance = stiff_radiance(64, 128)
    image = exact(device, EnvironmentMap(radiance), 33)
    mask = inside(33)
    expected = reference.exact(radiance, reference.normals(33)[mask])
    np.testing.assert_allclose(image[mask], expected, rtol=2e-6)


WIDE = pytest.param((5, 600), marks=pytest.mark.slow)


@pytest.mark.parametrize("resolution", [1, 2, 17, 40])
@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (7, 1), (2, 2), (3, 5), (9, 20), (21, 43), WIDE])
def test_the_exact_image_of_areas_meets_quadrature(device: Device, shape: tuple[int, int], resolution: int) -> None:
    radiance = np.exp(np.random.default_rng(3).normal(0, 2, (*shape, 3))).astype(np.float32)
    image = exact(device, EnvironmentMap(radiance), resolution, 0.8, pixels="areas")
    mask = inside(resolution)
    some = slice(None, None, 1 + mask.sum() // max(5, 50 - shape[1] // 10))
    expected = reference.exact_areas(radiance, reference.normals(resolution)[mask][some], 0.8)
    assert np.abs(image[mask][some] - expected).max() < 1e-6 * image.max()
    assert not image[~mask].any()


@pytest.mark.parametrize("place", [(0, 0), (2, 3), (3, 9), (4, 4), (7, 15)])
def test_under_one_lamp_areas_meet_quadrature_where_centres_are_far_off(device: Device, place: tuple[int, int]) -> None:
    radiance = np.zeros((8, 16, 3), np.float32)
    radiance[place] = 1
    mask = inside(33)
    images = {p: exact(device, EnvironmentMap(radiance), 33, pixels=p)[mask] for p in PIXELS}
    expected = reference.exact_areas(radiance, reference.normals(33)[mask])
    peak = expected.max()
    assert np.abs(images["areas"] - expected).max() < 1e-6 * peak
    assert (images["areas"] >= 0).all()
    difference = (images["centres"] - expected) / peak
    assert np.abs(difference).max() > 0.04
    assert difference.min() < 0 < difference.max()


def test_the_two_integrals_approach_each_other_as_one_over_the_height(device: Device) -> None:
    differences = []
    for height in (8, 16, 32, 64):
        radiance = np.zeros((height, 2 * height, 3), np.float32)
        radiance[height // 4, 3 * height // 8] = 1
        centres, areas = (exact(device, EnvironmentMap(radiance), 63, pixels=p) for p in PIXELS)
        differences.append(np.abs(centres - areas).max() / areas.max())
    np.testing.assert_allclose(np.divide(differences[:-1], differences[1:]), 2, rtol=0.25)


@pytest.mark.slow
def test_areas_under_a_sun_of_one_pixel(device: Device) -> None:
    radiance = np.zeros((512, 1024, 3), np.float32)
    radiance[170, 204] = 1
    centres, areas = (exact(device, EnvironmentMap(radiance), 511, pixels=p).astype(np.float64) for p in PIXELS)
    mask = inside(511)
    assert 5e-4 < np.abs(centres - areas).max() / areas.max() < 1e-3
    edge = np.argwhere(mask & (areas[..., 0] > 0) & (areas[..., 0] < 2e-3 * areas.max()))[::200]
    rest = np.argwhere(mask)[::20011]
    for y, x in (edge.T, rest.T):
        expected = reference.exact_areas(radiance, reference.normals(511)[y, x], nodes=8)
        assert np.abs(areas[y, x] - expected).max() < 1e-6 * areas.max()


@pytest.mark.parametrize("resolution", [511, 8192, 16384])
def test_what_the_row_at_the_pole_sends_to_normals_near_the_equator(resolution: int) -> None:
    # There the horizon turns to follow a meridian within part of a column, which takes more pieces than columns.
    height, width = 64, 512
    bounds, start, polynomials = horizon_tables(resolution, height, width, 0, 1)
    x, weight = np.polynomial.legendre.leggauss(20)
    for row in (resolution // 2 - 1, resolution // 2 - 4):
        n_y = (resolution - 2 * row - 1) / resolution
        s, edge = np.sqrt(1 - n_y**2), np.pi / height
        begin = np.arccos(-n_y / (s * np.tan(edge))) - np.pi / 2
        ends = np.geomspace(begin, np.pi / 2, 60)  # azimuth from where it turns
        u = (ends[1:] + ends[:-1])[:, None] / 2 + (ends[1:] - ends[:-1])[:, None] / 2 * x + np.pi / 2
        horizon = np.arctan2(n_y, -s * np.cos(u))
        theta = horizon[..., None] * (1 + x) / 2
        seen = (s * np.cos(u)[..., None] * np.sin(theta) + n_y * np.cos(theta)) * np.sin(theta)
        through = (seen * weight).sum(axis=-1) * horizon / 2
        expected = ((through * weight).sum(axis=1) * (ends[1:] - ends[:-1]) / 2).sum() / np.pi
        found = polynomials[start[row, 0] + int(bounds[row, 0, 3]), 0]
        pixel = 2 / width * edge * np.sin(edge / 2)
        assert abs(found - expected) < 1e-6 * pixel


def test_even_light_on_areas_gives_the_maps_colour(device: Device) -> None:
    colour = np.array([0.25, 0.5, 1], np.float32)
    for height, width in ((1, 1), (5, 3), (64, 128)):
        envmap = EnvironmentMap(np.full((height, width, 3), colour))
        np.testing.assert_allclose(exact(device, envmap, 63, pixels="areas")[inside(63)] / colour, 1, atol=1e-6)


@pytest.mark.parametrize("pixels", ["area", "", None])
def test_other_pixels_are_refused(device: Device, stiff: EnvironmentMap, pixels: object) -> None:
    with pytest.raises(LightdomeError, match="centres, areas"):
        exact(device, stiff, 9, pixels=pixels)


def test_no_light_is_black(device: Device) -> None:
    image = shade(device, np.zeros((0, 3)), np.zeros((0, 3)), 16)
    assert image.shape == (16, 16, 3)
    assert not image.any()


@pytest.mark.parametrize("count", [21 * SAMPLES_PER_ROW - 1, 21 * SAMPLES_PER_ROW, 40_000])
def test_samples_that_share_pixels_give_the_same_image(device: Device, stiff: EnvironmentMap, count: int) -> None:
    samples = build_distribution(device, stiff).sample(count, seed=4)
    image = shade_samples(device, samples, 33, albedo=0.6)
    brute = shade(device, samples.direction, samples.flux, 33, albedo=0.6, brute_force=True)
    assert np.abs(image - brute).max() <= 2e-6 * brute.max()


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (7, 1), (2, 2), (5, 3), (9, 20), (33, 64)])
@pytest.mark.parametrize("resolution", [1, 2, 17, 40])
def test_the_exact_image_for_any_shape(device: Device, shape: tuple[int, int], resolution: int) -> None:
    radiance = np.exp(np.random.default_rng(3).normal(0, 2, (*shape, 3))).astype(np.float32)
    image = exact(device, EnvironmentMap(radiance), resolution, albedo=0.8)
    mask = inside(resolution)
    expected = reference.exact(radiance, reference.normals(resolution)[mask], 0.8)
    # With few pixels in the map, all light may graze a normal, and then no relative error holds.
    np.testing.assert_allclose(image[mask], expected, rtol=2e-6, atol=2e-7 * expected.max(initial=0))
    assert not image[~mask].any()


@pytest.mark.parametrize("pixels", PIXELS)
def test_a_grey_map_gives_the_same_image_from_one_channel(device: Device, pixels: str) -> None:
    radiance = np.repeat(stiff_radiance(16, 33)[..., :1], 3, axis=2)
    radiance[3, 30] = 1e6
    images, omitted = [], []
    for tint in ((1, 1, 1), (1, 1, 2)):
        envmap = EnvironmentMap(radiance * np.float32(tint))
        assert envmap.is_grey == (tint == (1, 1, 1))
        device.decisions.take()
        images.append(exact(device, envmap, 20, pixels=pixels) / np.float32(tint))
        omitted.append(not {d.what: d.used for d in device.decisions.take()}["separate channels"])
    assert omitted == [True, False]
    assert np.abs(images[0] - images[1]).max() <= (0 if pixels == "centres" else 1e-6) * images[0].max()


@pytest.mark.parametrize("pixels", PIXELS)
def test_a_sun_leaves_the_shadow_its_digits(device: Device, pixels: str) -> None:
    radiance = stiff_radiance(32, 64)
    radiance[10, 50] = 1e12  # behind: phi beyond pi
    whole, mask = exact(device, EnvironmentMap(radiance), 33, pixels=pixels), inside(33)
    some = slice(None, None, 7 if pixels == "areas" else 1)
    image, expected = whole[mask][some], TRUTH[pixels](radiance, reference.normals(33)[mask][some])
    shadow = expected.max(axis=1) < 1e-6 * expected.max()
    assert 0.3 < shadow.mean() < 0.95
    np.testing.assert_allclose(image[shadow], expected[shadow], rtol=1e-4)
    np.testing.assert_allclose(image[~shadow], expected[~shadow], rtol=2e-6, atol=2e-7 * expected.max())
    assert (whole >= 0).all()


@pytest.mark.parametrize("pixels", PIXELS)
@pytest.mark.parametrize("peak", [3e38, 1e-39])
def test_the_exact_image_at_the_ends_of_the_range(device: Device, peak: float, pixels: str) -> None:
    radiance = (np.random.default_rng(0).random((16, 32, 3)) * peak).astype(np.float32)
    image, mask = exact(device, EnvironmentMap(radiance), 9, pixels=pixels), inside(9)
    expected = TRUTH[pixels](radiance, reference.normals(9)[mask])
    np.testing.assert_allclose(image[mask], expected, rtol=2e-6, atol=2.0**-149)


def test_under_a_constant_map_the_sphere_has_the_maps_colour(device: Device) -> None:
    envmap = EnvironmentMap(np.full((128, 256, 3), (0.25, 0.5, 1), np.float32))
    image = exact(device, envmap, 32)
    mask = inside(32)
    # The sum over pixels is a midpoint rule, so it is at most (pi / H)^2 from the integral.
    np.testing.assert_allclose(image[mask] / np.array([0.25, 0.5, 1]), 1, atol=6e-4)


@pytest.mark.parametrize(
    ("axis", "pixel"),
    [
        ((1, 0, 0), (50, 100)),
        ((-1, 0, 0), (50, 0)),
        ((0, 1, 0), (0, 50)),
        ((0, -1, 0), (100, 50)),
        ((0, 0, 1), (50, 50)),
    ],
)
def test_light_from_an_axis_is_brightest_where_the_axis_is(
    device: Device, axis: tuple[int, int, int], pixel: tuple[int, int]
) -> None:
    image = shade(device, np.array([axis], np.float32), np.full((1, 3), np.pi), 101)
    assert image[pixel].max() == image.max()
    assert image.max() == pytest.approx(1, abs=2e-2)


def test_light_from_behind_gives_black(device: Device) -> None:
    assert not shade(device, np.array([[0, 0, -1]], np.float32), np.ones((1, 3)), 64).any()


def test_albedo_scales_the_image(device: Device, stiff: EnvironmentMap) -> None:
    samples = build_distribution(device, stiff).sample(64)
    white = shade_samples(device, samples, 32)
    np.testing.assert_array_equal(shade_samples(device, samples, 32, albedo=0.5), white / 2)
    assert not shade_samples(device, samples, 32, albedo=0).any()


def test_samples_converge_to_the_exact_image(device: Device) -> None:
    envmap = EnvironmentMap(stiff_radiance(64, 128))
    target = exact(device, envmap, 32)
    distribution = build_distribution(device, envmap)
    errors = [
        np.mean(
            [reference.relative_rmse(shade_samples(device, distribution.sample(n, s), 32), target) for s in range(8)]
        )
        for n in (64, 1024, 16384)
    ]
    np.testing.assert_allclose(np.divide(errors[:-1], errors[1:]), 4, rtol=0.4)


def test_a_black_map_gives_black(device: Device) -> None:
    for pixels in PIXELS:
        assert not exact(device, EnvironmentMap(np.zeros((4, 8, 3))), 16, pixels=pixels).any()


@pytest.mark.parametrize("resolution", [0, -1, 16385])
def test_other_resolutions_are_refused(device: Device, resolution: int) -> None:
    with pytest.raises(LightdomeError, match="resolution"):
        shade(device, np.zeros((1, 3)), np.zeros((1, 3)), resolution)
