"""Sets of lights."""

from __future__ import annotations

import numpy as np
import pytest
from lightdome import reference
from lightdome.errors import LightdomeError
from lightdome.lighting.lights import Lights
from lightdome.lighting.shade import shade, shade_samples
from lightdome.maps.envmap import EnvironmentMap
from lightdome.maps.rotation import rotation_matrix
from lightdome.opencl.device import Device
from lightdome.sampling.distribution import build_distribution


def test_samples_are_lights(device: Device, stiff: EnvironmentMap) -> None:
    samples = build_distribution(device, stiff).sample(100)
    lights = Lights.of(samples)
    assert len(lights) == 100
    np.testing.assert_array_equal(shade(device, lights.direction, lights.flux, 32), shade_samples(device, samples, 32))


def test_lights_turn_with_the_map(device: Device, stiff: EnvironmentMap) -> None:
    distribution = build_distribution(device, stiff)
    lights = Lights.of(distribution.sample(200))
    turned = lights.rotated(20, 30, 40)
    np.testing.assert_array_equal(turned.flux, lights.flux)
    expected = lights.direction.astype(np.float64) @ rotation_matrix(20, 30, 40).T
    np.testing.assert_array_equal(turned.direction, expected.astype(np.float32))
    assert not turned.direction.flags.writeable
    yaw = 5 * 360 / stiff.width
    of_map = Lights.of(build_distribution(device, stiff.rotated(yaw)).sample(200))
    # The map's seam has moved, so the samples differ, but their images are close.
    images = [shade(device, each.direction, each.flux, 31) for each in (lights.rotated(yaw), of_map, lights)]
    assert reference.relative_rmse(images[0], images[1]) < reference.relative_rmse(images[2], images[1]) / 2
    with pytest.raises(LightdomeError, match=r"^pitch must be a finite angle"):
        lights.rotated(0, float("nan"))
