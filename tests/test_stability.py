"""The stability table: its cases hold, its measures are right, and what breaks a sampler fails it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from lightdome import buffers, reference
from lightdome.device import Device
from lightdome.disc import disc_mask
from lightdome.distribution import build_distribution
from lightdome.envmap import EnvironmentMap
from lightdome.float_range import LARGEST
from lightdome.harmonics import project, shade_harmonics
from lightdome.mediancut import median_cut
from lightdome.render import ESTIMATORS, render
from lightdome.sphere import exact, shade, shade_samples

R = 9


def test_dim_pixels_keep_their_digits_under_a_huge_one_at_the_pole(device: Device) -> None:
    # sin(theta) makes little of the huge pixel, so that probabilities of pixels 2^137 below it are normal numbers.
    radiance = np.full((8192, 2, 3), 2.0**-9 * 1.37, np.float32)
    radiance[0, 0] = 2.0**127
    distribution = build_distribution(device, EnvironmentMap(radiance))
    even = buffers.upload(device, np.arange(1, 8193, dtype=np.uint32))
    equator = replace(distribution, marginal_cdf=even).sample_at(np.array([[0.5, 0.5]]))
    assert equator.pixel[0, 1] == 4096
    expected = reference.probability(radiance)[4096, 1]
    assert expected > np.finfo(np.float32).tiny
    np.testing.assert_allclose(equator.probability, expected, rtol=2e-6)


@pytest.mark.parametrize("value", [2.0**-149, 2.0**-140, 1e38, LARGEST])
def test_images_end_at_the_ends_of_float32(device: Device, value: float) -> None:
    envmap = EnvironmentMap(np.full((16, 32, 3), value, np.float32))
    distribution = build_distribution(device, envmap)
    mask = disc_mask(R)
    lights = median_cut(distribution, 1)
    images = {
        "exact": exact(device, envmap, R),
        "one sample": shade_samples(device, distribution.sample(1), R),
        "samples": shade_samples(device, distribution.sample(256), R),
        "one light": shade(device, lights.direction, lights.flux, R),
        "harmonics": shade_harmonics(device, project(device, envmap), R),
    }
    for estimator in ESTIMATORS:
        ((_, images[estimator]),) = render(distribution, [16], R, estimator=estimator)
    for name, image in images.items():
        assert np.isfinite(image).all(), name
        assert image[~mask].max() == 0, name
    expected = np.minimum(reference.exact(envmap.radiance, reference.normals(R)[mask]), LARGEST)
    np.testing.assert_allclose(images["exact"][mask], expected, rtol=1e-5, atol=2.0**-149)
    np.testing.assert_allclose(images["harmonics"][mask], expected, rtol=0.01, atol=2.0**-149)
