"""The error that is estimated without the exact image is the true one, and rendering ends when it should."""

from __future__ import annotations

import sys
from types import SimpleNamespace

import numpy as np
import pytest
from helpers import ROOT, stiff_radiance, with_small_launches
from lightdome.disc import disc_mask
from lightdome.errors import LightdomeError
from lightdome.evaluation.metrics import relative_rmse
from lightdome.lighting.exact import exact
from lightdome.maps.envmap import EnvironmentMap
from lightdome.names import SEED
from lightdome.opencl.device import Device
from lightdome.rendering import estimate, estimate_error, render, render_to_error, to_error
from lightdome.rendering.per_pixel import Sampler
from lightdome.rendering.to_error import seeds_of
from lightdome.sampling.distribution import Distribution, build_distribution

sys.path.insert(0, str(ROOT / "tests" / "tools"))

from coverage_table import LEAST, MOST, coverage, sun

R = 31
MASK = disc_mask(R)


@pytest.fixture(scope="module")
def noise(device: Device) -> Distribution:
    # Several pixels in a cell of `product`, or it would have next to no noise.
    return build_distribution(device, EnvironmentMap(stiff_radiance(70, 260)))


@pytest.fixture(scope="module")
def truth(device: Device, noise: Distribution) -> np.ndarray:
    return exact(device, noise.envmap, R)


def noisy(rng: np.random.Generator, count: int, resolution: int, level: float = 0.1) -> tuple[np.ndarray, np.ndarray]:
    """An image, and independent copies with noise that differs from pixel to pixel and is shared by channels."""
    x, y = np.meshgrid(np.linspace(-1, 1, resolution), np.linspace(-1, 1, resolution))
    image = np.stack([1 + x, 1 + 0.5 * y, np.full_like(x, 0.5)], axis=2) * disc_mask(resolution)[..., None]
    scale = level * np.exp(x + y)[..., None] * disc_mask(resolution)[..., None]
    mixed = rng.standard_normal((count, resolution, resolution, 3)) @ np.array(
        [[1, 0.8, 0.5], [0, 0.4, 0.2], [0, 0, 1]]
    )
    return image, image + scale * mixed


def test_the_estimates_are_those_of_numpy() -> None:
    _, images = noisy(np.random.default_rng(1), 5, R)
    found = estimate_error(list(images))
    np.testing.assert_allclose(found.image, images.mean(axis=0), rtol=1e-6, atol=1e-7)
    variance = images.var(axis=0, ddof=1) / 5
    np.testing.assert_allclose(found.error, np.sqrt(variance.mean(axis=2)), rtol=1e-6)
    squares = (images.mean(axis=0)[MASK] ** 2).sum() - variance[MASK].sum()
    assert found.rmse == pytest.approx(np.sqrt(variance[MASK].sum() / squares), rel=1e-9)
    assert found.interval[0] < found.rmse < found.interval[1]
    shares = (found.error[MASK].astype(np.float64) ** 2).mean() / (found.image[MASK].astype(np.float64) ** 2).mean()
    assert np.sqrt(shares) == pytest.approx(found.rmse, rel=0.01)  # the square of the image includes its noise


@pytest.mark.parametrize(("count", "resolution", "level"), [(4, 31, 0.1), (9, 15, 0.1), (4, 6, 0.1), (4, 31, 1)])
def test_the_interval_holds_the_true_error_in_95_of_100_cases(count: int, resolution: int, level: float) -> None:
    rng = np.random.default_rng(2)
    mask = disc_mask(resolution)
    inside = []
    for _ in range(300):
        image, images = noisy(rng, count, resolution, level)
        found = estimate_error(list(images))
        inside.append(found.interval[0] <= relative_rmse(found.image[mask], image[mask]) <= found.interval[1])
    assert 0.92 <= np.mean(inside) <= 0.98


def test_the_interval_is_as_narrow_as_its_degrees_of_freedom_allow() -> None:
    # Independent channels of the same noise: k = 3 x pixels. The variance of log RMSE is N / (2 k (N - 1)).
    rng = np.random.default_rng(3)
    images = 1 + 0.01 * rng.standard_normal((4, 101, 101, 3))
    low, high = estimate_error(list(images)).interval
    k = 3 * disc_mask(101).sum()
    assert np.log(high / low) == pytest.approx(4 * np.sqrt(4 / (2 * k * 3)), rel=0.03)


@pytest.mark.parametrize(("one", "other"), [(1, 3), (3, 9), (40, 120), (1000, 1000)])
def test_the_quantiles_are_those_of_the_f_distribution(one: int, other: int) -> None:
    rng = np.random.default_rng(4)
    f = (rng.chisquare(one, 10**6) / one) / (rng.chisquare(other, 10**6) / other)
    low, high = estimate._f_quantiles(one, other)
    assert np.mean(f < low) == pytest.approx(0.0228, abs=0.025 if one == 1 else 0.006)
    assert np.mean(f > high) == pytest.approx(0.0228, abs=0.004)


def test_an_image_that_noise_hides_has_no_finite_error() -> None:
    images = [np.full((5, 5, 3), value) for value in (-1.0, 1.0, -1.0, 1.0)]
    found = estimate_error(images)
    assert found.rmse == found.interval[1] == np.inf


def test_equal_images_have_only_rounding_errors() -> None:
    found = estimate_error([np.ones((5, 5, 3))] * 4)
    assert found.rmse == 0
    assert found.interval == (0, estimate.ROUNDING)
    assert not found.error.any()


@pytest.mark.parametrize(
    ("shapes", "words"),
    [([], "four"), ([(5, 5, 3)] * 3, "four"), ([(5, 5, 3)] * 3 + [(6, 6, 3)], "shape"), ([(5,)] * 4, "shape")],
)
def test_images_of_other_numbers_and_shapes_are_refused(shapes: list[tuple[int, ...]], words: str) -> None:
    with pytest.raises(LightdomeError, match=words):
        estimate_error([np.ones(shape) for shape in shapes])


@pytest.mark.parametrize(
    "images",
    [
        None,
        4,
        [1, 2, 3, 4],
        [None] * 4,
        "four",
        np.array(4),
        [np.zeros((0, 0, 3))] * 4,
        [np.full((2, 2, 3), np.nan)] * 4,
    ],
)
def test_what_is_no_image_is_refused(images: object) -> None:
    with pytest.raises(LightdomeError):
        estimate_error(images)


def test_images_may_come_one_by_one() -> None:
    assert estimate_error(np.ones((3, 3, 3)) for _ in range(4)).rmse == 0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("estimator", "sequence", "on"),
    [("product", "lattice", "noise"), ("light", "sobol", "noise"), ("mis", "lattice", "sun")],
)
def test_the_true_error_lies_in_the_interval(
    device: Device, noise: Distribution, estimator: str, sequence: str, on: str
) -> None:
    envmap = {"sun": EnvironmentMap(sun()), "noise": noise.envmap}[on]
    inside, _ = coverage(device, envmap, estimator, sequence, 200, 15, 8)
    assert LEAST <= inside <= MOST


@pytest.mark.parametrize(
    "options", [{}, {"estimator": "light", "sequence": "independent"}, {"within": "pixel"}, {"estimator": "mis"}]
)
def test_it_ends_at_the_error_and_the_true_one_is_no_larger(
    device: Device, noise: Distribution, options: dict[str, str]
) -> None:
    found = render_to_error(noise, 0.05, resolution=R, **options)
    areas = "within" in options or options.get("estimator") == "mis"
    truth = exact(device, noise.envmap, R, pixels="areas" if areas else "centres")
    true = relative_rmse(found.image[MASK], truth[MASK])
    assert found.reason == "error"
    assert found.interval[0] < true < found.interval[1] <= 0.05
    assert true > 0.03  # not many more samples than it takes
    options = {"estimator": "product", "sequence": "lattice", **options}
    images = [next(render(noise, [found.spp // 4], R, seed=seed, **options))[1] for seed in seeds_of(SEED)]
    np.testing.assert_allclose(found.image, np.mean(images, axis=0), rtol=1e-5)
    np.testing.assert_allclose(found.error, estimate_error(images).error, rtol=1e-4)


def test_it_does_not_end_while_the_interval_reaches_beyond_the_error(noise: Distribution) -> None:
    found = [render_to_error(noise, 0.2, resolution=3, seed=seed) for seed in range(10)]
    assert all(each.interval[1] <= 0.2 for each in found)
    assert max(each.rmse for each in found) < 0.16


def test_a_larger_image_needs_no_more_samples(noise: Distribution) -> None:
    small, large = (render_to_error(noise, 0.1, resolution=resolution) for resolution in (R, 3 * R))
    assert 0.5 < large.spp / small.spp < 2
    assert large.interval[1] / large.interval[0] < small.interval[1] / small.interval[0]


def test_seeds_and_albedo_are_passed_on(noise: Distribution) -> None:
    one, same, other = (render_to_error(noise, 0.2, resolution=9, seed=seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one.image, same.image)
    assert (one.image != other.image).any()
    half = render_to_error(noise, 0.2, resolution=9, seed=1, albedo=0.5)
    np.testing.assert_allclose(half.image, one.image / 2, rtol=1e-6)
    assert half.rmse == pytest.approx(one.rmse, rel=1e-5)
    assert len({seed for start in range(100) for seed in seeds_of(start)}) == 400


def test_noise_may_hide_the_image_again_in_a_later_round(noise: Distribution) -> None:
    found = render_to_error(noise, 0.3, resolution=1, seed=16, estimator="light", sequence="independent")
    assert found.reason == "error"
    assert to_error._needed([(4, 0.5), (16, np.inf)], 0.3) == to_error.MOST


def test_any_time_may_be_asked_for(noise: Distribution) -> None:
    assert render_to_error(noise, 0.1, 1e308, resolution=9).spp > 16


def test_it_ends_when_the_time_is_up(noise: Distribution, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = 0.0
    built = False
    add = Sampler.add

    def slow(sampler: Sampler, key: np.ndarray, begin: int, end: int, *rest: object) -> None:
        nonlocal clock, built
        clock += 0.01 * (end - begin) + (0 if built else 3)
        built = True
        add(sampler, key, begin, end, *rest)

    monkeypatch.setattr(Sampler, "add", slow)
    monkeypatch.setattr(to_error, "time", SimpleNamespace(perf_counter=lambda: clock))
    found = render_to_error(noise, 1e-4, 10.0, R)
    assert found.reason == "time"
    assert 9.5 < found.seconds == clock <= 10
    assert found.spp == pytest.approx(700, rel=0.05)
    assert found.interval[1] > 1e-4
    assert render_to_error(noise, 1e-4, 1e-9, R).spp == 16
    assert render_to_error(noise, 0.3, 10.0, R).reason == "error"


def test_launches_of_few_samples_change_nothing(device: Device, noise: Distribution) -> None:
    few = build_distribution(with_small_launches(device), noise.envmap)
    images = [render_to_error(each, 0.1, resolution=9, estimator="mis").image for each in (noise, few)]
    np.testing.assert_allclose(images[1], images[0], rtol=1e-5)


def test_it_ends_at_the_largest_number_of_samples(noise: Distribution, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(to_error, "MOST", 24)
    found = render_to_error(noise, 1e-4, resolution=9)
    assert (found.reason, found.spp) == ("limit", 96)


@pytest.mark.parametrize("sky", [0, 1e-3])
def test_it_does_not_end_while_a_sun_is_missed(device: Device, sky: float, monkeypatch: pytest.MonkeyPatch) -> None:
    radiance = np.full((128, 256, 3), sky, np.float32)
    radiance[30, 64] = 5e4
    distribution = build_distribution(device, EnvironmentMap(radiance))
    found = render_to_error(distribution, 0.4, resolution=5, estimator="bsdf", sequence="independent")
    assert (found.reason, found.image.max() > 1) == ("error", True)
    assert render_to_error(distribution, 0.4, 1e-9, 5, estimator="bsdf").reason == "light"
    monkeypatch.setattr(to_error, "MOST", 4)
    assert render_to_error(distribution, 0.4, resolution=5, estimator="bsdf").reason == "light"


@pytest.mark.parametrize("behind", [False, True])
def test_a_black_image_needs_no_samples(device: Device, behind: bool) -> None:
    radiance = np.zeros((16, 32, 3), np.float32)
    if behind:
        radiance[8, 24] = 1
    found = render_to_error(build_distribution(device, EnvironmentMap(radiance)), 0.01, resolution=3)
    assert not found.image.any()
    assert (found.error.shape, found.spp, found.rmse, found.reason) == ((3, 3), 0, 0, "error")
    assert not np.shares_memory(found.image, found.error)


@pytest.mark.parametrize(
    "options",
    [
        *({"error": error} for error in (0, -1, 1.5, 1e-6, np.nan, "1%", None)),
        *({"seconds": seconds} for seconds in (0, -1, np.inf, "1")),
        {"estimator": "bsdf", "within": "centre"},
        {"sequence": "r2"},
        {"seed": -1},
        {"resolution": 0},
    ],
)
def test_wrong_arguments_are_refused(noise: Distribution, options: dict[str, object]) -> None:
    with pytest.raises(LightdomeError):
        render_to_error(noise, **{"error": 0.1, "resolution": 9, **options})
