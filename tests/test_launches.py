"""Work is split over launches, and kernels have several shapes: none of it changes a result."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from conftest import stiff_radiance, with_small_launches
from lightdome import reference
from lightdome.banded import sample_file
from lightdome.device import Device
from lightdome.disc import disc_mask
from lightdome.distribution import build_distribution
from lightdome.envmap import EnvironmentMap
from lightdome.harmonics import project, shade_harmonics
from lightdome.images import ImageRows, write_image
from lightdome.mediancut import median_cut
from lightdome.render import ESTIMATORS, render
from lightdome.render import SEQUENCES as RENDER_SEQUENCES
from lightdome.samples import SEQUENCES
from lightdome.sphere import exact, shade

R = 37
POINTS = np.random.default_rng(8).random((2000, 2))


def results(device: Device, envmap: EnvironmentMap, path: Path) -> dict[str, list[np.ndarray]]:
    """What every function makes of a map that takes more than one work-item. ``path`` is a file of the map."""
    distribution = build_distribution(device, envmap)
    found: dict[str, list[np.ndarray]] = {}
    for sequence in SEQUENCES:
        for count in (90, 2000):  # without and with guide tables
            drawn = distribution.sample(count, 6, sequence)
            found[f"{count} samples, {sequence}"] = [drawn.pixel, drawn.probability, drawn.direction, drawn.radiance]
        found[f"pixels, {sequence}"] = list(distribution.sample_pixels(2000, 6, sequence))
        (drawn,) = sample_file(device, ImageRows(path, batch=5), [2000], 6, sequence)
        found[f"samples of a file, {sequence}"] = [drawn.pixel, drawn.probability, drawn.direction, drawn.radiance]
    found["given points"] = [distribution.sample_at(POINTS).pixel]
    lights = median_cut(distribution, 40)
    found["median cut"] = [lights.direction, lights.flux]
    for name, flux in (("colour", lights.flux), ("grey", lights.flux[:, :1].repeat(3, axis=1))):
        for brute_force in (False, True):
            image = shade(device, lights.direction, flux, R, brute_force=brute_force)
            found[f"shade, {name}, brute force {brute_force}"] = [image]
    found["harmonics"] = [shade_harmonics(device, project(device, envmap, 5), R)]
    found["exact"] = [exact(device, envmap, R), exact(device, envmap, R, pixels="areas")]
    return found


@pytest.mark.parametrize("shape", ["its own", "gpu"])
def test_small_launches_change_no_bit(device: Device, gpu_shaped: Device, shape: str, tmp_path: Path) -> None:
    chosen = gpu_shaped if shape == "gpu" else device
    envmap = EnvironmentMap(stiff_radiance(21, 43))
    write_image(tmp_path / "map.pfm", envmap.radiance)
    whole, small = (results(each, envmap, tmp_path / "map.pfm") for each in (chosen, with_small_launches(chosen)))
    for name, arrays in whole.items():
        for one, many in zip(arrays, small[name], strict=True):
            np.testing.assert_array_equal(many, one, err_msg=name)
            assert one.any(), name
