"""Sets of lights."""

from __future__ import annotations

import numpy as np
from lightdome.lighting.lights import Lights
from lightdome.lighting.shade import shade, shade_samples
from lightdome.maps.envmap import EnvironmentMap
from lightdome.opencl.device import Device
from lightdome.sampling.distribution import build_distribution


def test_samples_are_lights(device: Device, stiff: EnvironmentMap) -> None:
    samples = build_distribution(device, stiff).sample(100)
    lights = Lights.of(samples)
    assert len(lights) == 100
    np.testing.assert_array_equal(shade(device, lights.direction, lights.flux, 32), shade_samples(device, samples, 32))
