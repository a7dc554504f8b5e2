"""`lightdome exact` writes the image that estimators converge to, by either integral."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers import Script, stiff_radiance
from lightdome.commands import settings
from lightdome.lighting.exact import exact
from lightdome.maps.envmap import EnvironmentMap
from lightdome.maps.images import read_image, write_image
from lightdome.opencl.device import Device


@pytest.mark.parametrize("pixels", ["centres", "areas"])
def test_the_image_is_that_of_the_library(run_here: Script, tmp_path: Path, device: Device, pixels: str) -> None:
    radiance = stiff_radiance(8, 16)
    write_image(tmp_path / "map.pfm", radiance)
    sphere = ("--resolution", 9, "--albedo", 0.5, "--pixels", pixels)
    result = run_here("exact", "--map", tmp_path / "map.pfm", *sphere, "--format", "exr", "--out", tmp_path / "out")
    assert result.returncode == 0, result.stderr
    assert f"wrote {tmp_path}/out/exact_{pixels}.exr" in result.stdout
    expected = exact(device, EnvironmentMap(radiance), 9, 0.5, pixels)
    np.testing.assert_array_equal(read_image(tmp_path / "out" / f"exact_{pixels}.exr"), expected)
    record = settings.read(tmp_path / "out" / settings.NAME)
    assert record is not None
    assert list(record["files"]) == [f"exact_{pixels}.exr"]
    assert record["options"]["pixels"] == pixels


def test_the_default_is_centres_in_every_format_of_the_parts(run_here: Script, tmp_path: Path) -> None:
    write_image(tmp_path / "map.pfm", stiff_radiance(8, 16))
    run_here("exact", "--map", tmp_path / "map.pfm", "--resolution", 9, "--out", tmp_path / "out")
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "settings.json",
        *(f"exact_centres.{name}" for name in ("pfm", "ppm", "png")),
    }
