"""The main job on the real Grace Cathedral map, against float64 and against known numbers."""

from __future__ import annotations

import numpy as np
import pytest
from lightdome import reference
from lightdome.disc import disc_mask
from lightdome.evaluation.stability import chi_square_z
from lightdome.lighting.exact import exact
from lightdome.lighting.shade import shade_samples
from lightdome.maps.envmap import EnvironmentMap
from lightdome.opencl.device import Device
from lightdome.rendering.per_pixel import ESTIMATORS, render
from lightdome.sampling.distribution import Distribution, build_distribution


@pytest.fixture(scope="module")
def distribution(device: Device, grace: EnvironmentMap) -> Distribution:
    return build_distribution(device, grace)


@pytest.fixture(scope="module")
def target(device: Device, grace: EnvironmentMap) -> np.ndarray:
    return exact(device, grace, 127)


def test_every_probability_is_the_references(grace: EnvironmentMap, distribution: Distribution) -> None:
    samples = distribution.sample(200_000)
    x, y = samples.pixel.T
    expected = reference.probability(grace.radiance)[y, x]
    np.testing.assert_allclose(samples.probability, expected, rtol=1e-6)
    np.testing.assert_array_equal(samples.radiance, grace.radiance[y, x])
    np.testing.assert_allclose(samples.direction, reference.directions(512, 1024)[y, x], atol=2e-7)


def test_a_million_draws_pass_chi_square_and_only_with_sin_theta(
    grace: EnvironmentMap, distribution: Distribution
) -> None:
    samples = distribution.sample(1_000_000, seed=1)
    x, y = samples.pixel.T
    seen = np.bincount(y.astype(np.int64) * 1024 + x, minlength=512 * 1024).reshape(512, 1024)
    assert abs(chi_square_z(seen, reference.probability(grace.radiance))) < 4
    without = reference.luminance(grace.radiance)
    assert chi_square_z(seen, without / without.sum()) > 100


def test_the_exact_image_has_the_known_mean(device: Device, grace: EnvironmentMap) -> None:
    mean = exact(device, grace, 511).mean(axis=(0, 1), dtype=np.float64)
    np.testing.assert_allclose(mean, (0.023415, 0.010695, 0.011321), atol=1e-6)


def test_the_exact_image_meets_float64(grace: EnvironmentMap, target: np.ndarray) -> None:
    y, x = np.nonzero(disc_mask(127))
    some = slice(None, None, 409)
    expected = reference.exact(grace.radiance, reference.normals(127)[y, x][some])
    np.testing.assert_allclose(target[y, x][some], expected, rtol=2e-6)


@pytest.mark.slow
def test_the_exact_image_of_areas_meets_quadrature(device: Device, grace: EnvironmentMap) -> None:
    areas = exact(device, grace, 127, pixels="areas")
    y, x = (index[::2500] for index in np.nonzero(disc_mask(127)))
    expected = reference.exact_areas(grace.radiance, reference.normals(127)[y, x], nodes=8)
    assert np.abs(areas[y, x] - expected).max() < 2e-7 * areas.max()


def test_shading_meets_float64(device: Device, distribution: Distribution) -> None:
    samples = distribution.sample(1024)
    image = shade_samples(device, samples, 511)
    some = np.argwhere(disc_mask(511))[::17]  # 17 and 511 have no common factor, so all tiles and places in them occur
    y, x = some.T
    expected = reference.shade(reference.normals(511)[y, x], samples.direction, samples.radiance, samples.density)
    assert np.abs(image[y, x] - expected).max() < 1e-6 * expected.max()


def test_errors_of_shared_samples(device: Device, distribution: Distribution, target: np.ndarray) -> None:
    for count, known in ((64, 0.137), (256, 0.060), (1024, 0.034)):
        errors = [
            reference.relative_rmse(shade_samples(device, distribution.sample(count, s), 127), target)
            for s in range(24)
        ]
        assert np.mean(errors) == pytest.approx(known, rel=0.2)


def test_errors_of_fresh_samples(
    device: Device, grace: EnvironmentMap, distribution: Distribution, target: np.ndarray
) -> None:
    # 64 samples per pixel. PBRT-v4 has 7.3 % (path, zsobol) and 13.4 % (independent), PBRT-v3 6.8 % (02sequence).
    targets = {"centres": target, "areas": exact(device, grace, 127, pixels="areas")}

    def error(**options: object) -> float:
        images = [next(render(distribution, [64], 127, seed=s, **options))[1] for s in range(3)]
        own = targets[ESTIMATORS[str(options["estimator"])].pixels]
        return float(np.mean([reference.relative_rmse(image, own) for image in images]))

    assert error(estimator="light") == pytest.approx(0.146, rel=0.1)
    assert error(estimator="mis") == pytest.approx(0.104, rel=0.1)
    assert error(estimator="mis", sequence="sobol") < 0.052
    assert error(estimator="mis", sequence="sobol", mis_compensation=True) < 0.056
    assert error(estimator="product") < 0.012  # without the control variate 0.06, and 0.02 with sobol
    assert error(estimator="product", sequence="sobol") < 0.012


def test_parts_3_and_4_line_up(device: Device, distribution: Distribution, target: np.ndarray) -> None:
    ((_, noisy),) = render(distribution, [256], 127)
    smooth = shade_samples(device, distribution.sample(65536), 127)
    assert reference.relative_rmse(smooth, target) < 0.01
    assert reference.relative_rmse(noisy, target) < 0.1
    # If shifted by one pixel, or turned, the noise-free image fits the noisy one less well.
    core = np.s_[8:-8, 8:-8]
    fit = np.square(noisy - smooth)[core].mean()
    for shift in ((0, 3), (0, -3), (3, 0), (-3, 0)):
        assert np.square(noisy - np.roll(smooth, shift, (0, 1)))[core].mean() > fit
    for turned in (smooth[::-1], smooth[:, ::-1], smooth.swapaxes(0, 1)):
        assert np.square(noisy - turned)[core].mean() > 2 * fit
