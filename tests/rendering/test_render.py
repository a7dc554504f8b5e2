"""The per-pixel renderer: every estimator is unbiased with every sequence, on any map."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from helpers import stiff_radiance, with_small_launches
from lightdome import reference
from lightdome.disc import disc_mask
from lightdome.errors import LightdomeError
from lightdome.lighting.exact import PIXELS
from lightdome.lighting.exact import exact as exact_image
from lightdome.maps.envmap import EnvironmentMap
from lightdome.names import WITHIN
from lightdome.opencl.device import Device
from lightdome.rendering.per_pixel import ESTIMATORS, SEQUENCES, render
from lightdome.rendering.product import ENTRIES, build_product_cdfs
from lightdome.sampling.distribution import Distribution, build_distribution

R = 24
CENTRES = ("light", "product")  # treat the map's pixels as directions; the others treat them as areas
assert {e for e, facts in ESTIMATORS.items() if facts.pixels == "centres"} == set(CENTRES)
ALL = [
    *({"estimator": e} for e in ESTIMATORS),
    {"estimator": "mis", "mis_compensation": True},
    *({"estimator": e, "within": "pixel"} for e in CENTRES),
]
NAMES = [*ESTIMATORS, "compensated", *(f"{e}-within" for e in CENTRES)]
SLOWER = [pytest.param(name, marks=pytest.mark.slow) for name in SEQUENCES if name != "independent"]


def exact(radiance: np.ndarray, resolution: int = R, areas: bool = False) -> np.ndarray:
    """The float64 image."""
    image = np.zeros((resolution, resolution, 3))
    mask = disc_mask(resolution)
    truth = partial(reference.exact_areas, nodes=8 if len(radiance) > 16 else 16) if areas else reference.exact
    image[mask] = truth(radiance, reference.normals(resolution)[mask])
    return image


def seen_as(options: dict[str, object]) -> str:
    """How an estimator treats the map's pixels."""
    return "areas" if options.get("within") == "pixel" else ESTIMATORS[str(options["estimator"])].pixels


def limit(radiance: np.ndarray, options: dict[str, object], resolution: int = R) -> np.ndarray:
    """What an estimator converges to."""
    return exact(radiance, resolution, areas=seen_as(options) == "areas")


@pytest.fixture(scope="module")
def distribution(device: Device) -> Distribution:
    return build_distribution(device, EnvironmentMap(stiff_radiance(32, 64)))


@pytest.fixture(scope="module")
def small(device: Device) -> Distribution:
    """Few, large and different pixels: a wrong sign, swapped axes or half a pixel change the image."""
    rng = np.random.default_rng(3)
    radiance = np.exp(rng.normal(0, 1, (7, 10, 3))).astype(np.float32)
    radiance[2, 3:5] = radiance[4] = 0
    return build_distribution(device, EnvironmentMap(radiance))


@pytest.fixture(scope="module")
def large(device: Device) -> Distribution:
    """Cells of the product hold 3 x 2 pixels of all colours: with single pixels in cells, it would have no noise."""
    rng = np.random.default_rng(3)
    radiance = np.exp(rng.normal(0, 1, (70, 300, 3))).astype(np.float32)
    radiance[rng.random((70, 300)) < 0.2] = 0
    return build_distribution(device, EnvironmentMap(radiance))


@pytest.fixture
def noisy(options: dict[str, object], small: Distribution, large: Distribution) -> Distribution:
    """A map on which the estimator has noise."""
    return large if options["estimator"] == "product" else small


@pytest.fixture(scope="module")
def target(distribution: Distribution) -> np.ndarray:
    return exact(distribution.envmap.radiance)


def one(distribution: Distribution, spp: int, resolution: int = R, **options: object) -> np.ndarray:
    ((_, image),) = render(distribution, [spp], resolution, **options)
    return image


def z_scores(images: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """How many standard errors the mean over seeds is off, for every channel of every pixel inside the disc."""
    mask = disc_mask(images.shape[1])
    error = (images.mean(axis=0, dtype=np.float64) - expected)[mask]
    return error / (images.std(axis=0, ddof=1, dtype=np.float64) / np.sqrt(len(images)))[mask]


@pytest.mark.parametrize("sequence", ["independent", *SLOWER])
@pytest.mark.parametrize("options", ALL, ids=NAMES)
def test_the_mean_over_seeds_meets_the_exact_image(
    noisy: Distribution, options: dict[str, object], sequence: str
) -> None:
    images = np.stack([one(noisy, 32, seed=seed, sequence=sequence, **options) for seed in range(100)])
    z = z_scores(images, exact_image(noisy.device, noisy.envmap, R, pixels=seen_as(options)))
    # Pixels and channels make hundreds of tests, independent except within the three channels of a pixel.
    assert abs(z.mean()) < 0.15
    assert 0.85 < z.std() < 1.15
    assert np.abs(z).max() < 6


@pytest.mark.parametrize("options", ALL, ids=NAMES)
def test_under_one_lamp_each_estimator_meets_its_own_exact_image_and_not_the_other(
    device: Device, options: dict[str, object]
) -> None:
    radiance = np.zeros((8, 16, 3), np.float32)
    radiance[2, 3] = 1  # the two integrals differ by 5 % of the maximum
    envmap = EnvironmentMap(radiance)
    distribution = build_distribution(device, envmap)
    image = one(distribution, 2**14, sequence="sobol", **options)
    off = {pixels: np.abs(image - exact_image(device, envmap, R, pixels=pixels)).max() for pixels in PIXELS}
    # Few of `bsdf`'s directions hit the lamp.
    assert off.pop(seen_as(options)) < (0.02 if options["estimator"] == "bsdf" else 0.006) * image.max()
    assert off.popitem()[1] > 0.04 * image.max()


@pytest.mark.parametrize("sequence", ["independent", *SLOWER])
@pytest.mark.parametrize(
    ("shape", "lit", "noise", "apart"), [((8, 16), (2, 3), 0.006, 0.04), ((1, 1), (0, 0), 0.06, 1)]
)
@pytest.mark.parametrize("estimator", CENTRES)
def test_within_pixels_each_meets_the_integral_over_areas_and_at_centres_it_does_not(
    device: Device,
    estimator: str,
    shape: tuple[int, int],
    lit: tuple[int, int],
    noise: float,
    apart: float,
    sequence: str,
) -> None:
    radiance = np.zeros((*shape, 3), np.float32)
    radiance[lit] = 1, 2, 3
    distribution = build_distribution(device, EnvironmentMap(radiance))
    expected = exact(radiance, areas=True)
    off = {
        within: np.abs(one(distribution, 2**14, estimator=estimator, sequence=sequence, within=within) - expected).max()
        for within in WITHIN
    }
    assert off["pixel"] < noise * expected.max()
    assert off["centre"] > apart * expected.max()


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_where_directions_lie_by_default(small: Distribution, estimator: str) -> None:
    named = {within: {"estimator": estimator, "within": within} for within in WITHIN}
    default = one(small, 4, estimator=estimator)
    np.testing.assert_array_equal(one(small, 4, **named["centre" if estimator in CENTRES else "pixel"]), default)
    if estimator in CENTRES:
        assert (one(small, 4, **named["pixel"]) != default).any()


@pytest.mark.parametrize("options", ALL, ids=NAMES)
def test_the_sum_over_many_samples_meets_the_exact_image(small: Distribution, options: dict[str, object]) -> None:
    # 2^15 Sobol points per pixel, so any remaining error is bias.
    image = one(small, 2**15, 9, sequence="sobol", **options)
    expected = limit(small.envmap.radiance, options, 9)
    assert reference.relative_rmse(image, expected) < (0.005 if options["estimator"] == "bsdf" else 0.001)


@pytest.mark.slow
@pytest.mark.parametrize(("estimator", "shape"), [("light", (32, 64)), ("product", (80, 150))])
def test_a_hard_map_is_unbiased_too(device: Device, estimator: str, shape: tuple[int, int]) -> None:
    distribution = build_distribution(device, EnvironmentMap(stiff_radiance(*shape)))
    images = np.stack([one(distribution, 16, seed=seed, estimator=estimator) for seed in range(200)])
    z = z_scores(images, exact(distribution.envmap.radiance))
    assert abs(z.mean()) < 0.15
    assert 0.8 < z.std() < 1.25
    assert np.abs(z).max() < 6


@pytest.mark.slow
@pytest.mark.parametrize("options", ALL, ids=NAMES)
def test_the_error_falls_as_one_over_the_root_of_spp(noisy: Distribution, options: dict[str, object]) -> None:
    expected = exact_image(noisy.device, noisy.envmap, R, pixels=seen_as(options))
    errors = {
        spp: np.mean([reference.relative_rmse(one(noisy, spp, seed=s, **options), expected) for s in range(6)])
        for spp in (16, 64, 256)
    }
    for spp in (16, 64):
        assert errors[spp] / errors[4 * spp] == pytest.approx(2, rel=0.2)


@pytest.mark.parametrize("sequence", ["sobol", "lattice"])
@pytest.mark.parametrize("shape", [(1, 16), (16, 1)])
def test_sixteen_consecutive_points_have_one_in_each_part_of_an_axis(
    device: Device, sequence: str, shape: tuple[int, int]
) -> None:
    # There are as many parts as equally likely pixels, so no noise is left.
    light = np.random.default_rng(5).dirichlet([1, 1, 1], shape) / np.sin(reference.angles(*shape)[0])[..., None]
    distribution = build_distribution(device, EnvironmentMap(light))
    expected = exact(distribution.envmap.radiance, R)
    for spp, image in render(distribution, [8, 16, 48, 64], R, sequence=sequence):
        assert (reference.relative_rmse(image, expected) < 1e-5) == (spp >= 16)


@pytest.mark.slow
@pytest.mark.parametrize("options", ALL, ids=NAMES)
@pytest.mark.parametrize("better", ["sobol", "lattice"])
def test_with_better_points_the_error_falls_faster(device: Device, options: dict[str, object], better: str) -> None:
    is_product = options["estimator"] == "product"
    theta, phi = reference.angles(*((200, 400) if is_product else (32, 64)))
    smooth = np.stack([2 + np.cos(theta), 2 + np.sin(theta) * np.cos(phi), 2 + np.sin(theta) * np.sin(phi)], axis=2)
    if is_product:  # all of its noise comes from within cells, so only 4 x 4 of them are lit: fewer than points
        smooth[:60] = smooth[76:] = smooth[:, :100] = smooth[:, 116:] = 0
    distribution = build_distribution(device, EnvironmentMap(smooth))
    expected = exact_image(device, distribution.envmap, R, pixels=seen_as(options))

    def error(spp: int, sequence: str) -> float:
        images = [one(distribution, spp, seed=s, sequence=sequence, **options) for s in range(3)]
        return float(np.mean([reference.relative_rmse(image, expected) for image in images]))

    assert error(16, better) / error(256, better) > 6
    assert error(256, better) < 0.4 * error(256, "independent")


@pytest.mark.slow
def test_mis_is_not_much_worse_than_the_better_of_both(device: Device, distribution: Distribution) -> None:
    def errors(distribution: Distribution) -> list[float]:
        result = []
        for options in ALL[:3]:
            expected = limit(distribution.envmap.radiance, options)
            images = [one(distribution, 64, seed=s, **options) for s in range(4)]
            result.append(float(np.mean([reference.relative_rmse(image, expected) for image in images])))
        return result

    light, bsdf, mis = errors(distribution)
    assert mis < 1.05 * light < bsdf
    light, bsdf, mis = errors(build_distribution(device, EnvironmentMap(np.ones((16, 32, 3)))))
    assert bsdf < 1e-5  # the cosine is all there is to sample
    assert mis < 0.6 * light


def test_the_product_has_less_noise_than_the_rest(distribution: Distribution, target: np.ndarray) -> None:
    targets = {"centres": target, "areas": limit(distribution.envmap.radiance, {"estimator": "mis"})}
    error = {
        e: reference.relative_rmse(one(distribution, 64, estimator=e), targets[ESTIMATORS[e].pixels])
        for e in ESTIMATORS
    }
    assert error["product"] < 0.85 * min(error[e] for e in ESTIMATORS if e != "product")  # half of mis's directions


@pytest.mark.parametrize("options", ALL, ids=NAMES)
def test_a_grey_map_gives_the_same_image_from_one_channel(device: Device, options: dict[str, object]) -> None:
    radiance = np.repeat(stiff_radiance(16, 33)[..., :1], 3, axis=2)
    grey, three = EnvironmentMap(radiance), EnvironmentMap(radiance)
    vars(three)["is_grey"] = False
    images, omitted = [], []
    for envmap in (grey, three):
        device.decisions.take()
        images.append(one(build_distribution(device, envmap), 16, **options))
        omitted.append(not {d.what: d.used for d in device.decisions.take()}["separate channels"])
    assert omitted == [True, False]
    assert np.abs(images[0] - images[1]).max() <= 1e-6 * images[1].max()


@pytest.mark.parametrize(("resolution", "lit"), [(2, 0), (64, 0.11)])
def test_pixels_that_see_no_light_are_black(device: Device, resolution: int, lit: float) -> None:
    radiance = np.zeros((16, 32, 3), np.float32)
    radiance[8, 20] = 1, 2, 3  # behind the sphere, to the left
    image = one(build_distribution(device, EnvironmentMap(radiance)), 16, resolution, estimator="product")
    expected = exact(radiance, resolution=resolution)
    assert (expected.any(axis=2).sum() / disc_mask(resolution).sum()) == pytest.approx(lit, abs=0.02)
    np.testing.assert_allclose(image, expected, rtol=1e-5, atol=1e-6)


@pytest.mark.slow
def test_cells_and_tiles_of_many_pixels_leave_nothing_out(device: Device) -> None:
    # A band of light, so that many normals see only a part of a cell. Cells are 5 x 4 pixels, tiles 4 x 4.
    radiance = np.full((100, 300, 3), 1e-6, np.float32)
    radiance[48:60] = np.random.default_rng(2).random((12, 300, 1))
    radiance[:, 90:] *= 1e-3
    distribution = build_distribution(device, EnvironmentMap(radiance))
    image, expected = one(distribution, 1024, 99, estimator="product", sequence="sobol"), exact(radiance, 99)
    mask = disc_mask(99)
    relative = image[mask] / expected[mask] - 1
    # With half the reach of cells and tiles, the first is 0.0010; with a quarter, the second is 2e-4.
    assert np.abs(relative).mean() < 0.0009
    assert abs(relative.mean()) < 1e-4


LARGE = [pytest.param(33, 65, marks=pytest.mark.slow), pytest.param(70, 129, marks=pytest.mark.slow)]


@pytest.mark.parametrize(("height", "width"), [(1, 1), (1, 7), (5, 1), (2, 2), *LARGE])
def test_any_shape_of_map(device: Device, height: int, width: int) -> None:
    rng = np.random.default_rng(height)
    radiance = rng.random((height, width, 3)).astype(np.float32)
    distribution = build_distribution(device, EnvironmentMap(radiance))
    for options in ALL:
        image = one(distribution, 4096, 9, sequence="sobol", **options)
        expected = limit(radiance, options, 9)
        assert reference.relative_rmse(image, expected) < 0.02


@pytest.mark.parametrize("pixel", [(0, 0), (0, 9), (3, 0), (3, 9), (6, 4), (6, 9)])
def test_a_single_lit_pixel_at_poles_and_edges(device: Device, pixel: tuple[int, int]) -> None:
    radiance = np.zeros((7, 10, 3), np.float32)
    radiance[pixel] = 3, 2, 1
    distribution = build_distribution(device, EnvironmentMap(radiance))
    for options in ALL:
        image = one(distribution, 4096, 9, sequence="sobol", **options)
        expected = limit(radiance, options, 9)
        assert reference.relative_rmse(image, expected) < (0.1 if options["estimator"] == "bsdf" else 0.01)
        np.testing.assert_allclose(image[..., 0], 3 * image[..., 2], rtol=1e-5, atol=1e-6 * image.max())


@pytest.mark.parametrize("exponent", [-100, 120])
@pytest.mark.parametrize("options", ALL, ids=NAMES)
def test_the_scale_of_the_map_scales_the_image(
    device: Device, small: Distribution, options: dict[str, object], exponent: int
) -> None:
    scaled = build_distribution(device, EnvironmentMap(np.ldexp(small.envmap.radiance, exponent)))
    expected = one(small, 8, **options).astype(np.float64)
    image = one(scaled, 8, **options).astype(np.float64)
    np.testing.assert_allclose(np.ldexp(image, -exponent), expected, rtol=1e-4, atol=1e-6 * expected.max())


def test_next_to_a_pixel_that_outshines_all(device: Device, small: Distribution) -> None:
    radiance = small.envmap.radiance.copy()
    radiance[1, 2] = 1e12  # towards +x +z, visible from most normals
    distribution = build_distribution(device, EnvironmentMap(radiance))
    for options in ALL:
        image = one(distribution, 256, sequence="sobol", **options)
        assert np.isfinite(image).all()
        if options["estimator"] != "bsdf":
            expected = limit(radiance, options)
            assert reference.relative_rmse(image, expected) < 0.05
    # Where the bright pixel is not visible, the product has no more noise than without it.
    expected = exact(radiance)
    dark = disc_mask(R) & (expected[..., 1] < 1e3)
    assert dark.sum() > 10
    assert np.abs(one(distribution, 256, estimator="product", sequence="sobol")[dark] / expected[dark] - 1).max() < 0.3


def test_more_samples_continue_fewer(distribution: Distribution) -> None:
    for options in ALL:
        images = dict(render(distribution, [64, 7, 7, 16], R, seed=3, **options))
        assert list(images) == [7, 16, 64]
        np.testing.assert_allclose(images[64], one(distribution, 64, seed=3, **options), rtol=1e-4, atol=1e-7)


def chance_of_correlation(a: np.ndarray, b: np.ndarray) -> float:
    """Mean of n r^2 over pixels, with r the correlation of n values (n, M): 1 by chance, less if most are equal."""
    a, b = (v - v.mean(axis=0) for v in (a, b))
    varies = (a.any(axis=0)) & (b.any(axis=0))
    a, b = a[:, varies], b[:, varies]
    return float(len(a) * ((a * b).sum(axis=0) ** 2 / ((a**2).sum(axis=0) * (b**2).sum(axis=0))).mean())


@pytest.mark.parametrize("sequence", SEQUENCES)
@pytest.mark.parametrize("options", ALL, ids=NAMES)
def test_pixels_are_independent_of_each_other_and_of_the_seed(
    device: Device, options: dict[str, object], sequence: str
) -> None:
    # Cells of several pixels, or the product would have no noise.
    radiance = np.exp(np.random.default_rng(6).normal(0, 1, (70, 131, 3))).astype(np.float32)
    distribution = build_distribution(device, EnvironmentMap(radiance))
    images = np.stack([one(distribution, 1, seed=s, sequence=sequence, **options) for s in range(65)]).sum(axis=3)
    y, x = np.nonzero(disc_mask(R)[:, 1:] & disc_mask(R)[:, :-1])
    assert chance_of_correlation(images[:, y, x], images[:, y, x + 1]) < 1.3
    assert chance_of_correlation(images[1:, y, x], images[:-1, y, x]) < 1.3


def test_outside_the_disc_is_black_and_albedo_scales(distribution: Distribution) -> None:
    for estimator in ESTIMATORS:
        image = one(distribution, 4, estimator=estimator)
        assert not image[~disc_mask(R)].any()
        np.testing.assert_allclose(one(distribution, 4, albedo=0.5, estimator=estimator), image / 2, rtol=1e-6)


def test_a_black_map_renders_black(device: Device) -> None:
    black = build_distribution(device, EnvironmentMap(np.zeros((4, 8, 3))))
    for options in ALL:
        assert not one(black, 8, **options).any()


@pytest.mark.parametrize("spp", [[], [0], [8, -1]])
def test_other_numbers_of_samples_are_refused(distribution: Distribution, spp: list[int]) -> None:
    with pytest.raises(LightdomeError, match="samples per pixel"):
        list(render(distribution, spp, R))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"estimator": "path"}, "light, bsdf, mis, product"),
        ({"sequence": "halton"}, "independent, sobol"),
        ({"mis_compensation": True}, "'mis', got 'light'"),
        ({"seed": -1}, "a seed must be"),
        ({"within": "corner"}, "place within a pixel 'corner'; expected one of centre, pixel"),
        ({"estimator": "bsdf", "within": "centre"}, "'bsdf' sees pixels as areas; expected within='pixel'"),
        ({"estimator": "mis", "within": "centre"}, "'mis' sees pixels as areas; expected within='pixel'"),
    ],
)
def test_unknown_names_are_refused(distribution: Distribution, options: dict[str, object], words: str) -> None:
    with pytest.raises(LightdomeError, match=words):
        list(render(distribution, [1], R, **options))


@pytest.mark.parametrize("sequence", SEQUENCES)
def test_the_two_samples_of_mis_are_independent(device: Device, sequence: str) -> None:
    # Two lamps, which the light's samples draw, are red. The rest is blue, and so dim that only the cosine's samples
    # see it.
    radiance = np.zeros((16, 32, 3), np.float32)
    radiance[:8, :, 2] = 1e-3
    radiance[7, 4] = radiance[9, 25] = 1e3, 0, 0  # on the camera's side and behind the sphere
    distribution = build_distribution(device, EnvironmentMap(radiance))
    images = np.stack([one(distribution, 1, seed=s, sequence=sequence, estimator="mis") for s in range(64)])
    red, blue = np.moveaxis(images[:, disc_mask(R)][..., [0, 2]], 2, 0)
    assert 0.8 < chance_of_correlation(red, blue) < 1.25


@pytest.mark.parametrize("resolution", [1, 9, 32])
def test_where_cells_and_tiles_are_single_pixels_the_product_has_no_noise(device: Device, resolution: int) -> None:
    rng = np.random.default_rng(7)
    radiance = np.exp(rng.normal(0, 2, (32, 64, 1)).astype(np.float32)).repeat(3, axis=2)
    radiance[rng.random((32, 64)) < 0.3] = 0
    envmap = EnvironmentMap(radiance)
    image = one(build_distribution(device, envmap), 1, resolution, estimator="product")
    np.testing.assert_allclose(image, exact_image(device, envmap, resolution), rtol=1e-4)


@pytest.mark.parametrize("within", WITHIN)
@pytest.mark.parametrize("at", [(9, 160), (14, 12), (20, 208)])
def test_no_sample_of_the_product_is_worth_more_than_four_others(
    device: Device, at: tuple[int, int], within: str
) -> None:
    # All normals that matter see the blue and the green lamp, which share a cell. When one of them is drawn, blue minus
    # green changes by the cell's share of one sample, since the control variate is the same for both. Tiles in which
    # the red lamp sets draw it rarely, but often enough that the weight of its samples is bounded: a cosine is at most
    # 4 C (product.clh), and so is a cosine less a control variate.
    radiance = np.zeros((32, 256, 3), np.float32)
    radiance[at] = 1e4, 0, 0
    radiance[16, 64:66] = (0, 0, 1), (0, 1, 0)
    distribution = build_distribution(device, EnvironmentMap(radiance))
    images = render(distribution, range(1, 129), 64, estimator="product", within=within)
    sums = [n * image.astype(np.float64) for n, image in images]
    drawn = np.diff(sums, axis=0, prepend=0)
    of_red = np.ptp(drawn[..., 0], axis=0)
    of_others = np.abs(drawn[..., 2] - drawn[..., 1]).max(axis=0)
    towards = reference.normals(64) @ reference.directions(32, 256)[16, 64]
    known = disc_mask(64) & (of_others > 0) & (of_red > 0.1 * of_others) & (towards > 0.3)
    assert known.sum() > 10
    assert (of_red[known] <= 4.5 * of_others[known]).all()


@pytest.mark.slow
@pytest.mark.parametrize("along", ["rows", "columns"])
@pytest.mark.parametrize(
    ("height", "width"), [(71, 200), (67, 131), (97, 127), (149, 391), (2, 193), (61, 3), (131, 1)]
)
def test_the_last_rows_and_columns_of_any_map_send_their_light(
    device: Device, height: int, width: int, along: str
) -> None:
    # The last cells of these maps have one row or column, two, or many. Each of their pixels has a colour of its own.
    radiance = np.zeros((height, width, 3), np.float32)
    lines = radiance if along == "rows" else radiance.swapaxes(0, 1)
    for line, colour in zip(lines[:-5:-1], ((9, 0, 0), (0, 8, 0), (0, 0, 7), (2, 1, 3)), strict=False):
        line[:] = colour
    envmap = EnvironmentMap(radiance)
    distribution = build_distribution(device, envmap)
    for options in ALL:
        image = one(distribution, 2**14, 9, sequence="sobol", **options)
        expected = exact_image(device, envmap, 9, pixels=seen_as(options))
        sums, truth = (a.sum(axis=(0, 1), dtype=np.float64) for a in (image, expected))
        np.testing.assert_allclose(sums, truth, rtol=0.05 if options["estimator"] == "bsdf" else 3e-4)


@pytest.mark.slow
@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_thousands_of_launches_lose_no_digits(device: Device, small: Distribution, estimator: str) -> None:
    few = build_distribution(with_small_launches(device), small.envmap)
    images = [one(each, 12000, 3, estimator=estimator) for each in (small, few)]
    np.testing.assert_allclose(images[1], images[0], rtol=1e-6)


@pytest.mark.parametrize("channel", range(3))
def test_the_product_draws_both_ends_of_a_cell_whatever_their_colour(device: Device, channel: int) -> None:
    # A cell has 6 x 6 pixels. The lamps in two of its corners set over different normals.
    radiance = np.zeros((384, 768, 3), np.float32)
    radiance[90, 6, channel] = radiance[95, 11, channel] = 1
    distribution = build_distribution(device, EnvironmentMap(radiance))
    image = one(distribution, 1000, 60, estimator="product")
    expected = exact_image(device, distribution.envmap, 60)[..., channel]
    np.testing.assert_allclose(image[..., channel], expected, rtol=0.5, atol=1e-6 * expected.max())


def coloured(is_grey: bool) -> np.ndarray:
    """A map (72, 300) of squares, each of one colour: no cell of the product, 3 x 2 pixels, has a second one."""
    rng = np.random.default_rng(8)
    squares = np.exp(rng.normal(0, 1, (9, 25, 3)))
    squares[rng.random((9, 25)) < 0.2] = 0
    squares = squares[..., [0, 0, 0]] if is_grey else squares
    light = np.exp(rng.normal(0, 0.2, (72, 300, 1)))
    return (squares.repeat(8, axis=0).repeat(12, axis=1) * light).astype(np.float32)


@pytest.mark.parametrize("within", WITHIN)
@pytest.mark.parametrize("is_grey", [False, True])
def test_no_noise_of_the_product_comes_from_the_colours_of_cells(device: Device, is_grey: bool, within: str) -> None:
    # Tiles have 3 x 3 pixels, and many straddle the horizons of many cells.
    envmap = EnvironmentMap(coloured(is_grey))
    distribution = build_distribution(device, envmap)
    expected = exact_image(device, envmap, 90, pixels=seen_as({"estimator": "product", "within": within}))
    images = np.stack([one(distribution, 64, 90, seed=s, estimator="product", within=within) for s in range(64)])
    errors = [reference.relative_rmse(image, expected) for image in images]
    light = reference.relative_rmse(one(distribution, 64, 90, estimator="light", within=within), expected)
    assert np.mean(errors) < 0.06 * light  # without the control variate it is 0.44 in colour, and 0.075 in grey
    # Weights of up to 4 are rare, so the mean of a pixel's 64 images is not yet normal, unlike the sum of all pixels.
    z = z_scores(images, expected)
    assert 0.9 < z.std() < 1.1
    assert np.abs(z).max() < 7
    mask = disc_mask(90)
    off = (images[:, mask] / expected[mask] - 1).mean(axis=(1, 2), dtype=np.float64)
    assert abs(off.mean()) < 4 * off.std(ddof=1) / np.sqrt(len(off))


@pytest.mark.parametrize(("height", "width"), [(1, 1), (64, 128), (65, 129)])
def test_the_tables_of_the_product_are_bounded(device: Device, height: int, width: int) -> None:
    distribution = build_distribution(device, EnvironmentMap(np.ones((height, width, 3))))
    for resolution in (1, 32, 511):
        assert np.prod(build_product_cdfs(distribution, resolution).tile_row_cdf.shape) <= ENTRIES
