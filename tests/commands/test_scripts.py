"""Parts 2 and 3 as a user runs them, and what they say when something is wrong."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
from helpers import Script, fails_in_one_line, stiff_radiance
from lightdome.maps.envmap import EnvironmentMap
from lightdome.maps.images import read_image, write_image
from lightdome.opencl.device import Device
from lightdome.sampling.distribution import build_distribution
from lightdome.sampling.samples import Samples


@pytest.fixture(scope="module")
def small_map(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("map") / "small map.pfm"
    write_image(path, stiff_radiance(16, 32))
    return path


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def test_parts_2_and_3_end_to_end(script: Script, small_map: Path, tmp_path: Path) -> None:
    two, three = tmp_path / "two", tmp_path / "deep" / "three"
    result = script("part2_sample", "--map", small_map, "--counts", 7, 3, "--marker", 1, "--out", two)
    assert result.returncode == 0, result.stderr
    assert "device: " in result.stdout
    suffixes = ("pfm", "ppm", "png")
    assert names(two) == {f"em_{n}.{s}" for n in (3, 7) for s in suffixes} | {
        "samples_3.npz",
        "samples_7.npz",
        "settings.json",
    }

    samples = Samples.load(two / "samples_7.npz")
    marked, plain = read_image(two / "em_7.pfm"), read_image(small_map)
    blue = (marked == (0, 0, 1)).all(axis=2)
    assert set(map(tuple, np.argwhere(blue)[:, ::-1])) == set(map(tuple, samples.pixel))
    np.testing.assert_array_equal(marked[~blue], plain[~blue])

    result = script("part3_shade", two / "samples_3.npz", two / "samples_7.npz", "--resolution", 20, "--out", three)
    assert result.returncode == 0, result.stderr
    assert names(three) == {f"sphere_{n}.{s}" for n in (3, 7) for s in suffixes} | {"settings.json"}
    assert read_image(three / "sphere_7.pfm").shape == (20, 20, 3)


def test_a_pfm_and_an_exr_of_the_same_map_give_the_same_result(
    run_here: Script, small_map: Path, tmp_path: Path
) -> None:
    exr = tmp_path / "map.exr"
    write_image(exr, read_image(small_map))
    for path in (small_map, exr):
        out = tmp_path / path.suffix[1:]
        assert run_here("part2_sample", "--map", path, "--counts", 50, "--out", out).returncode == 0
    for name in ("em_50.pfm", "em_50.ppm"):
        assert (tmp_path / "pfm" / name).read_bytes() == (tmp_path / "exr" / name).read_bytes()
    pfm, exr_samples = (Samples.load(tmp_path / kind / "samples_50.npz") for kind in ("pfm", "exr"))
    np.testing.assert_array_equal(pfm.pixel, exr_samples.pixel)
    np.testing.assert_array_equal(pfm.probability, exr_samples.probability)


def test_a_map_that_is_not_two_to_one_is_used_with_a_note(run_here: Script, tmp_path: Path) -> None:
    write_image(tmp_path / "odd.exr", stiff_radiance(9, 11))
    result = run_here("part2_sample", "--map", tmp_path / "odd.exr", "--counts", 4, "--out", tmp_path / "out")
    assert result.returncode == 0
    assert "note: the map is 11 x 9" in result.stderr


def test_bad_pixels_are_refused_unless_sanitised(run_here: Script, tmp_path: Path) -> None:
    radiance = stiff_radiance(8, 16)
    radiance[4, 9] = -1
    radiance[5, 2, 1] = np.nan
    write_image(tmp_path / "bad.pfm", radiance)
    arguments = ("part2_sample", "--map", tmp_path / "bad.pfm", "--counts", 4, "--out", tmp_path / "out")
    fails_in_one_line(run_here(*arguments), "2 bad pixels", "x = 9, y = 4", "--sanitize")
    for way in (["--sanitize"], ["--sanitize", "--samples-only"]):
        result = run_here(*arguments, *way)
        assert result.returncode == 0, result.stderr
        assert "2 bad pixels were replaced (1 NaN by 0, 1 negative by 0)" in result.stderr
        assert "% of the map's flux" in result.stderr
    assert run_here(*arguments, "--sanitize", "white").returncode == 2


def test_a_black_map_has_nothing_to_sample(run_here: Script, tmp_path: Path) -> None:
    write_image(tmp_path / "black.pfm", np.zeros((8, 16, 3), np.float32))
    out = tmp_path / "out"
    fails_in_one_line(run_here("part2_sample", "--map", tmp_path / "black.pfm", "--out", out), "black everywhere")
    assert names(out) == set()


@pytest.mark.parametrize("script_name", ["part2_sample", "part3_shade"])
def test_missing_and_damaged_files_give_one_line(run_here: Script, tmp_path: Path, script_name: str) -> None:
    option = ("--map",) if script_name == "part2_sample" else ()
    broken = tmp_path / "broken.exr"
    broken.write_bytes(b"v/1\x01 then nothing")
    for path in (tmp_path / "missing.exr", broken, tmp_path, tmp_path / "two\nlines.exr"):
        result = run_here(script_name, *option, path, "--out", tmp_path / "out")
        fails_in_one_line(result, tmp_path.name)


def test_an_unwritable_output_folder_gives_one_line(run_here: Script, small_map: Path, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for out in (tmp_path / "file", tmp_path / "file" / "below", "/proc/nowhere"):
        result = run_here("part2_sample", "--map", small_map, "--counts", 4, "--out", out)
        fails_in_one_line(result, "--out")


def test_two_sets_of_one_size_are_refused(run_here: Script, small_map: Path, tmp_path: Path) -> None:
    run_here("part2_sample", "--map", small_map, "--counts", 4, "--out", tmp_path)
    path = tmp_path / "samples_4.npz"
    fails_in_one_line(run_here("part3_shade", path, path, "--out", tmp_path / "out"), "4 samples")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "arguments",
    [
        ("part2_sample", "--counts", "0"),
        ("part2_sample", "--counts", "-4"),
        ("part2_sample", "--counts", "many"),
        ("part2_sample", "--seed", "-1"),
        ("part2_sample", "--gamma", "0"),
        ("part2_sample", "--exposure", "nan"),
        ("part2_sample", "--sequence", "magic"),
        ("part3_shade",),
        ("part3_shade", "x.npz", "--albedo", "-1"),
        ("part3_shade", "x.npz", "--resolution", "0"),
        ("part3_shade", "x.npz", "--unknown"),
    ],
)
def test_a_wrong_command_line_exits_with_2(run_here: Script, arguments: tuple[str, ...]) -> None:
    result = run_here(*arguments)
    assert result.returncode == 2
    assert "Traceback" not in result.stderr


def test_an_unknown_device_gives_one_line(script: Script, small_map: Path, tmp_path: Path) -> None:
    result = script("part2_sample", "--map", small_map, "--device", "Voodoo 2", "--out", tmp_path)
    fails_in_one_line(result, "Voodoo 2")
    result = script("part2_sample", "--map", small_map, "--out", tmp_path, PYOPENCL_CTX="Voodoo 3")
    fails_in_one_line(result, "Voodoo 3")


BIG, LONG_NUMBER = 2**31 - 1, "9" * 5000
EXTREMES = [
    ("part1_fresnel", ("--eta", "1e-308"), 0),
    ("part1_fresnel", ("--eta", "5e-324"), 1),
    ("part1_fresnel", ("--eta", "1.7976931348623157e308"), 0),
    ("part2_sample", ("--counts", BIG), 1),
    ("part2_sample", ("--counts", BIG, "--samples-only"), 1),
    ("part2_sample", ("--counts", LONG_NUMBER), 2),
    ("part2_sample", ("--counts", 3, "--marker", BIG, "--gamma", "5e-324", "--exposure", "1e308"), 0),
    ("part2_sample", ("--counts", 3, "--marker", 3000, "--gamma", "1e308", "--exposure", "5e-324"), 0),
    ("part2_sample", ("--counts", 3, "--seed", 2**64 - 1, "--samples-only"), 0),
    ("part2_sample", ("--counts", 3, "--seed", "9" * 400), 2),
    ("part2_sample", ("--counts", 3, "--seed", 2**64, "--samples-only"), 2),
    ("part2_sample", ("--counts", 3, "--device", LONG_NUMBER), 1),
    ("part3_shade", ("--resolution", BIG), 1),
    ("part3_shade", ("--resolution", 16385), 1),
    ("part3_shade", ("--resolution", 1, "--albedo", "5e-324", "--exposure", "1e308", "--gamma", "5e-324"), 0),
    ("part3_shade", ("--resolution", 9, "--albedo", "3.4e38", "--exposure", "5e-324", "--gamma", "1e308"), 0),
    ("part3_shade", ("--albedo", "1e308"), 1),
    ("part4_pbrt", ("--spp", LONG_NUMBER), 2),
    ("part4_pbrt", ("--spp", 1, "--resolution", BIG), 1),
    ("part4_pbrt", ("--spp", 1, "--resolution", 1, "--seed", 2**64 - 1), 0),
    ("part4_pbrt", ("--spp", 1, "--resolution", 9, "--albedo", "1e308"), 1),
    ("bench", ("--counts", LONG_NUMBER), 2),
    ("bench", ("--methods", "median-cut", "--counts", 2**27, "--resolution", 9, "--seeds", 1, "--repeats", 1), 1),
    ("bench", ("--seeds", BIG), 2),
    ("bench", ("--repeats", BIG), 2),
    ("bench", ("--resolution", BIG), 1),
]


@pytest.mark.parametrize(
    ("name", "arguments", "status"), EXTREMES, ids=[f"{n} {' '.join(map(str, a))[:40]}" for n, a, _ in EXTREMES]
)
def test_an_extreme_option_ends_soon_and_in_one_line(
    run_here: Script,
    device: Device,
    small_map: Path,
    tmp_path: Path,
    name: str,
    arguments: tuple[object, ...],
    status: int,
) -> None:
    if name == "part3_shade":
        samples = build_distribution(device, EnvironmentMap.read(small_map)).sample(3)
        samples.save(tmp_path / "samples.npz")
        arguments = (tmp_path / "samples.npz", *arguments)
    elif name != "part1_fresnel":
        arguments = ("--map", small_map, *arguments)
    start = time.monotonic()
    result = run_here(name, *arguments, "--out", tmp_path / "out")  # a warning would raise an exception
    assert time.monotonic() - start < 60  # they take a second, but the machine may be busy
    assert result.returncode == status
    assert "Traceback" not in result.stderr
    if result.returncode == 1:
        fails_in_one_line(result)


def test_explain_says_what_was_skipped(run_here: Script, device: Device, tmp_path: Path) -> None:
    sampled = run_here("part2_sample", "--counts", 4, "--explain", "--out", tmp_path / "two")
    assert sampled.returncode == 0, sampled.stderr
    assert "built 3 of" in sampled.stdout
    assert "skipped: guide tables; 4 samples" in sampled.stdout
    shaded = run_here("part3_shade", tmp_path / "two" / "samples_4.npz", "--explain", "--out", tmp_path / "three")
    assert f"4 samples: {'used' if device.is_gpu else 'skipped'}: brute force over pairs" in shaded.stdout
    assert "skipped:" not in run_here("part3_shade", tmp_path / "two" / "samples_4.npz", "--out", tmp_path / "x").stdout
