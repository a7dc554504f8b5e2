"""The per-pixel renderer is unbiased and its error falls as 1 / sqrt(spp)."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import stiff_radiance
from lightdome import reference
from lightdome.device import Device
from lightdome.disc import disc_mask
from lightdome.distribution import Distribution, build_distribution
from lightdome.envmap import EnvironmentMap
from lightdome.errors import LightdomeError
from lightdome.render import render

R = 24


@pytest.fixture(scope="module")
def distribution(device: Device) -> Distribution:
    return build_distribution(device, EnvironmentMap(stiff_radiance(32, 64)))


@pytest.fixture(scope="module")
def target(distribution: Distribution) -> np.ndarray:
    image = np.zeros((R, R, 3))
    mask = disc_mask(R)
    image[mask] = reference.exact(distribution.envmap.radiance, reference.normals(R)[mask])
    return image


def one(distribution: Distribution, spp: int, **options: float) -> np.ndarray:
    ((_, image),) = render(distribution, [spp], R, **options)
    return image


def test_the_mean_over_seeds_meets_the_exact_image(distribution: Distribution, target: np.ndarray) -> None:
    images = np.stack([one(distribution, 16, seed=seed) for seed in range(200)])
    mask = disc_mask(R)
    error = (images.mean(axis=0) - target)[mask]
    standard_error = (images.std(axis=0, ddof=1) / np.sqrt(len(images)))[mask]
    z = error / standard_error
    # Pixels and channels are hundreds of tests: their z-scores have mean 0 and spread 1.
    assert abs(z.mean()) < 0.15
    assert 0.8 < z.std() < 1.25
    assert np.abs(z).max() < 6


def test_the_error_falls_as_one_over_the_root_of_spp(distribution: Distribution, target: np.ndarray) -> None:
    errors = {
        spp: np.mean([reference.relative_rmse(one(distribution, spp, seed=s), target) for s in range(6)])
        for spp in (16, 64, 256, 1024)
    }
    for spp in (16, 64, 256):
        assert errors[spp] / errors[4 * spp] == pytest.approx(2, rel=0.2)


def test_more_samples_continue_fewer(distribution: Distribution) -> None:
    images = dict(render(distribution, [64, 8, 8, 16], R, seed=3))
    assert list(images) == [8, 16, 64]
    np.testing.assert_allclose(images[64], one(distribution, 64, seed=3), rtol=1e-5, atol=1e-7)


def test_pixels_are_independent_of_each_other_and_of_the_seed(distribution: Distribution) -> None:
    image, other = one(distribution, 4, seed=1), one(distribution, 4, seed=2)
    assert (image != other)[disc_mask(R)].mean() > 0.9
    assert len(np.unique(image[..., 0])) > 0.8 * disc_mask(R).sum()


def test_outside_the_disc_is_black_and_albedo_scales(distribution: Distribution) -> None:
    image = one(distribution, 4)
    assert not image[~disc_mask(R)].any()
    np.testing.assert_allclose(one(distribution, 4, albedo=0.5), image / 2, rtol=1e-6)


def test_a_black_map_renders_black(device: Device) -> None:
    black = build_distribution(device, EnvironmentMap(np.zeros((4, 8, 3))))
    assert not one(black, 8).any()


@pytest.mark.parametrize("spp", [[], [0], [8, -1]])
def test_other_numbers_of_samples_are_refused(distribution: Distribution, spp: list[int]) -> None:
    with pytest.raises(LightdomeError, match="samples a pixel"):
        list(render(distribution, spp, R))
