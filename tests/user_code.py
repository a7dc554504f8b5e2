"""A typed user program: tests/test_wheel.py has mypy check it against an installed lightdome."""

from __future__ import annotations

from pathlib import Path

import lightdome
import numpy as np
from lightdome.fresnel import summarise
from lightdome.maps import analyse
from lightdome.rendering import render


def errors(envmap: lightdome.EnvironmentMap, resolution: int) -> dict[str, float]:
    device: lightdome.Device = lightdome.open_device()
    distribution = lightdome.build_distribution(device, envmap)
    truth = lightdome.exact(device, envmap, resolution, pixels="areas")
    found: dict[str, float] = {}
    for spp, image in render(distribution, [8, 16], resolution, estimator="product", within="pixel"):
        found[f"{spp} spp"] = float(np.abs(image - truth).max())
    samples = distribution.sample(64, seed=1, sequence="sobol", within="pixel")
    few: lightdome.Samples = samples[:16]
    for sample in few:
        print(sample.probability, sample.pixel.tolist())
    image = lightdome.shade_samples(device, few, resolution=resolution)
    found["shared"] = float(np.abs(image - truth).max())
    return found


def main(path: Path | None = None) -> None:
    envmap = lightdome.EnvironmentMap.read(path or lightdome.default_map(), sanitize="clamp").rotated(90)
    print(errors(envmap, 31), analyse(envmap).flux_rgb_radiance_sr, summarise(1.4))
    device = lightdome.open_device("0:0")
    lights = lightdome.median_cut(lightdome.build_distribution(device, envmap), 16)
    print(device, lights, sum(light.flux[0] for light in lights), lights == lights[:8])
    harmonics = lightdome.project(device, envmap, 3)
    lightdome.write_image("harmonics.exr", lightdome.shade_harmonics(device, harmonics, 31))
    lightdome.write_lights("lights.usda", lights)
    lightdome.show(lightdome.shade(device, lights, resolution=31))


if __name__ == "__main__":
    try:
        main()
    except lightdome.LightdomeError as error:
        print(error)
