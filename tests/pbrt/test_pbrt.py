"""Part 4 with PBRT: the equal-area map, the scenes, and every way in which a program can fail."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from helpers import LONG, PYTHON_PROGRAM, command_line, fails_in_one_line
from lightdome.disc import disc_mask
from lightdome.errors import LightdomeError
from lightdome.lighting.exact import exact as exact_image
from lightdome.maps.envmap import EnvironmentMap
from lightdome.maps.images import read_image, write_image
from lightdome.pbrt.check import deviation
from lightdome.pbrt.equal_area import equal_area_side, to_equal_area
from lightdome.pbrt.run import Pbrt, find_pbrt, installed_port, render, render_scene
from lightdome.pbrt.scenes import Scene, scene_text, write_scenes


def with_stand_ins(test):
    """Mark a test that starts stand-ins for pbrt."""
    needs_posix = pytest.mark.skipif(os.name != "posix", reason="the stand-ins for pbrt are executable scripts")
    return pytest.mark.slow(needs_posix(test))


def square_to_sphere(x: float, y: float) -> tuple[float, float, float]:
    """Direction of the point (x, y) of the unit square, z up: PBR, 4th ed., 3.8.3, point by point."""
    u, v = 2 * x - 1, 2 * y - 1
    distance = 1 - (abs(u) + abs(v))
    r = 1 - abs(distance)
    phi = ((abs(v) - abs(u)) / r + 1 if r else 1.0) * math.pi / 4
    z = math.copysign(1 - r * r, distance)
    radius = r * math.sqrt(2 - r * r)
    return (
        math.copysign(math.cos(phi), u) * radius,
        math.copysign(math.sin(phi), v) * radius,
        z,
    )


def texel_directions(side: int) -> np.ndarray:
    centres = (np.arange(side) + 0.5) / side
    return np.array([[square_to_sphere(x, y) for x in centres] for y in centres])


def pixel_direction(x: float, y: float, width: int, height: int) -> np.ndarray:
    theta, phi = math.pi * (y + 0.5) / height, 2 * math.pi * (x + 0.5) / width
    return np.array([math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi), math.cos(theta)])


def pixel_centroid(x: int, y: int, width: int, height: int) -> np.ndarray:
    """The mean direction over a pixel's solid angle, which near a pole differs from that of its centre."""
    t0, t1 = math.pi * y / height, math.pi * (y + 1) / height
    p0, p1 = 2 * math.pi * x / width, 2 * math.pi * (x + 1) / width
    ring = (t1 - t0) / 2 - (math.sin(2 * t1) - math.sin(2 * t0)) / 4
    mean = np.array(
        [
            ring * (math.sin(p1) - math.sin(p0)),
            ring * (math.cos(p0) - math.cos(p1)),
            (p1 - p0) * (math.sin(t1) ** 2 - math.sin(t0) ** 2) / 2,
        ]
    )
    return mean / np.linalg.norm(mean)


def pixel_solid_angle(y: int, width: int, height: int) -> float:
    return 2 * math.pi / width * (math.cos(math.pi * y / height) - math.cos(math.pi * (y + 1) / height))


@pytest.mark.parametrize("shape", [(32, 64), (16, 30), (9, 14), (1, 1), (2, 3)])
def test_a_bright_pixel_keeps_its_flux_and_direction_in_the_equal_area_map(shape):
    height, width = shape
    side = equal_area_side(height, width)
    directions = texel_directions(side)
    rng = np.random.default_rng(3)
    places = {(0, 0), (height - 1, width - 1), (height // 2, width // 4)}
    places |= {(int(rng.integers(height)), int(rng.integers(width))) for _ in range(12)}
    for y, x in places:
        radiance = np.zeros((height, width, 3), np.float32)
        radiance[y, x] = (1e6, 1, 0)
        square = to_equal_area(radiance).astype(np.float64)
        flux = square.sum(axis=(0, 1)) * 4 * math.pi / side**2
        assert flux == pytest.approx(radiance[y, x] * pixel_solid_angle(y, width, height), rel=1e-6)
        if min(shape) < 9:
            continue
        mean = (square[..., :1] * directions).sum(axis=(0, 1))
        mean /= np.linalg.norm(mean)
        angle = math.acos(min(1, mean @ pixel_centroid(x, y, width, height)))
        assert angle < 0.7 * math.sqrt(4 * math.pi) / side  # half a texel's diagonal


def test_a_constant_map_stays_constant():
    square = to_equal_area(np.full((11, 22, 3), 7, np.float32))
    assert square.dtype == np.float32
    np.testing.assert_allclose(square, 7, rtol=1e-6)


def test_texels_inside_a_pixel_have_its_radiance():
    height, width, side = 6, 12, 128
    radiance = np.random.default_rng(5).random((height, width, 3)).astype(np.float32)
    square = to_equal_area(radiance, side)
    corners = texel_directions(2 * side)  # four points inside each texel tell which texels lie in one pixel
    theta = np.arccos(corners[..., 2].clip(-1, 1))
    phi = np.arctan2(corners[..., 1], corners[..., 0]) % (2 * math.pi)
    pixel = (theta / math.pi * height).astype(int) * width + (phi / (2 * math.pi) * width).astype(int)
    grid = pixel.reshape(side, 2, side, 2).swapaxes(1, 2).reshape(side, side, 4)
    inside = (grid == grid[..., :1]).all(axis=2)
    difference = np.abs(square - radiance.reshape(-1, 3)[grid[..., 0]])[inside].max(axis=1)
    # The rest are texels with a corner, beyond the four points, that a border clips.
    assert (difference < 1e-6).mean() > 0.9
    assert np.median(difference) < 1e-6


def test_the_side_of_the_square_must_be_even():
    with pytest.raises(LightdomeError, match="even"):
        to_equal_area(np.ones((2, 4, 3), np.float32), 5)


@pytest.mark.parametrize("version", [3, 4])
def test_a_scene_has_the_camera_and_light_of_the_conventions(version):
    text = scene_text(version, 16, 33, 0.25, seed=2**31 + 7)
    words = " ".join(text.split())
    for part in (
        "Scale -1 1 1 LookAt 0 0 10 0 0 0 0 1 0",
        'Camera "orthographic" "float screenwindow" [-1 1 -1 1]',
        '"integer xresolution" [33] "integer yresolution" [33]',
        '"integer pixelsamples" [16]',
        'PixelFilter "box"',
        "Rotate 90 1 0 0 Scale 1 1 -1 LightSource",
        "[0.25 0.25 0.25]",
        'Shape "sphere" "float radius" [1]',
    ):
        assert part in words
    assert ('"integer seed" [7]' in words) == (version == 4)
    assert ("WorldEnd" in words) == (version == 3)


def test_pbrt_4_renders_as_many_samples_as_asked_for():
    # Its zsobol sampler would round other numbers down to a power of two.
    assert 'Sampler "zsobol" "integer pixelsamples" [8]' in scene_text(4, 8)
    assert 'Sampler "halton" "integer pixelsamples" [10]' in scene_text(4, 10)


@pytest.mark.parametrize(
    ("spp", "resolution", "albedo", "words"),
    [(0, 8, 1, "samples per pixel"), (1, 0, 1, "resolution"), (1, 8, 1.5, "albedo"), (1, 8, math.nan, "albedo")],
)
def test_a_scene_that_pbrt_cannot_render_is_refused(spp, resolution, albedo, words):
    with pytest.raises(LightdomeError, match=words):
        scene_text(4, spp, resolution, albedo)


@pytest.mark.parametrize("peak", [1.0, 3e38, 1e-40])
def test_scenes_name_maps_beside_them_and_undo_their_scale(tmp_path, peak):
    radiance = np.random.default_rng(1).random((8, 16, 3)).astype(np.float32) * np.float32(peak)
    folder = tmp_path / 'it\'s a "folder"'
    folder.mkdir()
    scenes = write_scenes(folder, EnvironmentMap(radiance), [4, 2, 4], 16)
    assert sorted((s.version, s.spp) for s in scenes) == [(3, 2), (3, 4), (4, 2), (4, 4)]
    for scene in scenes:
        assert str(tmp_path) not in scene.path.read_text()
        assert ("# Multiply" in scene.path.read_text()) == (scene.exponent != 0)
    latlong = read_image(folder / "map_v3_latlong.pfm")
    np.testing.assert_array_equal(np.ldexp(latlong, scenes[0].exponent), radiance)
    assert 2**-31 < latlong.max() < 2**31
    square = read_image(folder / "map_v4_equalarea.exr").astype(np.float64)
    assert square.shape[0] == square.shape[1]
    weight = [pixel_solid_angle(y, 16, 8) / (4 * math.pi) for y in range(8)]
    mean = (latlong.astype(np.float64) * np.array(weight)[:, None, None]).sum(axis=(0, 1))
    np.testing.assert_allclose(square.mean(axis=(0, 1)), mean, rtol=1e-6)


@pytest.mark.parametrize("peak", [1.0, 1e-40])
def test_a_written_scene_holds_all_that_it_was_asked_for(tmp_path, peak):
    envmap = EnvironmentMap(np.full((4, 8, 3), peak, np.float32))
    scenes = write_scenes(tmp_path, envmap, [2, 5], resolution=9, albedo=0.25, seed=77)
    assert sorted((s.version, s.spp) for s in scenes) == [(3, 2), (3, 5), (4, 2), (4, 5)]
    for s in scenes:
        assert s.resolution == 9
        assert s.path.read_text() == scene_text(s.version, s.spp, 9, 0.25, seed=77, exponent=s.exponent)
        assert (s.exponent != 0) == (peak != 1)
    assert [s.version for s in write_scenes(tmp_path, envmap, [2], versions=[3])] == [3]


BANNER = "pbrt version 4 (built today)\nCopyright (c)\nSee the file LICENSE.txt"
PORT = "import sys; print('pbrt-r4 4.5.2' if sys.argv[1:] == ['--version'] else 'Usage: pbrt-r4 [OPTIONS]')\n"
ANSWER = f"import sys\nprint({BANNER!r}, flush=True)\nif len(sys.argv) == 1:\n    sys.exit(1)\n"


def stand_in(folder: Path, body: str, name: str = "pbrt") -> Path:
    """An executable Python script that stands in for pbrt."""
    path = folder / name
    path.write_text(PYTHON_PROGRAM + body)
    path.chmod(0o755)
    return path


@pytest.fixture
def scene(tmp_path) -> Scene:
    path = tmp_path / "scene.pbrt"
    path.write_text(scene_text(4, 2, 9))
    return Scene(path, 4, 2, 9)


@with_stand_ins
@pytest.mark.parametrize("folder", [True, False])
def test_a_program_is_found_by_its_file_or_folder(tmp_path, folder):
    program = stand_in(tmp_path, ANSWER)
    assert find_pbrt(tmp_path if folder else program) == Pbrt(program, 4)


@with_stand_ins
def test_a_program_is_found_on_path_else_where_it_was_installed(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    with pytest.raises(LightdomeError, match=r"no PBRT on PATH; install it \(cargo install pbrt-r4"):
        find_pbrt()
    installed_port().parent.mkdir(parents=True)
    port = stand_in(installed_port().parent, PORT, "pbrt-r4")
    assert find_pbrt() == Pbrt(port, 4, "pbrt-r4 4.5.2")
    other = stand_in(tmp_path, PORT.replace("r4 4.5.2", "r3 3.2.0"), "pbrt-r3")
    assert find_pbrt() == Pbrt(other, 3, "pbrt-r3 3.2.0")
    assert not find_pbrt().has_seed
    assert find_pbrt().image_suffix == ".exr"
    assert find_pbrt(stand_in(tmp_path, "print('pbrt version 3 (built today) [Detected 2 cores]')")).version == 3
    assert find_pbrt().path == tmp_path / "pbrt"


@with_stand_ins
@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("print('pbrt version 2.0.0 of today')", "PBRT version 2"),
        (
            "sys.exit('error: --path is missing\\nUsage: rs_pbrt --path <PATH>')",
            "is rs_pbrt, .* 8-bit .*cargo install pbrt-r4",
        ),
        ("print('usage: something else')", "usage: something else"),
        ("", "it said: nothing"),
        ("import os; os.abort()", "SIGABRT"),
        ("import time; time.sleep(60)", "within 0.5 s"),
    ],
)
def test_an_unknown_program_is_refused(tmp_path, body, message):
    with pytest.raises(LightdomeError, match=message):
        find_pbrt(stand_in(tmp_path, "import sys\n" + body), timeout=0.5 if "sleep" in body else LONG)


@with_stand_ins
def test_a_path_without_a_program_is_refused(tmp_path):
    with pytest.raises(LightdomeError, match="does not exist"):
        find_pbrt(tmp_path / "pbrt")
    with pytest.raises(LightdomeError, match="in the folder"):
        find_pbrt(tmp_path)
    plain = tmp_path / "plain"
    plain.write_bytes(b"\x7fELF")
    with pytest.raises(LightdomeError, match=f"{plain} is not executable; run chmod"):
        find_pbrt(plain)
    plain.chmod(0o755)
    with pytest.raises(LightdomeError, match="cannot start"):
        find_pbrt(plain)


@with_stand_ins
@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("print('\\x1b[1m\\x1b[31mError\\x1b[0m: a.pbrt:1:0: no such light'); sys.exit(1)", "said: Error: a.pbrt:1:0"),
        ("print('done')", "wrote no image; it said: done"),
        ("print('Rendering: [+++ ]\\r'); import os; os.kill(os.getpid(), 11)", "SIGSEGV.*said: nothing; try the scene"),
        (
            "open(sys.argv[sys.argv.index('--outfile') + 1], 'w').write('PF'); sys.exit(0)",
            r"^PBRT-v4 \(.*pbrt\) wrote an image that cannot be read \((?!.*/image.exr).*try the scene",
        ),
        ("import time; print('Rendering: [++  ]', flush=True); time.sleep(60)", "more than 0.4 s"),
    ],
)
def test_a_run_that_fails_says_how_in_one_line(tmp_path, scene, body, message):
    program = Pbrt(stand_in(tmp_path, ANSWER + body), 4)
    with pytest.raises(LightdomeError, match=message) as caught:
        render_scene(program, scene, timeout=0.4 if "sleep" in body else LONG)
    assert "\n" not in str(caught.value)


@with_stand_ins
def test_nothing_that_a_stopped_program_started_survives(tmp_path, scene):
    os.mkfifo(tmp_path / "pipe")
    program = tmp_path / "wrapper"
    program.write_text(f"#!/bin/sh\n(sleep 5; echo alive) > '{tmp_path}/pipe' &\nwait\n")
    program.chmod(0o755)
    with os.fdopen(os.open(tmp_path / "pipe", os.O_RDONLY | os.O_NONBLOCK)) as pipe:
        with pytest.raises(LightdomeError, match="was stopped"):
            render_scene(Pbrt(program, 4), scene, timeout=0.3)
        os.set_blocking(pipe.fileno(), True)
        assert pipe.read() == ""  # ends once no process that could write to it is alive


COPY = ANSWER + "import shutil; shutil.copy(IMAGE, sys.argv[sys.argv.index('--outfile') + 1])\n"


@with_stand_ins
def test_an_image_is_masked_and_scaled(tmp_path, scene):
    write_image(tmp_path / "image.exr", np.full((9, 9, 3), 3, np.float32))
    program = Pbrt(stand_in(tmp_path, COPY.replace("IMAGE", repr(str(tmp_path / "image.exr")))), 4)
    scaled = Scene(scene.path, 4, 2, 9, exponent=5)
    [(spp, image)] = render(program, [scaled, Scene(scene.path, 3, 1, 9)])
    assert spp == 2
    np.testing.assert_array_equal(image, 96 * np.repeat(disc_mask(9)[..., None], 3, axis=2))
    with pytest.raises(LightdomeError, match="9 x 9 pixels instead of 5 x 5"):
        render_scene(program, Scene(scene.path, 4, 2, 5))
    with pytest.raises(LightdomeError, match="NaN or infinite"):
        render_scene(program, Scene(scene.path, 4, 2, 9, exponent=127))


@with_stand_ins
def test_part_4_with_pbrt_needs_no_opencl(tmp_path, script):
    write_image(tmp_path / "image.exr", np.full((9, 9, 3), 3, np.float32))
    program = stand_in(tmp_path, COPY.replace("IMAGE", repr(str(tmp_path / "image.exr"))))
    (tmp_path / "pyopencl.py").write_text("raise ImportError('part 4 imported it')\n")
    write_image(tmp_path / "map.exr", np.ones((4, 8, 3), np.float32))
    out = tmp_path / "out"
    result = script(
        "part4_pbrt", "--map", tmp_path / "map.exr", "--resolution", 9, "--spp", 4, 3, "--pbrt", program, "--out", out,
        "--explain", PYTHONPATH=str(tmp_path),
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    assert f"renderer: PBRT-v4 ({program})" in result.stdout
    assert {p.name for p in out.iterdir()} == {"pbrt", "settings.json"} | {
        f"sphere_{n}spp.{suffix}" for n in (3, 4) for suffix in ("pfm", "ppm", "png")
    }
    assert "4 spp: used: the sampler zsobol; 4 is a power of two" in result.stdout
    assert "3 spp: used: the sampler halton; 3 is not a power of two" in result.stdout
    for spp in (3, 4):
        assert f"{spp} spp: skipped: OpenCL kernels; PBRT-v4 ({program}) rendered" in result.stdout
        assert f"{spp} spp: skipped: scaling of the map" in result.stdout


def test_part_4_leaves_the_scenes_where_pbrt_is_missing(tmp_path, script):
    write_image(tmp_path / "map.exr", np.ones((4, 8, 3), np.float32))
    out = tmp_path / "out"
    arguments = ["--map", tmp_path / "map.exr", "--resolution", 9, "--spp", 4, "--out", out]
    result = script("part4_pbrt", *arguments, "--renderer", "pbrt", PATH=str(tmp_path), XDG_CACHE_HOME=str(tmp_path))
    assert result.returncode == 1
    assert result.stderr.startswith("part4_pbrt: no PBRT on PATH")
    assert result.stderr.count("\n") == 1
    assert {"sphere_v3_4spp.pbrt", "sphere_v4_4spp.pbrt"} < {p.name for p in (out / "pbrt").iterdir()}


def test_part_4_refuses_a_program_for_the_renderer_that_has_none(run_here):
    assert run_here("part4_pbrt", "--renderer", "opencl", "--pbrt", "x").returncode == 2
    assert run_here("part4_pbrt", "--renderer", "pbrt", "--device", "x").returncode == 2


def test_an_albedo_above_1_is_rendered_and_no_scene_is_written(tmp_path, run_here):
    write_image(tmp_path / "map.pfm", np.ones((4, 8, 3), np.float32))
    options = ("--map", tmp_path / "map.pfm", "--resolution", 9, "--spp", 4)
    images = {}
    for albedo, renderer in ((1, "opencl"), (2, "opencl"), (2, "auto")):
        out = tmp_path / f"{albedo} {renderer}"
        result = run_here("part4_pbrt", *options, "--albedo", albedo, "--renderer", renderer, "--out", out)
        assert result.returncode == 0, result.stderr
        assert (out / "pbrt").exists() == (albedo == 1)
        assert ("note: no scene for PBRT was written" in result.stdout) == (albedo == 2)
        images[albedo, renderer] = read_image(out / "sphere_4spp.pfm")
    np.testing.assert_allclose(images[2, "opencl"], 2 * images[1, "opencl"], rtol=1e-6)
    np.testing.assert_array_equal(images[2, "auto"], images[2, "opencl"])


@pytest.mark.parametrize("options", [("--renderer", "pbrt"), ("--pbrt", "x")])
def test_an_albedo_that_pbrt_does_not_have_is_a_wrong_command_line(run_here, options):
    result = run_here("part4_pbrt", "--albedo", "1.0000000001", *options)
    assert result.returncode == 2
    assert "got 1.0000000001" in result.stderr


def test_importing_the_pbrt_host_leaves_opencl_alone():
    code = "import sys, lightdome.pbrt.run; sys.exit('pyopencl' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


def exact(radiance: np.ndarray, resolution: int) -> np.ndarray:
    """The sphere lit by every pixel once, float64, +y up."""
    height, width = radiance.shape[:2]
    image = np.zeros((resolution, resolution, 3))
    a = (2 * np.arange(resolution) + 1 - resolution) / resolution
    nx, ny = np.meshgrid(a, -a)
    nz = np.sqrt(np.maximum(0, 1 - nx**2 - ny**2))
    for y in range(height):
        for x in range(width):
            wx, wz, wy = pixel_direction(x, y, width, height)
            cosine = np.maximum(0, nx * wx + ny * wy + nz * wz)
            image += cosine[..., None] * radiance[y, x] * pixel_solid_angle(y, width, height) / math.pi
    return np.where((nx**2 + ny**2 < 1)[..., None], image, 0)


@pytest.mark.peer
def test_the_real_pbrt_renders_our_image_the_right_way_up(tmp_path, program):
    radiance = np.full((32, 64, 3), 0.2, np.float32)
    radiance[5:9, 10:14] = (40, 10, 4)  # above, to the right, before the sphere
    radiance[20:22, 24:26] = (1, 8, 30)  # below, to the left
    scenes = write_scenes(tmp_path, EnvironmentMap(radiance), [256], 31, versions=[program.version])
    [(_, image)] = render(program, scenes, timeout=LONG)
    assert deviation(image, EnvironmentMap(radiance)) is None
    expected = exact(radiance, 31)
    np.testing.assert_allclose(image.mean(axis=(0, 1)), expected.mean(axis=(0, 1)), rtol=0.01)
    turned = [np.rot90(flip, k) for k in range(4) for flip in (image, image[:, ::-1])]
    errors = [math.sqrt(((i - expected) ** 2).sum() / (expected**2).sum()) for i in turned]
    assert errors[0] < 0.05
    assert min(errors[1:]) > 5 * errors[0]


@pytest.mark.peer
@pytest.mark.parametrize("kept", [0, 100])
def test_the_real_pbrt_without_its_map_leaves_no_image(tmp_path, program, kept):
    scenes = write_scenes(tmp_path, EnvironmentMap(np.ones((8, 16, 3))), [1], 9, versions=[program.version])
    (path,) = (file for file in tmp_path.iterdir() if file.name.startswith("map_"))
    whole = path.read_bytes()
    path.unlink()
    if kept:
        path.write_bytes(whole[:kept])
    with pytest.raises(LightdomeError, match=path.stem):
        render_scene(program, scenes[0], LONG)


@with_stand_ins
@pytest.mark.parametrize(
    "line",
    [
        "Error: Unable to open map",
        "scene.pbrt:3:1: Error: odd",
        "[2026 ERROR] no map",
        "E0610 12:00 x.cpp:297] NaN",
        "[ @ 0.1s x.cpp:3 ] ERROR NaN",
    ],
)
def test_an_error_counts_though_the_program_ends_well(tmp_path, scene, line):
    write_image(tmp_path / "image.exr", np.ones((9, 9, 3), np.float32))
    body = COPY.replace("IMAGE", repr(str(tmp_path / "image.exr")))
    chatter = "print(9000 * 'hello\\n', flush=True)\n"  # more than is kept, before and after
    program = Pbrt(stand_in(tmp_path, chatter + f"print({line!r})\n" + chatter + body), 4)
    with pytest.raises(LightdomeError, match="exited with status 0 but reported an error: ") as caught:
        render_scene(program, scene)
    assert line in str(caught.value)


@with_stand_ins
def test_warnings_are_shown(tmp_path, scene, caplog):
    write_image(tmp_path / "image.exr", np.ones((9, 9, 3), np.float32))
    body = COPY.replace("IMAGE", repr(str(tmp_path / "image.exr")))
    lines = ["Warning: it is dark", "0 errors", "[now WARN ] no light", "Warning: it is dark"]
    program = Pbrt(stand_in(tmp_path, f"print(*{lines}, sep=chr(10))\n" + body), 4)
    render_scene(program, scene)
    assert caplog.messages == [f"note: PBRT-v4 says: {line}" for line in (lines[0], lines[2])]


@with_stand_ins
def test_a_program_that_is_not_executable_is_named(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    plain = tmp_path / "pbrt"
    plain.write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    for where in (None, tmp_path):
        with pytest.raises(LightdomeError, match=f"{plain} is not executable; run chmod"):
            find_pbrt(where)
    installed_port().parent.mkdir(parents=True)
    port = stand_in(installed_port().parent, PORT, "pbrt-r4")
    assert find_pbrt().path == port


@with_stand_ins
def test_rs_pbrt_is_refused_wherever_it_is_found(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    stand_in(tmp_path, "print('Usage: rs_pbrt --path <PATH>')", "rs_pbrt")
    for where in (None, tmp_path):
        with pytest.raises(LightdomeError, match="is rs_pbrt"):
            find_pbrt(where)


@pytest.mark.parametrize("value", [0.01, 0.02, 1.0])
def test_the_first_byte_of_a_map_is_no_white_space(tmp_path, value):
    """0.01 and 0.02 begin with a line feed, which pbrt-r3 takes for part of the header."""
    write_scenes(tmp_path, EnvironmentMap(np.full((4, 8, 3), value)), [1], 9, versions=[3])
    values = (tmp_path / "map_v3_latlong.pfm").read_bytes().split(b"\n", 3)[3]
    assert values[:1].strip() == values[:1]
    np.testing.assert_allclose(np.frombuffer(values, "<f4"), value, rtol=1e-6)


# The bar of PBRT, that of a port, which draws it only on a terminal, and none.
BARS = {
    "PBRT": "    print('Rendering: [%s]' % ('+' * i).ljust(9), flush=True)\n",
    "port": "    if sys.stdout.isatty(): print(f\"\\r\\x1b[1mx.exr: [\\x1b[36m{'█' * i:9}\\x1b[0m]\", end='')\n",
    "none": "",
}


def slow_stand_in(folder: Path, bar: str, end: str) -> Pbrt:
    """A program whose bar moves eight times in 0.8 seconds, and then does ``end``."""
    body = f"import sys, time\nfor i in range(9):\n{BARS[bar]}    sys.stdout.flush(); time.sleep(0.1)\n{end}\n"
    return Pbrt(stand_in(folder, body), 4, "pbrt-r4 4.5.2" if bar == "port" else None)


@with_stand_ins
@pytest.mark.parametrize("bar", BARS)
def test_a_render_is_given_up_once_it_stands_still(tmp_path, scene, bar):
    with pytest.raises(LightdomeError, match=r"was stopped: 2 spp showed no progress for \d+ s; try the scene"):
        render_scene(slow_stand_in(tmp_path, bar, "time.sleep(60)"), scene, _still=0.3)


@with_stand_ins
@pytest.mark.parametrize("bar", ["PBRT", "port"])
def test_a_render_whose_bar_moves_goes_on(tmp_path, scene, bar):
    with pytest.raises(LightdomeError, match=r"failed with exit status 3; it said: nothing; try the scene"):
        render_scene(slow_stand_in(tmp_path, bar, "sys.exit(3)"), scene, _still=0.5)


@with_stand_ins
def test_a_closed_terminal_ends_pbrt_too(tmp_path):
    """By SIGHUP, since nothing else would stop a program in its own session."""
    os.mkfifo(tmp_path / "pipe")
    hangs = ANSWER + f"import time\nwith open({str(tmp_path / 'pipe')!r}, 'w') as pipe:\n    time.sleep(60)\n"
    write_image(tmp_path / "map.exr", np.ones((4, 8, 3), np.float32))
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    options = ("--spp", 1, "--resolution", 9, "--pbrt", stand_in(tmp_path, hangs), "--out", tmp_path / "out")
    command = command_line("part4_pbrt", "--map", tmp_path / "map.exr", *options)
    process = subprocess.Popen(command, env={**os.environ, "TMPDIR": str(temporary)}, stdout=subprocess.DEVNULL)
    with (tmp_path / "pipe").open() as pipe:  # opens once the program runs
        process.send_signal(signal.SIGHUP)
        assert process.wait(LONG) == 128 + signal.SIGHUP
        assert pipe.read() == ""  # ends once the program no longer runs
    assert list(temporary.iterdir()) == []


@pytest.mark.parametrize("resolution", [9, 31, 255])
def test_an_image_of_another_scene_is_reported(device, stiff, resolution):
    image = exact_image(device, stiff, resolution).astype(np.float64)
    noisy = image * np.random.default_rng(1).lognormal(-0.02, 0.2, image.shape)
    assert deviation(noisy, stiff) is None
    assert deviation(0.5 * noisy, stiff, albedo=0.5) is None
    white = disc_mask(resolution)[..., None] * np.ones(3)
    for wrong in (
        white,
        0 * noisy,
        2 * noisy,
        *((noisy[::-1], noisy[:, ::-1], noisy[..., ::-1]) if resolution > 9 else ()),
    ):
        assert "where the map should give" in deviation(wrong, stiff)
    assert deviation(np.ones((2, 2, 3)), stiff) is None  # too few pixels to estimate their noise
    with pytest.raises(LightdomeError, match="must have the shape"):
        deviation(noisy[1:], stiff)


@with_stand_ins
def test_part_4_reports_a_wrong_image_and_a_missing_cargo(tmp_path, script):
    write_image(tmp_path / "image.exr", np.full((33, 33, 3), 3, np.float32))
    program = stand_in(tmp_path, COPY.replace("IMAGE", repr(str(tmp_path / "image.exr"))))
    write_image(tmp_path / "map.exr", np.ones((4, 8, 3), np.float32))
    options = ("--map", tmp_path / "map.exr", "--resolution", 33, "--spp", 4, "--pbrt", program)
    result = script("part4_pbrt", *options, "--out", tmp_path / "out")
    assert result.returncode == 0
    assert "note: PBRT-v4's image of 4 spp differs from the sphere under this map" in result.stderr
    empty = {"PATH": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path)}
    fails_in_one_line(script("get_pbrt", **empty), "no cargo on PATH")


@with_stand_ins
def test_get_pbrt_has_cargo_install_the_port_where_part_4_finds_it(tmp_path, script):
    """Cargo fails the first time, then replaces an older version; the third time there is nothing to do."""
    body = f"""import sys, pathlib
print("compiling", file=sys.stderr)
folder = pathlib.Path(sys.argv[sys.argv.index("--root") + 1], "bin")
folder.mkdir(parents=True, exist_ok=True)
port = folder / sys.argv[sys.argv.index("--bin") + 1]
port.write_text({PYTHON_PROGRAM + PORT!r})
port.chmod(0o755)
"""
    found = {"PATH": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path / "cache")}
    stand_in(tmp_path, "import sys; sys.exit('error: no network')", "cargo")
    failed = script("get_pbrt", **found)
    assert failed.returncode == 1
    assert failed.stderr.splitlines()[-1].startswith("get_pbrt: cargo did not install pbrt-r4")
    stand_in(tmp_path, body, "cargo")
    (tmp_path / "cache" / "lightdome" / "pbrt" / "bin").mkdir(parents=True)
    stand_in(tmp_path / "cache" / "lightdome" / "pbrt" / "bin", PORT.replace("4.5.2", "4.5.1"), "pbrt-r4")
    done = script("get_pbrt", **found)
    assert done.returncode == 0, done.stderr
    assert f"installed pbrt-r4 4.5.2: {tmp_path / 'cache'}" in done.stdout
    (tmp_path / "cargo").unlink()
    assert "pbrt-r4 4.5.2 is already installed" in script("get_pbrt", **found).stdout
