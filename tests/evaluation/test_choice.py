"""The cheapest method that is measured to reach an error does reach it, and is the one that is used."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from helpers import stiff_radiance
from lightdome.disc import disc_mask
from lightdome.errors import LightdomeError
from lightdome.evaluation import choice
from lightdome.evaluation.choice import Choice, render_cheapest
from lightdome.evaluation.metrics import relative_rmse
from lightdome.lighting.exact import exact
from lightdome.lighting.median_cut import median_cut
from lightdome.lighting.shade import shade
from lightdome.maps.envmap import EnvironmentMap
from lightdome.opencl.device import Device
from lightdome.rendering.to_error import render_to_error
from lightdome.sampling.distribution import Distribution, build_distribution

R = 99


@pytest.fixture(scope="module")
def distribution(device: Device) -> Distribution:
    # Several pixels in a cell of `product`, or it would have next to no noise.
    return build_distribution(device, EnvironmentMap(stiff_radiance(70, 260)))


def only(monkeypatch: pytest.MonkeyPatch, *chosen: Choice) -> None:
    """Let these be the methods found."""
    monkeypatch.setattr(choice._Trial, "choices", lambda _: iter(chosen))


@pytest.mark.slow
@pytest.mark.parametrize("within", [None, "pixel"])
@pytest.mark.parametrize("error", [0.2, 0.01])
def test_the_cheapest_reaches_the_error(distribution: Distribution, error: float, within: str | None) -> None:
    found = render_cheapest(distribution, error, R, within=within)
    truth = exact(distribution.device, distribution.envmap, R, pixels="areas" if within else "centres")
    mask = disc_mask(R)
    assert relative_rmse(found.image[mask], truth[mask]) < error
    assert found.rmse == pytest.approx(relative_rmse(found.image[mask], truth[mask]), rel=0.1, abs=1e-6)
    seconds = [each.seconds for each in found.choices]
    assert seconds == sorted(seconds)
    assert all(each.error <= error for each in found.choices)
    assert "exact" in {each.method for each in found.choices}


def test_an_error_that_nothing_else_reaches_needs_the_exact_image(
    distribution: Distribution, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(choice.SHARED, "median-cut", (16,))  # with more lights than pixels, median cut is exact, too
    found = render_cheapest(distribution, 1e-5, R, albedo=0.5)
    assert found.choices[0].method == "exact"
    assert (found.rmse, found.interval) == (0, None)
    np.testing.assert_array_equal(found.image, exact(distribution.device, distribution.envmap, R, 0.5))
    assert not found.error.any()


def test_the_error_of_lights_is_that_of_the_small_image(
    distribution: Distribution, monkeypatch: pytest.MonkeyPatch
) -> None:
    only(monkeypatch, Choice("exact", 1, 0, 2), Choice("median-cut", 16, 0.1, 1))
    found = render_cheapest(distribution, 0.1, 2 * choice.SMALL, albedo=0.5)
    device, lights = distribution.device, median_cut(distribution, 16)
    np.testing.assert_array_equal(found.image, shade(device, lights, resolution=2 * choice.SMALL, albedo=0.5))
    small = shade(device, lights, resolution=choice.SMALL) - exact(device, distribution.envmap, choice.SMALL)
    expected = 0.5 * np.sqrt((small.astype(np.float64) ** 2).mean(axis=2)).repeat(2, axis=0).repeat(2, axis=1)
    mask = disc_mask(2 * choice.SMALL)
    np.testing.assert_allclose(found.error[mask], expected[mask], rtol=1e-3)
    assert not found.error[~mask].any()


def test_samples_per_pixel_are_drawn_until_the_error_is_reached(
    distribution: Distribution, monkeypatch: pytest.MonkeyPatch
) -> None:
    only(monkeypatch, Choice("exact", 1, 0, 2), Choice("light-sobol", 64, 0.2, 1))
    found = render_cheapest(distribution, 0.2, 31, seed=3)
    expected = render_to_error(distribution, 0.2, None, 31, seed=3, estimator="light", sequence="sobol")
    np.testing.assert_array_equal(found.image, expected.image)
    assert found.interval == expected.interval
    assert found.interval[1] <= 0.2
    assert found.reason == "error"


@pytest.mark.slow
def test_the_samples_that_an_estimator_needs_are_about_those_it_takes(distribution: Distribution) -> None:
    trial = choice._Trial(distribution, 0.05, 31, 1, None, 1.0)
    assert list(trial.per_pixel)[:3] == ["light-lattice", "light-sobol", "light"]
    first, more = (trial.run("product-lattice", count) for count in choice.TRIED)
    found = trial.with_samples("product-lattice", first, more, 0.001)
    assert found is not None
    taken = render_to_error(distribution, 0.05, resolution=31).spp
    assert found.count == pytest.approx(taken, rel=0.4)
    assert found.seconds > 0.001
    trial.error = 1e-5
    assert trial.with_samples("product-lattice", first, more, 0.001) is None


def test_the_estimates_of_the_error_take_time(distribution: Distribution, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = 0.0

    def estimate(images: list[np.ndarray]) -> SimpleNamespace:
        nonlocal clock
        clock += 1
        return SimpleNamespace(image=images[0])

    monkeypatch.setattr(choice, "estimate_error", estimate)
    monkeypatch.setattr(choice, "time", SimpleNamespace(perf_counter=lambda: clock))
    trial = choice._Trial(distribution, 0.05, 9, 1, None, 1.0)
    first, more = (trial.run("product-lattice", count) for count in choice.TRIED)
    found = trial.with_samples("product-lattice", first, more, 5)
    assert found is not None
    assert found.seconds == 5 + np.ceil(np.log(found.count / 16) / np.log(4))


def test_a_long_run_is_measured_once(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = 0.0

    def run(seconds: float) -> None:
        nonlocal clock
        clock += seconds

    monkeypatch.setattr(choice, "time", SimpleNamespace(perf_counter=lambda: clock))
    for seconds, total in ((0.0625, 0.1875), (0.5, 0.6875)):
        assert choice._Trial.shortest(lambda _, seconds=seconds: run(seconds), 9) == seconds
        assert clock == total


def test_only_the_decisions_of_the_final_image_are_left(
    distribution: Distribution, monkeypatch: pytest.MonkeyPatch
) -> None:
    only(monkeypatch, Choice("median-cut", 16, 0.1, 1))
    distribution.device.decisions.use("a trial", "it is tried")
    found = render_cheapest(distribution, 0.1, 9)
    assert found.reason is None
    made = [str(each) for each in distribution.device.decisions.take()]
    assert "a trial" not in str(made)


@pytest.mark.parametrize("albedo", [0, 1])
def test_a_black_image_is_exact(device: Device, albedo: float) -> None:
    light = np.zeros((4, 8, 3)) if albedo else np.ones((4, 8, 3))
    found = render_cheapest(build_distribution(device, EnvironmentMap(light)), 0.01, 9, albedo)
    assert (found.rmse, found.reason) == (0, None)
    assert [each.method for each in found.choices] == ["exact"]
    assert not found.image.any()


def test_a_choice_says_its_count_time_and_error() -> None:
    shown = {
        "exact: 0.35 s, error 0 %": Choice("exact", 1, 0, 0.354),
        "harmonics of order 6: 4.3 ms, error 0.53 %": Choice("harmonics", 6, 0.0053, 0.0043),
        "median-cut with 64 lights: 14 ms, error 0.7 %": Choice("median-cut", 64, 0.007, 0.014),
        "lattice with 64 samples for all pixels: 1 ms, error 4.5 %": Choice("lattice", 64, 0.045, 0.001),
        "mis-sobol with 96 spp: 2.5 s, error 5 %": Choice("mis-sobol", 96, 0.05, 2.46),
    }
    for text, made in shown.items():
        assert str(made) == text


@pytest.mark.parametrize("options", [{"error": 0}, {"error": 2}, {"resolution": 0}, {"albedo": -1}, {"within": "here"}])
def test_wrong_arguments_are_refused(distribution: Distribution, options: dict[str, object]) -> None:
    with pytest.raises(LightdomeError):
        render_cheapest(distribution, **{"error": 0.1, "resolution": 9, **options})


def test_a_method_without_an_error_can_be_extrapolated(device: Device) -> None:
    distribution = build_distribution(device, EnvironmentMap(np.ones((32, 64, 3), np.float32)))
    trial = choice._Trial(distribution, 0.01, 1, 1, "pixel", 1.0)
    first, more = (trial.run("bsdf", spp) for spp in choice.TRIED)
    assert trial.off(first) == 0
    assert trial.with_samples("bsdf", first, more, 0.01).count == 4 * choice.TRIED[0]
