"""``lightdome info``: verdicts first as text, everything as JSON, and one bad map does not stop the others."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from helpers import ROOT, stiff_radiance
from lightdome import console
from lightdome.commands import info
from lightdome.maps import analyse, convert
from lightdome.maps.envmap import EnvironmentMap
from lightdome.maps.images import read_image, write_image

DEFAULT = ROOT / "data" / "default.exr"


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> object:
    """Run the command with arguments; returns its exit status, output and errors."""

    def run(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["lightdome info", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            console.run(info.main)
        return (ended.value.code, *capsys.readouterr())

    return run


@pytest.fixture
def bad(tmp_path: Path) -> Path:
    radiance = stiff_radiance(8, 16)
    radiance[2, 3, 1], radiance[4, 5] = -1, np.nan
    write_image(tmp_path / "bad.pfm", radiance)
    return tmp_path / "bad.pfm"


def test_the_text_begins_with_the_verdicts(run: object, bad: Path) -> None:
    status, said, errors = run(DEFAULT, bad)
    assert (status, errors) == (0, "")
    first, second = said.split("\n\n")
    lines = first.splitlines()
    assert lines[0] == f"{DEFAULT}: 1024 x 512, OpenEXR, half, latlong"
    assert lines[1].split()[:3] == ["clipping", "not", "clipped:"]
    assert "azimuth 118.1, elevation 24.3 degrees, radius 1.31 degrees, 21.3 % of the light" in lines[2]
    assert lines[3].split() == ["bad", "pixels", "none"]
    assert "1 NaN, 1 negative" in second
    assert all(len(line) < 140 for line in said.splitlines())


def test_json_is_the_analysis_in_full(run: object, bad: Path) -> None:
    status, said, errors = run(DEFAULT, "--json")
    assert (status, errors) == (0, "")
    expected = json.loads(json.dumps(analyse(DEFAULT).to_dict()))
    assert json.loads(said) == {"file": str(DEFAULT), **expected}
    status, said, _ = run(DEFAULT, bad, "--json")
    assert [entry["nan_pixels"] for entry in json.loads(said)] == [0, 1]
    assert status == 0


def test_black_and_odd_maps_are_analysed_too(run: object, tmp_path: Path) -> None:
    write_image(tmp_path / "black.pfm", np.zeros((4, 4, 3), np.float32))
    status, said, _ = run(tmp_path / "black.pfm")
    assert status == 0
    assert "no sun: there is no light" in said
    assert "4 x 4, not 2:1" in said
    json.loads(run(tmp_path / "black.pfm", "--json")[1], parse_constant=pytest.fail)


def test_one_bad_file_does_not_stop_the_others(run: object, tmp_path: Path, bad: Path) -> None:
    status, said, errors = run(tmp_path / "none.exr", bad, "--json")
    assert status == 1
    assert errors == f"lightdome info: cannot read {tmp_path / 'none.exr'}: No such file or directory\n"
    assert [entry["file"] for entry in json.loads(said)] == [str(bad)]
    status, said, errors = run(tmp_path / "none.exr", "--json")
    assert (status, said, len(errors.splitlines())) == (1, "", 1)


def test_layer_and_flip_work_as_for_reading(run: object, bad: Path) -> None:
    normal, flipped = (json.loads(run(bad, "--json", *more)[1]) for more in ((), ("--flip",)))
    up, down = "irradiance_up_rgb_radiance_sr", "irradiance_down_rgb_radiance_sr"
    assert flipped[up] == pytest.approx(normal[down])
    assert "layers" in run(bad, "--layer", "side")[2]


@pytest.mark.slow
def test_a_turned_map_is_analysed_as_turned(run: object, tmp_path: Path) -> None:
    expected = EnvironmentMap.read(DEFAULT, convention="cycles").mirrored().rotated(90)
    turn = ("--convention", "cycles", "--mirror", "--rotate", "90")
    status, said, _ = run(DEFAULT, "--json", *turn, "--split-sun", tmp_path)
    assert status == 0
    told, wanted = json.loads(said), json.loads(json.dumps(analyse(expected).to_dict()))
    for name in ("sun", "irradiance_plus_x_rgb_radiance_sr", "mean_direction_azimuth_degrees"):
        assert told[name] == wanted[name], name
    sun, rest = (read_image(tmp_path / f"default_{name}.exr") for name in ("sun", "rest"))
    np.testing.assert_allclose(sun + rest, expected.radiance, rtol=1e-6)
    status, _, errors = run(DEFAULT, "--rotate", "0", "20", "0")
    assert status == 1
    assert "can only turn by whole columns" in errors
    assert "lightdome convert" in errors


@pytest.mark.slow
def test_the_sun_is_split_off(run: object, tmp_path: Path, bad: Path) -> None:
    folder = tmp_path / "split"
    status, said, errors = run(DEFAULT, bad, "--split-sun", folder)
    assert status == 1
    assert errors.count("\n") == 1
    assert f"{bad}: 2 bad pixels" in errors
    assert f"wrote {folder / 'default_sun.exr'}" in said
    sun, rest = (read_image(folder / f"default_{name}.exr") for name in ("sun", "rest"))
    np.testing.assert_allclose(sun + rest, read_image(DEFAULT), rtol=1e-6)
    assert 100 < np.count_nonzero(sun.any(axis=2)) < 1000
    _, _, errors = run(DEFAULT, tmp_path / "default.exr", "--split-sun", folder)
    assert "different names" in errors


@pytest.mark.slow
def test_another_projection_is_resampled_and_reported(run: object, tmp_path: Path) -> None:
    """By detection or by name; the light stays where it was."""
    envmap = EnvironmentMap.read(DEFAULT)
    write_image(tmp_path / "cross.pfm", convert(envmap.radiance, "latlong", "cube-cross", 64))
    write_image(tmp_path / "probe.pfm", convert(envmap.radiance, "latlong", "angular", 128))
    expected = analyse(envmap)
    for name, options in (("cross", ()), ("probe", ()), ("probe", ("--projection", "angular"))):
        status, said, _ = run(tmp_path / f"{name}.pfm", "--json", *options)
        assert status == 0
        found = json.loads(said)
        assert found["projection"] == f"{'cube-cross' if name == 'cross' else 'angular'}, resampled to latlong"
        assert found["flux_rgb_radiance_sr"] == pytest.approx(expected.flux_rgb_radiance_sr, rel=1e-5)
        assert found["mean_direction_azimuth_degrees"] == pytest.approx(
            expected.mean_direction_azimuth_degrees, abs=0.5
        )
    write_image(tmp_path / "full.pfm", np.ones((16, 12, 3), np.float32))
    (note,) = (note for note in json.loads(run(tmp_path / "full.pfm", "--json")[1])["notes"] if "cube-cross" in note)
    assert "corners are not black" in note
    status, _, errors = run(tmp_path / "probe.pfm", "--projection", "cube-cross")
    assert status == 1
    assert errors.count("\n") == 1
