"""The estimator ``mis`` with any share of light samples: unbiased, and its variance is as predicted."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from helpers import stiff_radiance
from lightdome import reference
from lightdome.disc import disc_mask
from lightdome.errors import LightdomeError
from lightdome.lighting.exact import exact
from lightdome.maps.envmap import EnvironmentMap
from lightdome.opencl.device import Device
from lightdome.rendering.light_share import SHARES, UNEQUAL, choose_share, light_samples, variances
from lightdome.rendering.per_pixel import SEQUENCES, render
from lightdome.sampling.cdf import build_cdf
from lightdome.sampling.distribution import Distribution, build_distribution

R = 24


def noise(height: int = 16, width: int = 32) -> np.ndarray:
    return np.exp(np.random.default_rng(3).normal(0, 1, (height, width, 3))).astype(np.float32)


def with_lamp(radiance: np.ndarray, value: float = 2e3) -> np.ndarray:
    radiance = radiance.copy()
    radiance[5, 7] = value, value / 2, value / 3
    return radiance


MAPS = {
    "even": np.ones((16, 32, 3), np.float32),
    "noise": noise(),
    "lamp": with_lamp(noise()),
    "stiff": stiff_radiance(32, 64),
}


@pytest.fixture(scope="module", params=MAPS)
def distribution(request: pytest.FixtureRequest, device: Device) -> Distribution:
    return build_distribution(device, EnvironmentMap(MAPS[request.param]))


def compensated(distribution: Distribution) -> tuple[float, float]:
    """The offset and the flux of MIS compensation."""
    S = distribution.envmap.radiance.sum(axis=2, dtype=np.float64)
    offset = np.average(S.mean(axis=1), weights=distribution.map.solid_angles)
    return float(offset), float(np.maximum(S - offset, 0).sum(axis=1) @ distribution.map.solid_angles)


def expected_variances(radiance: np.ndarray, offset: float) -> np.ndarray:
    """The variances for the shares by a sum over many directions in float64, over the normals of an image."""
    times = 64 // len(radiance)
    L = radiance.astype(np.float64).repeat(times, axis=0).repeat(times, axis=1)
    omega, w = reference.directions(*L.shape[:2]).reshape(-1, 3), reference.pixel_solid_angles(*L.shape[:2]).ravel()
    L = L.reshape(-1, 3)
    light = np.maximum(L.sum(axis=1) - offset, 0)
    light /= light @ w
    result = np.zeros(len(SHARES))
    for n in reference.normals(12)[disc_mask(12)]:
        cosine = np.maximum(omega @ n, 0) / np.pi
        f = L * cosine[:, None]
        for i, a in enumerate(SHARES):
            both = np.maximum(a * light + (1 - a) * cosine, 1e-300)
            worth = f / both[:, None]
            result[i] += (w * both) @ (worth**2).sum(axis=1)
            result[i] -= a * (((w * light) @ worth) ** 2).sum() + (1 - a) * (((w * cosine) @ worth) ** 2).sum()
    return result


@pytest.mark.slow
@pytest.mark.parametrize("is_compensated", [False, True])
def test_variances_are_those_of_a_sum_over_directions(distribution: Distribution, is_compensated: bool) -> None:
    offset, flux = compensated(distribution) if is_compensated else (0.0, 3 * distribution.flux)
    if flux < 1e-6 * distribution.flux:
        return  # nothing is above the mean
    expected = expected_variances(distribution.envmap.radiance, offset)
    for samples, tolerance in ((256, 0.1), (2**14, 0.06)):
        result = variances(distribution, offset, flux, samples)
        np.testing.assert_allclose(result / result[0], expected / expected[0], rtol=tolerance)


@pytest.mark.slow
def test_images_have_these_variances(distribution: Distribution) -> None:
    truth = exact(distribution.device, distribution.envmap, R, pixels="areas")
    errors = []
    for share in SHARES:
        images = [
            image
            for seed in range(40)
            for _, image in render(distribution, [16], R, seed=seed, estimator="mis", light_share=share)
        ]
        errors.append(np.mean([reference.relative_rmse(image, truth) ** 2 for image in images]))
    predicted = variances(distribution, 0.0, 3 * distribution.flux, 2**14)
    np.testing.assert_allclose(np.array(errors) / errors[0], predicted / predicted[0], rtol=0.15)


@pytest.mark.parametrize("sequence", SEQUENCES)
@pytest.mark.parametrize("compensation", [False, True])
@pytest.mark.parametrize("spp", [1, 3, 16])
@pytest.mark.parametrize(
    "share", [pytest.param(0.01, marks=pytest.mark.slow), 7 / 8, pytest.param(0.99, marks=pytest.mark.slow)]
)
def test_any_share_is_unbiased(
    distribution: Distribution, share: float, spp: int, compensation: bool, sequence: str
) -> None:
    truth = exact(distribution.device, distribution.envmap, R, pixels="areas").astype(np.float64)
    images = np.stack(
        [
            image
            for seed in range(32)
            for _, image in render(distribution, [spp], R, 1.0, seed, "mis", sequence, compensation, light_share=share)
        ]
    )
    mask = disc_mask(R)
    # Over the whole image, since few samples are far from a normal distribution.
    sums = images[:, mask].astype(np.float64).mean(axis=(1, 2))
    assert abs(sums.mean() - truth[mask].mean()) < 4.5 * sums.std(ddof=1) / math.sqrt(len(sums))


@pytest.mark.parametrize("share", SHARES)
def test_many_samples_of_any_share_meet_the_exact_image(distribution: Distribution, share: float) -> None:
    ((_, image),) = render(distribution, [2**13], R, estimator="mis", sequence="sobol", light_share=share)
    truth = exact(distribution.device, distribution.envmap, R, pixels="areas")
    assert reference.relative_rmse(image, truth) < 0.006


def test_both_always_have_a_sample_and_together_two_per_spp() -> None:
    assert [light_samples(spp, 7 / 8) for spp in (1, 2, 3, 4, 8, 64)] == [1, 3, 5, 7, 14, 112]
    assert [light_samples(1, share) for share in SHARES] == [1, 1, 1, 1]
    assert (light_samples(8, 1e-9), light_samples(8, 1 - 1e-9)) == (1, 15)
    assert all(light_samples(spp, share) == 2 * spp * share for spp in (4, 8, 100) for share in SHARES)


def test_images_continue_where_the_share_is_the_same_and_start_anew_elsewhere(device: Device) -> None:
    distribution = build_distribution(device, EnvironmentMap(MAPS["lamp"]))
    for spp, image in render(distribution, [1, 2, 3, 4, 8, 9, 16, 400], R, estimator="mis", light_share=7 / 8):
        ((_, alone),) = render(distribution, [spp], R, estimator="mis", light_share=7 / 8)
        np.testing.assert_allclose(image, alone, rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize(("name", "share"), [("even", 1 / 4), ("noise", 1 / 2), ("lamp", 7 / 8)])
def test_the_share_suits_the_map(device: Device, name: str, share: float) -> None:
    distribution = build_distribution(device, EnvironmentMap(MAPS[name]))
    device.decisions.take()
    assert choose_share(distribution) == share
    decision = {d.what: d for d in device.decisions.take()}[UNEQUAL]
    assert decision.used == (share != 1 / 2)
    assert (f"{Fraction(share)} of the directions" in decision.why) == decision.used
    images = [next(render(distribution, [4], R, estimator="mis", light_share=given))[1] for given in (None, share)]
    np.testing.assert_array_equal(*images)


def test_compensation_has_a_share_of_its_own(device: Device) -> None:
    # Without the dim light, whose samples are noisy, the light needs fewer.
    distribution = build_distribution(device, EnvironmentMap(MAPS["lamp"]))
    offset, flux = compensated(distribution)
    assert choose_share(distribution) == 7 / 8
    assert choose_share(distribution, offset, flux) == 1 / 2
    cdf = build_cdf(distribution.map, offset)
    assert flux == pytest.approx(3 * distribution.flux * cdf.total / distribution.total, rel=1e-3)


@pytest.mark.parametrize("exponent", [-140, 100])
def test_the_scale_of_the_map_does_not_matter(device: Device, exponent: int) -> None:
    small = build_distribution(device, EnvironmentMap(MAPS["lamp"]))
    scaled = build_distribution(device, EnvironmentMap(np.ldexp(MAPS["lamp"], exponent)))
    of_small, of_scaled = (variances(d, 0.0, 3 * d.flux) for d in (small, scaled))
    # At 2^-140 float32 has few digits left, so some points pick a neighbouring pixel.
    np.testing.assert_allclose(of_scaled / of_scaled[0], of_small / of_small[0], rtol=3e-3)


def test_numbers_are_equal_where_no_normal_sees_the_light(device: Device) -> None:
    radiance = np.zeros((16, 32, 3), np.float32)
    radiance[8, 24] = 1  # behind the sphere
    assert choose_share(build_distribution(device, EnvironmentMap(radiance))) == 1 / 2


@pytest.mark.parametrize("share", [0, 1, -0.5, 1.5, math.nan, "half", True])
def test_shares_that_are_no_part_are_refused(device: Device, share: object) -> None:
    distribution = build_distribution(device, EnvironmentMap(MAPS["even"]))
    with pytest.raises(LightdomeError, match="above 0 and below 1"):
        render(distribution, [1], R, estimator="mis", light_share=share)  # type: ignore[arg-type]


@pytest.mark.parametrize("estimator", ["light", "bsdf", "product"])
def test_a_share_needs_mis(device: Device, estimator: str) -> None:
    distribution = build_distribution(device, EnvironmentMap(MAPS["even"]))
    with pytest.raises(LightdomeError, match="'mis'"):
        render(distribution, [1], R, estimator=estimator, light_share=0.5)
