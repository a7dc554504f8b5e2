"""The engine's answers are what the library computes, and the commands that a page shows give the same."""

from __future__ import annotations

import json
import shlex
from pathlib import Path

import numpy as np
import pytest
from helpers import Script
from lightdome.errors import LightdomeError
from lightdome.evaluation.metrics import relative_rmse
from lightdome.fresnel import fresnel, summarise
from lightdome.lighting.exact import exact
from lightdome.lighting.lights import Lights
from lightdome.lighting.shade import shade
from lightdome.maps.envmap import EnvironmentMap
from lightdome.maps.images import read_image, write_image
from lightdome.maps.rotation import rotation_matrix
from lightdome.opencl.device import Device
from lightdome.rendering.per_pixel import render
from lightdome.sampling.distribution import build_distribution
from lightdome.viewer.engine import Engine, Kept, Sent
from lightdome.viewer.messages import METHODS, MOST, Setting, halved, packed, parse_setting
from lightdome.viewer.reflectance import reflectance
from lightdome.viewer.shell import commands, together
from lightdome.viewer.upload import Checker

WISH = {
    "map": 0,
    "method": "shared",
    "sequence": "sobol",
    "count": 64,
    "seed": 3,
    "yaw": 0,
    "pitch": 0,
    "roll": 0,
    "albedo": 1,
    "resolution": 31,
}


def wish(**values: object) -> Setting:
    return parse_setting({**WISH, **values}, 1)


def unpacked(answer: bytes) -> tuple[dict[str, object], dict[str, np.ndarray]]:
    """Header and arrays of an answer, unpacked as the page does it."""
    begin = 4 + int.from_bytes(answer[:4], "little")
    header = json.loads(answer[4:begin])
    arrays = {}
    for name, of in header["arrays"].items():
        assert of["offset"] % 4 == 0
        data = answer[begin + of["offset"] :][: of["bytes"]]
        arrays[name] = np.frombuffer(data, of["type"]).reshape(of["shape"]) * np.float32(of["scale"])
    return header, arrays


@pytest.fixture(scope="module")
def envmap() -> EnvironmentMap:
    radiance = np.random.default_rng(5).gamma(0.3, 1, (16, 32, 3)).astype(np.float32)
    radiance[3, 7] = 40
    return EnvironmentMap(radiance)


@pytest.fixture
def engine(device: Device, envmap: EnvironmentMap) -> Engine:
    return Engine(device, [("map", "map.pfm", envmap)])


ANGLES = {"yaw": 30, "pitch": -20, "roll": 10}


def test_lights_and_the_exact_image_turn_together(engine: Engine, device: Device, envmap: EnvironmentMap) -> None:
    sent = Sent()
    header, arrays = unpacked(engine.frame(wish(**ANGLES), sent))
    lights = Lights.of(build_distribution(device, envmap).sample(64, 3, "sobol"))
    image = shade(device, lights.rotated(30, -20, 10), resolution=31)
    np.testing.assert_array_equal(arrays["image"], image)
    np.testing.assert_array_equal(arrays["direction"], lights.direction)
    assert not header["is_exact"]
    answers = [unpacked(answer) for answer in engine.rest(wish(**ANGLES), sent) if answer]
    (header, arrays), (followed, _) = answers
    assert header["numbers"]["rmse"] == relative_rmse(image, arrays["reference"])
    # A turn by whole columns gives exactly the library's map; for any other, the library resamples.
    assert relative_rmse(arrays["reference"], exact(device, envmap.rotated(30, -20, 10), 31)) < 0.05
    assert followed["counts"][1] == 64
    assert followed["rmse"][1] == pytest.approx(header["numbers"]["rmse"], rel=1e-5)
    assert followed["slope"] < -0.5


def test_a_turn_by_whole_columns_is_that_of_rotated(engine: Engine, device: Device, envmap: EnvironmentMap) -> None:
    sent = Sent()
    engine.frame(wish(yaw=90), sent)
    (_, arrays), _ = (unpacked(answer) for answer in engine.rest(wish(yaw=90), sent) if answer)
    assert relative_rmse(arrays["reference"], exact(device, envmap.rotated(90), 31)) < 1e-6


@pytest.mark.parametrize("method", ["light", "bsdf", "mis", "product"])
def test_estimators_see_the_turned_map(engine: Engine, device: Device, envmap: EnvironmentMap, method: str) -> None:
    turned = envmap.rotated(*ANGLES.values())
    setting, sent = wish(method=method, count=4, **ANGLES), Sent()
    _, arrays = unpacked(engine.frame(setting, sent))
    ((_, image),) = render(build_distribution(device, turned), [4], 31, 1.0, 3, method, "sobol")
    np.testing.assert_array_equal(arrays["image"], image)
    _, arrays = unpacked(next(answer for answer in engine.rest(setting, sent) if answer))
    np.testing.assert_array_equal(arrays["reference"], exact(device, turned, 31, pixels=setting.pixels))


@pytest.mark.parametrize("method", METHODS)
def test_the_approximation_is_near_the_exact_image(engine: Engine, method: str) -> None:
    setting, sent = wish(method=method, count=4, resolution=33, **ANGLES), Sent()
    header, _ = unpacked(engine.frame(setting, sent))
    later, _ = unpacked(next(answer for answer in engine.rest(setting, sent) if answer))
    brightest = later["numbers"]["brightest"]
    assert header["numbers"]["brightest"] == pytest.approx(brightest, rel=0.05)


def test_a_moving_picture_is_half_as_large(engine: Engine) -> None:
    moving, resting = (len(engine.frame(wish(resolution=255, moving=moves), Sent())) for moves in (True, False))
    assert moving < 0.6 * resting


def test_nothing_is_sent_twice(engine: Engine) -> None:
    sent = Sent()
    engine.frame(wish(), sent)
    list(engine.rest(wish(), sent))
    _, arrays = unpacked(engine.frame(wish(albedo=0.5), sent))
    assert set(arrays) == {"image"}
    assert not [answer for answer in engine.rest(wish(albedo=0.5), sent) if answer]


def test_cached_images_stay_below_their_limit() -> None:
    kept = Kept(100)
    for n in range(50):
        kept.put(n, np.zeros(10, np.float32))
    assert kept.bytes <= 100
    assert kept.get(49) is not None
    assert kept.get(0) is None


def test_halved_values_keep_their_range() -> None:
    for peak in 1e-30, 1.0, 3e38:
        values = np.array([peak, peak / 1000, 0], np.float32)
        half, scale = halved(values)
        np.testing.assert_allclose(half.astype(np.float64) * scale, values, rtol=1e-3)
    assert packed({}, {"a": halved(np.zeros((2, 2), np.float32))})


@pytest.mark.parametrize(
    "wrong",
    [
        {"count": 0},
        {"count": MOST["shared"] + 1},
        {"count": 1.5},
        {"count": True},
        {"seed": -1},
        {"map": 1},
        {"yaw": float("nan")},
        {"pitch": "0"},
        {"roll": None},
        {"resolution": 4096},
        {"albedo": -1},
        {"method": "exec"},
        {"sequence": "x"},
        {"method": "mis", "sequence": "r2"},
        {"method": ["mis"]},
    ],
)
def test_wishes_out_of_range_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(LightdomeError):
        wish(**wrong)


def test_incomplete_wishes_are_refused() -> None:
    for name in WISH:
        with pytest.raises(LightdomeError, match=f"{name} is missing"):
            parse_setting({key: value for key, value in WISH.items() if key != name}, 1)


def test_reflectances_match_the_library() -> None:
    told = reflectance(1.5)
    assert told["summary"]["brewster_entering_deg"] == summarise(1.5).brewster_entering_deg
    curve = told["curves"]["leaving"]
    p, s = fresnel(np.radians(np.clip(curve["degrees"], 0, 90)), 1.5, 1.0)
    np.testing.assert_allclose(curve["p"], p, atol=1e-12)
    np.testing.assert_allclose(curve["s"], s, atol=1e-12)
    assert np.isclose(curve["degrees"], summarise(1.5).critical_leaving_deg).any()
    for wrong in 0.5, 5, "1.4", None, float("nan"):
        with pytest.raises(LightdomeError):
            reflectance(wrong)


def test_a_black_map_has_no_samples_and_causes_no_error(device: Device) -> None:
    engine = Engine(device, [("black", "black.pfm", EnvironmentMap(np.zeros((4, 8, 3), np.float32)))])
    with pytest.raises(LightdomeError, match="black"):
        engine.frame(wish(), Sent())
    header, arrays = unpacked(engine.frame(wish(method="mis", count=1), Sent()))
    assert header["numbers"]["rmse"] is None
    assert not arrays["image"].any()


@pytest.mark.slow
def test_an_image_is_checked(device: Device, envmap: EnvironmentMap, tmp_path: Path) -> None:
    write_image(tmp_path / "image.exr", exact(device, envmap, 63)[::-1])
    checker = Checker(device, [envmap])
    header, arrays = unpacked(checker.checked({"suffix": ".exr", "map": "0"}, (tmp_path / "image.exr").read_bytes()))
    assert header["agrees"] is False
    assert "upside down" in header["verdict"] or "mirrored" in header["verdict"]
    assert arrays["image"].shape == arrays["reference"].shape
    huge = b"PF\n3000 3000\n-1.0\n"
    with pytest.raises(LightdomeError, match="the file") as refused:
        checker.checked({"suffix": ".pfm"}, huge)
    assert "/" not in str(refused.value).replace("no .", "")


@pytest.mark.parametrize("angles", [(10, 20, 30), (0, 90, 0), (-170, -60, 100)])
def test_a_command_line_holds_both_turns(angles: tuple[float, float, float]) -> None:
    found = together((40, 0, 0), angles)
    expected = rotation_matrix(*angles) @ rotation_matrix(40)
    np.testing.assert_allclose(rotation_matrix(*found), expected, atol=1e-7)
    lines, _ = commands(wish(method="mis", count=2, yaw=5), "map.exr --layer sky --rotate 40")
    assert "--map map.exr --layer sky --rotate 45 0 0 " in lines[0]


@pytest.mark.parametrize("values", [{}, {"method": "mis", "count": 2, "yaw": 45}])
def test_commands_make_the_same_image(
    engine: Engine, run_here: Script, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, values: dict[str, object]
) -> None:
    monkeypatch.chdir(tmp_path)
    write_image(tmp_path / "map.pfm", engine.scenes[0].envmap.radiance)
    setting = wish(**values)
    lines, _ = commands(setting, "map.pfm")
    modules = {"sample": "part2_sample", "shade": "part3_shade", "render": "part4_pbrt"}
    for line in lines:
        program, command, *words = shlex.split(line)
        assert program == "lightdome"
        run = run_here(modules[command], *words)
        assert run.returncode == 0, run.stderr
    (made,) = tmp_path.glob("out/part[34]/sphere_*.pfm")
    _, arrays = unpacked(engine.frame(setting, Sent()))
    np.testing.assert_array_equal(read_image(made), arrays["image"])
