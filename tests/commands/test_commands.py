"""The output of parts 1 to 4: the decisions for each result, given numbers in full, and the order of results."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers import Script, stiff_radiance
from lightdome.decisions import Decisions
from lightdome.errors import LightdomeError
from lightdome.fresnel.equations import summarise
from lightdome.lighting.exact import exact
from lightdome.lighting.shade import shade, shade_samples
from lightdome.maps.envmap import EnvironmentMap
from lightdome.maps.images import auto_exposure, read_image, tone_map, write_image
from lightdome.opencl.device import Device
from lightdome.rendering.per_pixel import render
from lightdome.sampling.distribution import build_distribution


@pytest.fixture(scope="module")
def small_map(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("map") / "map.pfm"
    write_image(path, stiff_radiance(16, 32))
    return path


def said(result: object, of: str) -> set[str]:
    """The explanations of one result, without the reasons."""
    lines = [line.removeprefix(f"{of}: ") for line in result.stdout.splitlines() if line.startswith(f"{of}: ")]
    return {line.partition(";")[0] for line in lines}


def test_each_count_is_explained_separately(run_here: Script, small_map: Path, tmp_path: Path) -> None:
    result = run_here("part2_sample", "--map", small_map, "--counts", 1000, 4, "--explain", "--out", tmp_path)
    assert result.returncode == 0, result.stderr
    assert said(result, "4 samples") == {"skipped: guide tables"}
    assert said(result, "1000 samples") == {"used: guide tables"}
    assert "skipped: scaling of weights" in said(result, "the map")
    assert "built 5 of" in result.stdout  # sample and sample_guided among them

    files = [tmp_path / f"samples_{n}.npz" for n in (1000, 4)]
    result = run_here("part3_shade", *files, "--resolution", 40, "--explain", "--out", tmp_path / "three")
    for of in ("4 samples", "1000 samples"):
        assert "used: a light for each sample" in said(result, of)
        assert "skipped: tiles outside the disc" in said(result, of)


@pytest.mark.parametrize(("counts", "guided"), [((3, 4), "skipped"), ((4, 1000), "used")])
def test_samples_only_is_explained(
    run_here: Script, small_map: Path, tmp_path: Path, counts: tuple[int, int], guided: str
) -> None:
    options = ("--samples-only", "--explain", "--out", tmp_path)
    result = run_here("part2_sample", "--map", small_map, "--counts", *counts, *options)
    assert result.returncode == 0, result.stderr
    assert f"{guided}: guide tables" in said(result, f"{counts[0]}, {counts[1]} samples")
    assert ("guide," in result.stdout) == (guided == "used")  # the kernel


def test_images_of_part_4_are_explained(run_here: Script, small_map: Path, tmp_path: Path) -> None:
    options = ("--renderer", "opencl", "--spp", 4, 2, "--resolution", 9, "--explain", "--out", tmp_path)
    result = run_here("part4_pbrt", "--map", small_map, *options)
    assert result.returncode == 0, result.stderr
    assert {"used: guide tables", "used: separate channels"} <= said(result, "2, 4 spp")
    assert "skipped: scaling of weights" in said(result, "the map")


def test_a_later_decision_replaces_an_earlier_one() -> None:
    decisions = Decisions()
    decisions.skip("tables", "few")
    decisions.use("tables", "many")
    assert [str(d) for d in decisions.take()] == ["used: tables; many"]
    assert decisions.take() == []


def test_decisions_are_what_happens(device: Device) -> None:
    def made() -> dict[str, bool]:
        return {decision.what: decision.used for decision in device.decisions.take()}

    rng = np.random.default_rng(2)
    for grey, scale in ((True, 1.0), (False, 2.0**-100)):
        radiance = (rng.random((16, 32, 1 if grey else 3)) + np.zeros(3)).astype(np.float32) * np.float32(scale)
        device.decisions.take()
        distribution = build_distribution(device, EnvironmentMap(radiance))
        assert made()["scaling of weights"] == (scale != 1)
        exact(device, distribution.envmap, 64)
        assert made()["separate channels"] == (not grey)
        for estimator, guided in (("light", True), ("bsdf", False), ("mis", True), ("product", False)):
            list(render(distribution, [1], 9, estimator=estimator))
            now = made()
            assert (now["guide tables"], now["separate channels"]) == (guided, not grey)
        for count, apart in ((10, True), (320 * 16, False)):
            shade_samples(device, distribution.sample(count), 64)
            now = made()
            assert now["a light for each sample"] == apart
            assert now["guide tables"] == (count >= 16 * 32 / 8)
    direction = np.array([[0, 0, 1.0]])
    for brute_force in (True, False):
        shade(device, direction, np.ones((1, 3)), 64, brute_force=brute_force)
        assert made()["brute force over pairs of pixel and light"] == (brute_force or device.is_gpu)
    shade(device, direction, np.ones((1, 3)), 1)
    assert "tiles outside the disc" not in made()  # there are none outside
    list(render(build_distribution(device, EnvironmentMap(np.zeros((4, 8, 3)))), [1], 9))
    assert made()["rendering"] is False


def test_part_3_lists_its_images_in_the_order_of_their_counts(
    run_here: Script, small_map: Path, tmp_path: Path
) -> None:
    assert run_here("part2_sample", "--map", small_map, "--counts", 3, 20, 100, "--out", tmp_path).returncode == 0
    files = [tmp_path / f"samples_{n}.npz" for n in (20, 100, 3)]
    lines = run_here("part3_shade", *files, "--resolution", 9, "--out", tmp_path / "out").stdout.splitlines()
    wrote = [line.partition("sphere_")[2] for line in lines if line.startswith("wrote")]
    assert wrote == [f"{n}.pfm, .ppm, .png" for n in (3, 20, 100)]
    exposure = ("--exposure", "0.12345678", "--gamma", "2.20000001")
    last = run_here("part3_shade", files[2], "--resolution", 9, *exposure, "--out", tmp_path / "out").stdout
    assert last.splitlines()[-1] == "exposure 0.12345678, gamma 2.20000001"


@pytest.mark.parametrize("albedo", [1.0, 0.5])
def test_all_pictures_of_a_sphere_share_the_exposure_of_the_exact_one(
    run_here: Script, device: Device, small_map: Path, tmp_path: Path, albedo: float
) -> None:
    of_map = ("--map", small_map)
    sphere = ("--albedo", albedo, "--resolution", 65)
    assert run_here("part2_sample", *of_map, "--counts", 3, 20, "--out", tmp_path).returncode == 0
    few, more = (tmp_path / f"samples_{n}.npz" for n in (3, 20))
    runs = (
        ("part3_shade", few, *sphere),
        ("part3_shade", more, few, *sphere),
        ("part4_pbrt", *of_map, "--renderer", "opencl", "--spp", 2, *sphere),
        ("exact", *of_map, *sphere),
    )
    said = {run_here(*words, "--out", tmp_path / "out").stdout.splitlines()[-1] for words in runs}
    (line,) = said
    exposure = float(line.removeprefix("exposure ").partition(",")[0])
    assert exposure == pytest.approx(auto_exposure(exact(device, EnvironmentMap.read(small_map), 65, albedo)), rel=0.01)

    # Samples of another map than the settings beside them tell of have the exposure of their own image.
    few.write_bytes(more.read_bytes())
    other = run_here("part3_shade", few, "--resolution", 65, "--out", tmp_path / "out").stdout.splitlines()[-1]
    image = auto_exposure(read_image(tmp_path / "out" / "sphere_20.pfm"))
    assert other == f"exposure {image:.4g}, gamma 2.2"


def test_part_1_says_the_index_that_it_was_given(run_here: Script, tmp_path: Path) -> None:
    result = run_here("part1_fresnel", "--eta", "1.0000000001", "--out", tmp_path)
    assert result.stdout.startswith("eta 1.0000000001,")
    assert "1.0000000001" in (tmp_path / "fresnel.json").read_text()


EXTREMES = (5e-324, 1e-308, 1e308, 1.7e308)


def test_no_extreme_of_exposure_or_gamma_leaks_a_warning() -> None:
    """Warnings are errors here."""
    radiance = np.array([[[0, 1e-45, 1], [2, 1e30, 3e38]]], np.float32)
    for exposure in EXTREMES:
        with np.errstate(over="ignore"):
            exposed = radiance.astype(np.float64) * exposure
        for gamma in EXTREMES:
            # With a large gamma any light is white; with a small one, whatever is not white is black.
            white = exposed > 0 if gamma > 1 else exposed >= 1
            np.testing.assert_array_equal(tone_map(radiance, exposure, gamma), np.where(white, 255, 0))


def test_no_extreme_of_albedo_leaks_a_warning(device: Device) -> None:
    envmap = EnvironmentMap(stiff_radiance(8, 16))
    distribution = build_distribution(device, envmap)
    samples = distribution.sample(20)
    for albedo in (0, 5e-324, 1e-308, 3e38):
        images = [shade_samples(device, samples, 9, albedo), exact(device, envmap, 9, albedo)]
        images += [image for _, image in render(distribution, [2], 9, albedo)]
        for image in images:
            assert np.isfinite(image).all()
            assert image.max() == (np.finfo(np.float32).max if albedo > 1 else 0)


@pytest.mark.parametrize("eta", EXTREMES)
def test_an_index_is_used_or_refused_for_the_right_reason(eta: float) -> None:
    if eta > 1e-323:
        assert summarise(eta).normal_reflectance_p == pytest.approx(1)
    else:
        with pytest.raises(LightdomeError, match="too far apart"):
            summarise(eta)
