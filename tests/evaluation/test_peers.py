"""Other programs on the same sphere: their images meet the exact one, and absent programs are reported."""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from helpers import PYTHON_PROGRAM, Script, stiff_radiance
from lightdome import reference
from lightdome.disc import disc_mask
from lightdome.errors import LightdomeError
from lightdome.evaluation import mitsuba_process, peer_mitsuba, peer_numpy, peer_pbrt, peers
from lightdome.evaluation.benchmark import Method, measure_method
from lightdome.evaluation.benchmark_plot import error_against_time
from lightdome.evaluation.stability import chi_square_z
from lightdome.lighting.exact import exact
from lightdome.maps.envmap import EnvironmentMap
from lightdome.maps.images import write_image
from lightdome.opencl.device import Device

pytestmark = pytest.mark.slow  # most run for seconds, or start a stand-in

SIZE = 48


@pytest.fixture(scope="module")
def blocks() -> EnvironmentMap:
    """A map without symmetry that interpolation changes little: blocks of 8 x 8 equal pixels."""
    rng = np.random.default_rng(5)
    colours = np.exp(rng.normal(0, 1.5, (8, 16, 3))).astype(np.float32)
    return EnvironmentMap(colours.repeat(8, axis=0).repeat(8, axis=1))


@pytest.fixture(scope="module", params=peer_mitsuba.VARIANTS)
def mitsuba(request: pytest.FixtureRequest, blocks: EnvironmentMap) -> Iterator[peer_mitsuba.MitsubaRenderer]:
    if not mitsuba_process.installed():
        pytest.skip(f"needs Mitsuba: {peers.INSTALL}")
    try:
        yield peer_mitsuba.MitsubaRenderer(request.param, blocks.radiance)
    except LightdomeError as error:
        if "needs LLVM" not in str(error):
            raise
        pytest.skip(str(error))


def lit(radiance: np.ndarray, rows: np.ndarray, columns: np.ndarray, size: int = SIZE) -> np.ndarray:
    """The sphere's pixels (M, 3) if the centres of the map's rows and columns were at ``rows`` and ``columns``."""
    height, width = radiance.shape[:2]
    theta, phi = np.meshgrid(np.pi * rows / height, 2 * np.pi * columns / width, indexing="ij")
    towards = np.stack([np.sin(theta) * np.cos(phi), np.cos(theta), np.sin(theta) * np.sin(phi)], axis=-1)
    solid_angle = np.maximum(np.sin(theta), 0) * np.gradient(theta, axis=0) * 2 * np.pi / width
    flux = radiance.astype(np.float64) * solid_angle[..., None] / np.pi
    normal = reference.normals(size)[disc_mask(size)]
    return np.maximum(normal @ towards.reshape(-1, 3).T, 0) @ flux.reshape(-1, 3)


def misplacements(image: np.ndarray, radiance: np.ndarray) -> dict[str, float]:
    """How far the map that lit ``image`` is misplaced, in half pixels, fitted from what each misplacement does.

    ``stretched`` means that the rows are spread from pole to pole, with the first and last centres on the poles.
    """
    (height, width), size = radiance.shape[:2], len(image)
    y, x = np.arange(height) + 0.5, np.arange(width) + 0.5
    right = lit(radiance, y, x, size)
    wrong = {
        "down": lit(radiance, y + 0.5, x, size),
        "right": lit(radiance, y, x + 0.5, size),
        "stretched": lit(radiance, np.arange(height) * height / (height - 1), x, size),
    }
    columns = np.stack([(w - right).ravel() for w in wrong.values()], axis=1)
    error = (image[disc_mask(size)] - right).ravel()
    return dict(zip(wrong, np.linalg.lstsq(columns, error, rcond=None)[0], strict=True))


def assert_meets_exact(image: np.ndarray, device: Device, envmap: EnvironmentMap, pixels: str = "areas") -> None:
    truth = exact(device, envmap, len(image), pixels=pixels)
    assert image.dtype == np.float32
    assert not image[~disc_mask(len(image))].any()
    for flipped in (truth[::-1], truth[:, ::-1], truth[::-1, ::-1]):
        assert reference.relative_rmse(flipped, truth) > 0.1  # otherwise the comparison would not notice
    assert reference.relative_rmse(image, truth) < 0.02
    for kind, halves in misplacements(image, envmap.radiance).items():
        assert abs(halves) < 0.4, kind


def test_misplacements_are_detected(blocks: EnvironmentMap) -> None:
    image = np.zeros((SIZE, SIZE, 3))
    rows, columns = np.arange(blocks.height) + 1.0, np.arange(blocks.width)
    image[disc_mask(SIZE)] = lit(blocks.radiance, rows, columns)
    found = misplacements(image, blocks.radiance)
    assert found == pytest.approx({"down": 1, "right": -1, "stretched": 0}, abs=0.1)


def test_numpy_meets_the_exact_image(device: Device, blocks: EnvironmentMap) -> None:
    image, stages = peer_numpy.draw_and_shade(blocks.radiance, SIZE, 2**18, seed=1)
    assert_meets_exact(image, device, blocks, "centres")
    assert set(stages) == {"draw", "shade"}


def test_numpy_draws_pixels_by_their_weight() -> None:
    radiance = stiff_radiance(9, 14)
    direction, flux = peer_numpy.draw(radiance, 40_000, seed=2)
    where = reference.directions(9, 14).reshape(-1, 3)
    pixel = (direction @ where.T).argmax(axis=1)
    np.testing.assert_allclose(direction, where[pixel], atol=1e-12)
    p = reference.probability(radiance)
    counts = np.bincount(pixel, minlength=9 * 14).reshape(9, 14)
    assert not counts[p == 0].any()
    assert abs(chi_square_z(counts, p)) < 4
    density = p / reference.pixel_solid_angles(9, 14)
    expected = radiance.reshape(-1, 3)[pixel] / density.ravel()[pixel, None] / len(pixel)
    np.testing.assert_allclose(flux, expected, rtol=1e-6)


@pytest.mark.parametrize("u", [0.0, np.nextafter(1, 0)])
def test_numpy_draws_no_black_pixel_at_the_ends_of_the_cdfs(monkeypatch: pytest.MonkeyPatch, u: float) -> None:
    radiance = np.zeros((300, 50, 3), np.float32)
    radiance[200:290, 10:20] = stiff_radiance(90, 10) + 1e-20

    class Ends:
        def random(self, shape: tuple[int, int]) -> np.ndarray:
            return np.full(shape, u)

    monkeypatch.setattr(np.random, "default_rng", lambda seed: Ends())
    direction, flux = peer_numpy.draw(radiance, 1, seed=0)
    where = reference.directions(300, 50)
    chosen = np.unravel_index((where @ direction[0]).argmax(), (300, 50))
    assert chosen == ((200, 10) if u == 0 else (289, 19))
    assert (flux > 0).all()


def test_numpy_shades_as_the_reference() -> None:
    rng = np.random.default_rng(3)
    direction = rng.normal(size=(70, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    flux = rng.random((70, 3))
    image = peer_numpy.shade(direction, flux, 21)
    expected = np.nan_to_num(reference.shade(reference.normals(21), direction, flux * 70, np.ones(70)))
    np.testing.assert_allclose(image, expected, rtol=1e-5, atol=1e-6)


def test_mitsubas_rows_interpolate_between_ours() -> None:
    radiance = np.arange(6, dtype=np.float32).repeat(3).reshape(3, 2, 3)
    rows = peer_mitsuba.between_poles(radiance)
    assert rows[:, 0, 0].tolist() == [0, 0, 1, 2, 3, 4, 4]
    assert peer_mitsuba.between_poles(np.ones((1, 1, 3), np.float32)).shape == (3, 2, 3)


@pytest.mark.peer
def test_mitsuba_meets_the_exact_image(
    device: Device, blocks: EnvironmentMap, mitsuba: peer_mitsuba.MitsubaRenderer
) -> None:
    image, stages = mitsuba.render(SIZE, 1024, seed=0)
    assert_meets_exact(image, device, blocks)
    assert set(stages) == {"scene", "render"}
    assert mitsuba.about["threads"] >= 1
    assert mitsuba.about["start-up seconds"] > 0


@pytest.mark.peer
def test_mitsuba_says_how_many_samples_it_took(mitsuba: peer_mitsuba.MitsubaRenderer) -> None:
    for spp in (1, 8, 16, 32):
        mitsuba.render(4, spp, 0)
    taken = mitsuba.about["samples per pixel"]
    assert all(taken[spp] == spp for spp in (1, 8, 16))
    assert 32 <= taken[32] <= 36


@pytest.mark.peer
@pytest.mark.skipif(not mitsuba_process.installed(), reason=f"needs Mitsuba: {peers.INSTALL}")
@pytest.mark.skipif(os.name != "posix", reason="crashes are told by signals")
def test_a_crash_of_mitsuba_is_only_an_error() -> None:
    others = set(multiprocessing.active_children())
    peer = peer_mitsuba.MitsubaRenderer("scalar_rgb", np.ones((2, 4, 3), np.float32))
    (child,) = set(multiprocessing.active_children()) - others
    os.kill(child.pid, signal.SIGABRT)
    with pytest.raises(LightdomeError, match="crashed"):
        peer.render(4, 1, 0)
    with pytest.raises(LightdomeError):
        peer.render(4, 1, 0)


@pytest.mark.peer
@pytest.mark.skipif(not mitsuba_process.installed(), reason=f"needs Mitsuba: {peers.INSTALL}")
def test_a_mitsuba_without_llvm_is_absent(monkeypatch: pytest.MonkeyPatch, blocks: EnvironmentMap) -> None:
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "/nowhere/libLLVM.so")
    found = peers.find(["mitsuba"], blocks, 4)
    assert set(found.methods) == {"mitsuba scalar_rgb"}
    assert "needs LLVM 17 or newer" in found.absent["mitsuba llvm_ad_rgb"]


def test_what_is_not_installed_is_absent(monkeypatch: pytest.MonkeyPatch, blocks: EnvironmentMap) -> None:
    monkeypatch.setattr(mitsuba_process, "find_spec", lambda name: None)
    monkeypatch.setenv("PATH", "/nowhere")
    monkeypatch.setenv("XDG_CACHE_HOME", "/nowhere")
    found = peers.find(["mitsuba", "pbrt"], blocks, 4)
    assert not found.methods
    assert found.absent["mitsuba"] == peers.INSTALL
    assert "no PBRT on PATH" in found.absent["pbrt"]
    with pytest.raises(ValueError, match="luxcore"):
        peers.find(["luxcore"], blocks)


PBRT = f"""{PYTHON_PROGRAM}import sys
import numpy as np
print("pbrt version 4", flush=True)
if "--outfile" in sys.argv:
    scene = open(sys.argv[-1]).read().split()
    size = int(scene[scene.index("xresolution\\"") + 1].strip("[]"))
    from lightdome.maps.images import write_image
    write_image(sys.argv[sys.argv.index("--outfile") + 1], np.ones((size, size, 3), np.float32))
"""


SEEDED_PBRT = f"""{PYTHON_PROGRAM}import shutil, sys
print("pbrt version VERSION", flush=True)
if "--outfile" in sys.argv:
    scene, target = open(sys.argv[-1]).read().split(), sys.argv[sys.argv.index("--outfile") + 1]
    size = scene[scene.index('xresolution"') + 1].strip("[]")
    seed = scene[scene.index('seed"') + 1].strip("[]") if 'seed"' in scene else "0"
    shutil.copy(f"FOLDER/{{size}}_{{seed}}{{target[-4:]}}", target)
"""


@pytest.mark.skipif(os.name != "posix", reason="the stand-in for pbrt is an executable script")
def test_a_peer_is_random_if_another_seed_gives_another_image(tmp_path: Path, blocks: EnvironmentMap) -> None:
    for size in (1, 8):
        for seed in range(3):
            for suffix in (".pfm", ".exr"):
                write_image(tmp_path / f"{size}_{seed}{suffix}", np.full((size, size, 3), 1 + seed, np.float32))
    programs = []
    for version in (3, 4):
        programs.append(tmp_path / f"pbrt{version}")
        programs[-1].write_text(SEEDED_PBRT.replace("VERSION", str(version)).replace("FOLDER", str(tmp_path)))
        programs[-1].chmod(0o755)
    found = peers.find(["numpy", "pbrt"], blocks, 8, programs)
    assert set(found.methods) == {"numpy", "pbrt-v3", "pbrt-v4"}, found.absent
    for name, method in found.methods.items():
        first, second = method.run(4, 1), method.run(4, 2)
        assert method.random == (not np.array_equal(first, second)), name
    assert not found.methods["pbrt-v3"].random
    point = measure_method(found.methods["pbrt-v3"], 4, seeds=3, repeats=1, reference=np.ones((8, 8, 3)))
    assert point.seeds == 1


@pytest.mark.skipif(os.name != "posix", reason="the stand-in for pbrt is an executable script")
def test_pbrts_time_excludes_its_start_up(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, blocks: EnvironmentMap
) -> None:
    clock = tmp_path / "clock"
    clock.touch()
    program = tmp_path / "pbrt"
    program.write_text(
        PBRT
        + f"""
with open({str(clock)!r}, "a") as clock:
    clock.write("2 " if "--outfile" not in sys.argv else "5 " if size == 1 else "9 ")
"""
    )
    program.chmod(0o755)
    now = SimpleNamespace(perf_counter=lambda: sum(map(float, clock.read_text().split())))
    monkeypatch.setattr(peer_pbrt, "time", now)
    found = peers.find(["pbrt"], blocks, SIZE, [program, tmp_path / "none"])
    assert list(found.methods) == ["pbrt-v4"]
    assert found.methods["pbrt-v4"].pixels == "areas"
    assert "none" in found.absent[f"pbrt {tmp_path / 'none'}"]
    method = found.methods["pbrt-v4"]
    image = method.run(4, 1)
    assert (image[disc_mask(SIZE)] == 1).all()
    assert found.about["pbrt-v4"]["start-up seconds"] == 2
    assert method.clock() == {"scene": 3, "render": 4}


@pytest.mark.peer
def test_pbrt_meets_the_exact_image(device: Device, blocks: EnvironmentMap) -> None:
    try:
        peer = peer_pbrt.PbrtPeer(os.environ.get("LIGHTDOME_PBRT"), blocks)
    except LightdomeError as error:
        pytest.skip(str(error))
    image, _ = peer.render(SIZE // 2, 2048, seed=0)  # its noise is a tenth of a misplacement by half a pixel
    assert_meets_exact(image, device, blocks)


def test_a_peers_time_is_its_own_clocks(blocks: EnvironmentMap) -> None:
    method = Method("p", "per pixel", lambda count, seed: np.ones((4, 4, 3)), peer=True, clock=lambda: {"a": 3, "b": 4})
    point = measure_method(method, 2, seeds=2, repeats=3, reference=np.full((4, 4, 3), 2.0))
    assert point.peer
    assert point.wall_seconds == 7
    assert point.stages == {"a": 3, "b": 4}
    assert error_against_time([point], "").axes[0].lines[0].get_linestyle() == "-."


def test_the_benchmark_measures_peers_and_names_the_absent(run_here: Script, tmp_path: Path) -> None:
    write_image(tmp_path / "map.pfm", stiff_radiance(16, 32))
    arguments = ["bench", "--map", tmp_path / "map.pfm", "--counts", 16, "--spp", 2, "--resolution", 15, "--seeds", 2]
    arguments += ["--repeats", 1, "--methods", "exact", "--out", tmp_path]
    result = run_here(*arguments, "--peers", "numpy", "pbrt", "--pbrt", tmp_path / "no pbrt")
    assert result.returncode == 0, result.stderr
    name = f"pbrt {tmp_path / 'no pbrt'}"
    assert f"peer {name}: absent ({tmp_path}/no pbrt does not exist; " in result.stdout
    written = json.loads((tmp_path / "bench.json").read_text())
    assert list(written["absent"]) == [name]
    assert list(written["peers"]) == ["numpy"]
    assert {m["method"]: m["peer"] for m in written["measurements"]} == {"exact": False, "numpy": True}
    assert {m["method"]: m["pixels"] for m in written["measurements"]} == {"exact": "centres", "numpy": "centres"}
    assert run_here(*arguments, "--peers", "luxcore").returncode == 2


@pytest.mark.skipif(os.name != "posix", reason="the stand-in for pbrt is an executable script")
def test_a_peer_that_fails_midway_costs_no_other_result(run_here: Script, tmp_path: Path) -> None:
    program = tmp_path / "pbrt"
    program.write_text(PBRT.replace("np.ones((size,", "np.ones((size if size == 1 else 2,"))
    program.chmod(0o755)
    write_image(tmp_path / "map.pfm", stiff_radiance(16, 32))
    arguments = ["--map", tmp_path / "map.pfm", "--counts", 16, "--spp", 2, 4, "--resolution", 15, "--seeds", 1]
    arguments += ["--repeats", 1, "--methods", "exact", "--peers", "pbrt", "--pbrt", program, "--out", tmp_path]
    result = run_here("bench", *arguments)
    assert result.returncode == 0, result.stderr
    assert "peer pbrt-v4: absent (failed at 2: " in result.stdout
    for plot in ("error_time", "error_time_all", "error_count", "stages", "images"):
        assert (tmp_path / f"{plot}.png").read_bytes().startswith(b"\x89PNG")
    written = json.loads((tmp_path / "bench.json").read_text())
    assert [m["method"] for m in written["measurements"]] == ["exact"]
