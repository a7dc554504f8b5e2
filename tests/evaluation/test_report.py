"""The report shows what was measured, never mixes unrelated results, and is the same every time."""

from __future__ import annotations

import argparse
import hashlib
import json
import re
import shutil
import sys
import zipfile
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest
from helpers import Script, fails_in_one_line, stiff_radiance
from lightdome import __version__
from lightdome.commands import report as report_command
from lightdome.commands import settings
from lightdome.disc import disc_mask
from lightdome.errors import LightdomeError
from lightdome.evaluation import benchmark, benchmark_plot, mitsuba_process, report, report_figures, stability
from lightdome.evaluation.metrics import left_after_averaging
from lightdome.evaluation.stability import Result
from lightdome.evaluation.stability_cases import CASES
from lightdome.lighting.exact import exact as exact_image
from lightdome.maps.envmap import EnvironmentMap
from lightdome.maps.images import write_image
from lightdome.opencl.device import Device

QUICK = {"quick": True, "methods": None}


@pytest.fixture(scope="module")
def small_map(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("map") / "small.pfm"
    write_image(path, stiff_radiance(16, 32))
    return path


@pytest.fixture(scope="module")
def out(device: Device, small_map: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a benchmark and a stability table, of the right kind but small and quick to make."""
    out = tmp_path_factory.mktemp("out")
    for name in ("bench", "stability"):
        (out / name).mkdir()
    envmap = EnvironmentMap.read(small_map)
    methods = benchmark.methods(device, envmap, 21)
    reference = methods["exact"].run(1, 0)
    points = [
        benchmark.measure_method(methods[name], count, 2, 1, reference)
        for name in ("independent", "light", "harmonics", "exact")
        for count in (4, 16)
    ]
    options = QUICK | {"resolution": 21, "seeds": 2, "repeats": 1}
    made_with = settings.settings(device, envmap, options) | {"peers": {}, "absent": {"pbrt": "no pbrt on PATH"}}
    benchmark.write_method_json(out / "bench" / "bench.json", points, made_with)
    results = [
        *(stability.run(case, device, 1000) for case in CASES[:2]),
        Result("lightdome", "broken", "NaN", {"p": float("nan"), "image": 1e3}),
        Result("lightdome", "broken", "too large", skipped="no room"),
        Result("mitsuba", "broken", "NaN", {"p": 1.0}, judged=False),
    ]
    made_with = settings.settings(device, None, {"quick": True, "draws": 1000})
    made_with |= {"peers": {"mitsuba": {"mitsuba": "3.9.1"}}, "absent": {}}
    stability.write_stability_json(out / "stability" / "stability.json", results, made_with)
    return out


@pytest.fixture(scope="module")
def made(script: Script, small_map: Path, out: Path) -> Path:
    """``out`` with a report, and with parts 1 to 4, which were run for it."""
    result = script("report", "--quick", "--map", small_map, "--out", out / "report")
    assert result.returncode == 0, result.stderr
    for part in ("part1", "part2", "part3", "part4"):
        assert f"{part}: running" in result.stdout
    assert f"bench: from {out / 'bench'}" in result.stdout
    return out


def test_the_archive_holds_the_report_and_all_images_with_their_sums(made: Path) -> None:
    assert (made / "report" / "report.pdf").read_bytes().startswith(b"%PDF")
    spheres = [f"part3/sphere_{n}" for n in (64, 256, 1024)] + [f"part4/sphere_{n}spp" for n in (8, 16, 32, 64)]
    stems = [*(f"part2/em_{n}" for n in (64, 256, 1024)), *spheres, "exact/sphere"]
    with zipfile.ZipFile(made / "report" / "lightdome-report.zip") as archive:
        assert archive.testzip() is None
        names = {"report.pdf", *(f"{stem}.{suffix}" for stem in stems for suffix in ("pfm", "ppm"))}
        assert set(archive.namelist()) == names | {"SHA256SUMS"}
        lines = archive.read("SHA256SUMS").decode().splitlines()
        sums = {name: value for value, name in (line.split("  ") for line in lines)}
        assert sums == {name: hashlib.sha256(archive.read(name)).hexdigest() for name in names}
        assert archive.read("report.pdf") == (made / "report" / "report.pdf").read_bytes()
        same = archive.read("part3/sphere_64.pfm")
    assert same == (made / "report" / "part3" / "sphere_64.pfm").read_bytes()


def test_the_same_inputs_give_the_same_bytes(
    small_map: Path,
    made: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    shutil.copytree(made, tmp_path / "out")
    again = tmp_path / "out" / "report"
    for name in (report.PDF, report.ARCHIVE):
        (again / name).unlink()
    monkeypatch.setattr(sys, "argv", ["report.py", "--quick", "--map", str(small_map), "--out", str(again)])
    report_command.main()
    assert "running" not in capsys.readouterr().out  # the results exist already
    for name in (report.PDF, report.ARCHIVE):
        assert (again / name).read_bytes() == (made / "report" / name).read_bytes()


@pytest.fixture(scope="module")
def figures(device: Device, small_map: Path, made: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The report's figures, as if part 4 had been rendered by PBRT."""
    folder = tmp_path_factory.mktemp("figures")
    envmap, results = EnvironmentMap.read(small_map), of_pbrt(results_of(made))
    report.draw(device, envmap, results, report.load_images(device, envmap, results), folder)
    return folder


def test_each_figure_holds_the_images_of_its_kind(device: Device, small_map: Path, made: Path, figures: Path) -> None:
    envmap, results = EnvironmentMap.read(small_map), of_pbrt(results_of(made))
    images = report.load_images(device, envmap, results)
    kinds = zip(("shared", "per_pixel"), images.named(), (images.exact, images.exact_per_pixel), strict=True)
    for figure, named, exact in kinds:
        # Matplotlib writes each text next to its outlines.
        said = re.findall("<!-- (.*?) -->", (figures / f"{figure}.svg").read_text(encoding="utf-8"))
        assert [text for text in said if text.endswith((" shared", " per pixel"))] == list(named)
        errors = [f"{100 * left_after_averaging(image, exact, 1):.2f} %" for image in named.values()]
        assert [text for text in said if text.endswith(" %")] == errors


def leave(folder: Path, sha256: str, version: str = __version__) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "em.pfm").write_text(sha256)
    content = {"map": {"sha256": sha256}, "versions": {"lightdome": version}, "options": {"counts": [64]}}
    settings.write(folder, content, ["em.pfm"])


WANTED = {"map": {"sha256": "ours"}, "versions": {"lightdome": __version__}, "options": {"counts": [64]}}


@pytest.mark.parametrize(
    ("there", "reason"),
    [
        (("other",), "map.sha256 differs"),
        (("ours", "0.0.1"), "versions.lightdome differs"),
        (None, ""),
    ],
)
def test_results_of_another_map_or_version_are_made_again(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    there: tuple[str, ...] | None,
    reason: str,
) -> None:
    asked = []

    def run(script: str, *options: object) -> int:
        asked.append((script, *options))
        leave(tmp_path / "report" / "part2", "ours")
        return 0

    if there:
        leave(tmp_path / "part2", *there)
    runs = report_command.Runs(tmp_path / "report", run)
    for _ in range(2):  # the second time it exists
        runs.need("part2", "part2_sample.py", settings.NAME, WANTED, "--seed", 0)
    assert asked == [("part2_sample.py", "--seed", 0, "--out", tmp_path / "report" / "part2")]
    assert runs.folders["part2"] == tmp_path / "report" / "part2"
    assert reason in capsys.readouterr().out


def test_images_that_have_changed_are_not_used(tmp_path: Path) -> None:
    leave(tmp_path / "part2", "ours")
    runs = report_command.Runs(tmp_path / "report", lambda *_: 3)
    runs.need("part2", "part2_sample.py", settings.NAME, WANTED)
    (tmp_path / "part2" / "em.pfm").write_text("of another map")
    with pytest.raises(SystemExit) as exit_:
        runs.need("part2", "part2_sample.py", settings.NAME, WANTED)
    assert exit_.value.code == 3


def test_an_error_that_pixels_share_stays_and_noise_goes() -> None:
    exact = np.ones((64, 64, 3), np.float32)
    noise = exact.copy()
    noise[::2, ::2] += 0.2
    noise[1::2, 1::2] -= 0.2  # the mean of every 2 x 2 pixels is correct
    for side in (1, 2, 8):
        assert left_after_averaging(exact * 1.1, exact, side) == pytest.approx(0.1, rel=1e-5)
    inside = disc_mask(64)
    assert left_after_averaging(noise, exact, 1) == pytest.approx(np.sqrt(((noise - exact)[inside] ** 2).mean()))
    assert left_after_averaging(noise, exact, 2) == pytest.approx(0, abs=1e-7)
    assert np.isnan(left_after_averaging(noise, exact, 64))


@pytest.mark.parametrize("scale", [1e-40, 1e33, 1e38])
def test_pictures_of_a_tiny_or_a_huge_map_tell_its_error(scale: float) -> None:
    exact = np.where(disc_mask(33)[..., None], np.float32(scale), np.float32(0)).repeat(3, axis=2)
    images = {"a": exact * np.float32(1.5)}
    titles = [axes.get_title() for axes in benchmark_plot.images(images, exact, "").axes]
    assert "50.00 %" in titles
    signed, *_ = report_figures.bias_and_noise(("a", images["a"]), ("b", exact), exact).axes
    assert np.nanmax(signed.images[0].get_array()) == pytest.approx(50, rel=1e-4)


def results_of(made: Path) -> report.Results:
    folders = {name: made / "report" / name for name in ("part1", "part2", "part3", "part4")}
    folders |= {name: made / name for name in ("bench", "stability")}
    records = {name: f"{name}.json" if name in ("bench", "stability") else settings.NAME for name in folders}
    return report.Results(folders, {name: settings.read(folders[name] / records[name]) for name in folders})


def of_pbrt(results: report.Results) -> report.Results:
    part4 = {**results.settings["part4"], "pbrt": "PBRT-v4", "device": None}
    return report.Results(results.folders, {**results.settings, "part4": part4})


def test_the_numbers_are_those_of_the_runs(device: Device, small_map: Path, made: Path) -> None:
    envmap, results = EnvironmentMap.read(small_map), results_of(made)
    images = report.load_images(device, envmap, results)
    d = report.numbers(envmap, small_map.name, results, images)
    json.dumps(d, allow_nan=False)

    # Our `light` treats pixels as centres; PBRT, which may be installed here, treats them as areas.
    assert (images.exact_per_pixel is images.exact) == (results.settings["part4"]["pbrt"] is None)
    areas = exact_image(device, envmap, 255, pixels="areas")
    np.testing.assert_array_equal(report.load_images(device, envmap, of_pbrt(results)).exact_per_pixel, areas)
    mask = disc_mask(255)
    for rows, of_kind, exact in (
        (d["shared"], images.shared, images.exact),
        (d["per_pixel"], images.per_pixel, images.exact_per_pixel),
    ):
        for row, (n, image) in zip(rows, of_kind.items(), strict=True):
            difference = image[mask].astype(np.float64) - exact[mask]
            rmse = np.sqrt((difference**2).mean() / (exact[mask].astype(np.float64) ** 2).mean())
            assert int(row[0]) == n
            assert float(row[1]) == pytest.approx(100 * rmse, rel=0.01)
            assert float(row[2]) == pytest.approx(100 * np.abs(difference).max() / exact.max(), rel=0.01)
            assert float(row[3]) == pytest.approx(100 * difference.mean() / exact[mask].mean(), abs=0.001)
    for n, different, *_, drawn in d["drawn"]:
        with np.load(results.folders["part2"] / f"samples_{n}.npz") as samples:
            pixels = list(map(tuple, samples["pixel"]))
            likeliest = pixels[samples["probability"].argmax()]
        assert (len(set(pixels)), pixels.count(likeliest)) == (int(different), int(drawn))
    assert d["fresnel"]["brewster_entering_deg"] == "54.4623"
    assert d["renderer"] == results.settings["part4"]["pbrt"]
    assert d["bench"]["absent"] == ["pbrt (no pbrt on PATH)"]
    assert d["seeds"][0][:3] == ["independent", "4", "2"]
    # Pixels of part 3 share their samples, so the errors hardly fall, unlike those of part 4.
    fallen = {name: float(times) for name, *_, times in d["averaging"]}
    assert fallen["64 shared"] < 2 < 5 < fallen["64 per pixel"]


def test_the_stability_table_shows_failures_and_peers_beside_them(device: Device, small_map: Path, made: Path) -> None:
    envmap, results = EnvironmentMap.read(small_map), results_of(made)
    images = report.load_images(device, envmap, results)
    found = report.numbers(envmap, small_map.name, results, images)["stability"]
    assert (found["holds"], found["fails"], found["skipped"]) == (2, 1, 1)
    rows = found["own"]["rows"]
    assert [(row["case"], row["note"]) for row in rows[2:]] == [("NaN", "FAILS"), ("too large", "skipped")]
    first = {name: cell for (name, *_), cell in zip(found["own"]["columns"], rows[2]["cells"], strict=True)}
    assert first["p"]["text"] == "NaN"
    assert first["p"]["dark"]
    assert first["sum"]["text"] == ""
    (peer,) = found["peers"]
    assert (peer["program"], [name for name, *_ in peer["columns"]]) == ("mitsuba", ["p"])
    assert [(row["case"], row["note"], row["cells"][0]["text"]) for row in peer["rows"]] == [("NaN", "", "1")]


def test_the_renderer_and_other_programs_are_named(
    device: Device, small_map: Path, made: Path, figures: Path, tmp_path: Path
) -> None:
    def drawn(*arguments: object) -> None:
        shutil.copytree(figures, arguments[-1], dirs_exist_ok=True)

    envmap, theirs = EnvironmentMap.read(small_map), of_pbrt(results_of(made))
    d = report.numbers(envmap, small_map.name, theirs, report.load_images(device, envmap, theirs))
    assert d["renderer"] == "PBRT-v4"
    for agreeing in (
        (["part1", "part4"], "no OpenCL device"),
        (["part4"], "PBRT-v4"),
        (["stability"], "mitsuba (mitsuba 3.9.1)"),
    ):
        assert agreeing in d["made_with"]
    report.write(device, envmap, small_map.name, theirs, tmp_path, drawn)
    assert (tmp_path / report.PDF).read_bytes() != (made / "report" / report.PDF).read_bytes()


@pytest.mark.parametrize("there", [True, False])
def test_installed_programs_are_measured(
    small_map: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, there: bool
) -> None:
    asked: dict[str, list[str]] = {}

    class Runs:
        def __init__(self) -> None:
            self.folders = {"part2": tmp_path}
            part4 = {"pbrt": "PBRT-v4" if there else None, "options": {"pbrt": "/opt/pbrt" if there else None}}
            self.settings = {"part2": {"files": defaultdict(str)}, "part4": part4}

        def need(self, name: str, script: str, record: str, wanted: object, *options: object) -> None:
            asked[name] = [str(option) for option in options]

    monkeypatch.setattr(mitsuba_process, "find_spec", lambda name: name if there else None)
    of_map = {"map": small_map, "layer": None, "sanitize": None, "flip": False}
    of_map |= {"convention": "lightdome", "mirror": False, "rotate": None, "projection": None}
    options = argparse.Namespace(**of_map, out=tmp_path, device=None, quick=True, pbrt=None)
    report_command.need_all(Runs(), options, EnvironmentMap.read(small_map))
    assert ("mitsuba" in asked["stability"], "mitsuba" in asked["bench"], "pbrt" in asked["bench"]) == (there,) * 3
    assert "numpy" in asked["bench"]
    of_pbrt = [option for option in asked["bench"] if "pbrt" in option]
    assert of_pbrt == (["pbrt", "--pbrt", "/opt/pbrt"] if there else [])


def test_a_map_behind_the_sphere_is_refused(device: Device, made: Path, tmp_path: Path) -> None:
    radiance = np.zeros((1, 2, 3), np.float32)
    radiance[0, 1] = 1  # its centre is -z exactly
    with pytest.raises(LightdomeError, match="no light of this map"):
        report.write(device, EnvironmentMap(radiance), "behind", results_of(made), tmp_path)
    assert not list(tmp_path.iterdir())


def test_a_missing_pbrt_is_refused_before_any_work(script: Script, tmp_path: Path) -> None:
    result = script("report", "--quick", "--pbrt", tmp_path / "nowhere", "--out", tmp_path / "out")
    fails_in_one_line(result, "nowhere")
    assert not (tmp_path / "out").exists()


def test_a_missing_extra_gives_one_line(script: Script, tmp_path: Path) -> None:
    (tmp_path / "typst.py").write_text("raise ImportError('not installed')\n")
    result = script("report", "--quick", "--out", tmp_path / "out", PYTHONPATH=str(tmp_path))
    fails_in_one_line(result, "pip install 'lightdome[report]'")
    assert not (tmp_path / "out").exists()


def test_what_a_command_refuses_gives_one_line_and_ends_the_report(script: Script, made: Path, tmp_path: Path) -> None:
    shutil.copytree(made / "report" / "part1", tmp_path / "out" / "part1")
    write_image(tmp_path / "black.pfm", np.zeros((8, 16, 3), np.float32))
    result = script("report", "--quick", "--map", tmp_path / "black.pfm", "--out", tmp_path / "out" / "report")
    fails_in_one_line(result, "black everywhere")
    assert not (tmp_path / "out" / "report" / "report.pdf").exists()
