"""``lightdome lights``: the lights of each method in the file, and what the command says when something is wrong."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from helpers import LONG, fails_in_one_line, stiff_radiance
from lightdome.commands import lights as command
from lightdome.errors import LightdomeError
from lightdome.lighting.light_files import write_lights
from lightdome.lighting.lights import Lights
from lightdome.lighting.median_cut import median_cut
from lightdome.maps.analysis import split_sun
from lightdome.maps.envmap import EnvironmentMap
from lightdome.maps.geometry import solid_angles
from lightdome.maps.images import write_image
from lightdome.names import LIGHT_FORMATS, LIGHT_METHODS, SEQUENCES
from lightdome.opencl.device import Device
from lightdome.sampling.distribution import build_distribution


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Path]:
    """Run the command on a map and return the file that it wrote."""

    def of(envmap: np.ndarray, *options: object, out: str = "lights.json") -> Path:
        write_image(tmp_path / "map.pfm", envmap)
        arguments = ["lightdome lights", *options, tmp_path / "map.pfm", "--out", tmp_path / out]
        monkeypatch.setattr(sys, "argv", list(map(str, arguments)))
        command.main()
        return tmp_path / out

    return of


def with_sun() -> np.ndarray:
    radiance = np.full((64, 128, 3), 0.2, np.float32)
    radiance[20:22, 30:32] = (3000, 2500, 2000)
    return radiance


def lights_in(path: Path) -> np.ndarray:
    return np.array(
        [[*light["to_light"], *light["irradiance_rgb"]] for light in json.loads(path.read_text())["lights"]]
    )


def assert_lights(path: Path, lights: Lights) -> None:
    found = lights_in(path)
    np.testing.assert_array_equal(found[:, :3].astype(np.float32), lights.direction)
    np.testing.assert_allclose(found[:, 3:], lights.flux, rtol=1e-8)


def test_explain_says_what_was_skipped(run: Callable[..., Path], capsys: pytest.CaptureFixture[str]) -> None:
    plain = run(with_sun(), "--count", 3).read_bytes()
    assert "skipped: " not in capsys.readouterr().out
    assert run(with_sun(), "--count", 3, "--explain").read_bytes() == plain
    said = capsys.readouterr().out
    assert "3 lights: skipped: scaling of weights; " in said
    assert "\nbuilt " in said


@pytest.mark.parametrize("method", LIGHT_METHODS)
def test_all_lights_together_have_the_maps_flux(run: Callable[..., Path], method: str) -> None:
    radiance = with_sun()
    found = lights_in(run(radiance, "--method", method, "--count", 9))
    assert len(found) == 9
    flux = np.einsum("h,hwc->c", solid_angles(64, 128), radiance.astype(np.float64))
    sampled = method in SEQUENCES  # by luminance, so that only the sum of the channels is kept
    of = (lambda values: values.sum()) if sampled else np.asarray
    np.testing.assert_allclose(of(found[:, 3:].sum(axis=0)), of(flux), rtol=1e-5)


def test_median_cut_is_the_default_with_16_lights(run: Callable[..., Path], device: Device) -> None:
    radiance = stiff_radiance(16, 32)
    assert_lights(run(radiance), median_cut(build_distribution(device, EnvironmentMap(radiance)), 16))


def test_samples_follow_their_seed(run: Callable[..., Path], device: Device) -> None:
    radiance = stiff_radiance(16, 32)
    distribution = build_distribution(device, EnvironmentMap(radiance))
    for seed in (0, 9):
        samples = distribution.sample(5, seed, "sobol")
        assert_lights(run(radiance, "--method", "sobol", "--count", 5, "--seed", seed), Lights.of(samples))


def test_the_sun_is_the_first_light_and_the_rest_is_cut(run: Callable[..., Path], device: Device) -> None:
    radiance = with_sun()
    split = split_sun(EnvironmentMap(radiance))
    rest = median_cut(build_distribution(device, split.rest), 4)
    direction = np.concatenate([[split.sun.direction_xyz], rest.direction])
    flux = np.concatenate([[split.sun.flux_rgb_radiance_sr], rest.flux])
    assert_lights(run(radiance, "--method", "sun+median-cut", "--count", 5), Lights(direction, flux))


@pytest.mark.parametrize("name", LIGHT_FORMATS)
def test_the_format_is_that_of_the_suffix_or_of_the_option(
    run: Callable[..., Path], device: Device, tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    radiance = stiff_radiance(8, 16)
    expected = tmp_path / "expected"
    write_lights(expected, median_cut(build_distribution(device, EnvironmentMap(radiance)), 3), name)
    for options, out in (((), f"lights{LIGHT_FORMATS[name]}"), (("--format", name), "lights.txt")):
        path = run(radiance, "--count", 3, *options, out=out)
        assert path.read_bytes() == expected.read_bytes()
        assert f"wrote {path}: 3 lights by median-cut, as {name}\n" in capsys.readouterr().out


def test_map_and_device_options_take_effect(run: Callable[..., Path], device: Device) -> None:
    radiance = stiff_radiance(8, 16)
    flipped = EnvironmentMap(np.ascontiguousarray(radiance[::-1]))
    assert_lights(run(radiance, "--flip", "--count", 3), median_cut(build_distribution(device, flipped), 3))
    moved = EnvironmentMap(radiance).to_convention("cycles").radiance
    expected = median_cut(build_distribution(device, EnvironmentMap(radiance)), 3)
    assert_lights(run(moved, "--convention", "cycles", "--count", 3), expected)
    with pytest.raises(LightdomeError, match="no OpenCL device matches 'Voodoo 2'"):
        run(radiance, "--device", "Voodoo 2")


ONE_PIXEL = np.zeros((8, 16, 3), np.float32)
ONE_PIXEL[2, 3] = 1


@pytest.mark.parametrize(
    ("radiance", "options", "words"),
    [
        (np.zeros((8, 16, 3), np.float32), (), "black everywhere"),
        (np.zeros((8, 16, 3), np.float32), ("--method", "r2"), "black everywhere"),
        (ONE_PIXEL, ("--count", 2), "only 1 of the map's pixels have light.*--count"),
        (with_sun(), ("--method", "sun+median-cut", "--count", 1), "at least 2"),
        (np.where(with_sun() > 1, with_sun(), 0), ("--method", "sun+median-cut"), "no light but the sun"),
        (np.ones((8, 16, 3), np.float32), ("--method", "sun+median-cut"), "no sun"),
        (np.full((8, 16, 3), 3e38, np.float32), ("--format", "pbrt", "--count", 1), "scale the map down"),
    ],
)
def test_a_map_with_too_few_lights_is_refused(
    run: Callable[..., Path], tmp_path: Path, radiance: np.ndarray, options: tuple[object, ...], words: str
) -> None:
    with pytest.raises(LightdomeError, match=words) as refused:
        run(radiance, *options)
    assert "\n" not in str(refused.value)
    assert [path.name for path in tmp_path.iterdir()] == ["map.pfm"]


@pytest.mark.parametrize(("out", "words"), [("lights.max", "names no format"), ("nowhere/lights.csv", "no folder")])
def test_an_impossible_file_is_reported_before_any_work(run: Callable[..., Path], out: str, words: str) -> None:
    with pytest.raises(LightdomeError, match=words):
        run(ONE_PIXEL, "--device", "Voodoo 2", out=out)


@pytest.mark.parametrize(
    "options",
    [("--count", 0), ("--count", -1), ("--count", "many"), ("--format", "max"), ("--method", "magic"), ("--seed", -1)],
)
def test_a_wrong_command_line_exits_with_2(run: Callable[..., Path], options: tuple[object, ...]) -> None:
    with pytest.raises(SystemExit) as ended:
        run(ONE_PIXEL, *options)
    assert ended.value.code == 2


@pytest.mark.slow
def test_the_console_program_runs_it_and_reports_a_mistake_in_one_line(tmp_path: Path) -> None:
    words = [sys.executable, "-m", "lightdome", "lights", "missing.exr", "--out", "lights.csv"]
    result = subprocess.run(words, capture_output=True, text=True, timeout=LONG, cwd=tmp_path, env=dict(os.environ))
    fails_in_one_line(result, "missing.exr")
    assert result.stderr.startswith("lightdome lights: ")
