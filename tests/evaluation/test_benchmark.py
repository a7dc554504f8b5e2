"""The benchmark measures what it says: known errors, honest times, complete files."""

from __future__ import annotations

import csv
import json
import sys
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from helpers import Script, module_of, stiff_radiance
from lightdome import reference
from lightdome.disc import disc_mask
from lightdome.evaluation import benchmark, metrics
from lightdome.evaluation.benchmark import Method, MethodMeasurement
from lightdome.maps.envmap import EnvironmentMap
from lightdome.maps.images import write_image
from lightdome.names import METHODS
from lightdome.opencl.device import Device
from matplotlib.figure import Figure

R = 21


def point(method: str, seconds: float, rmse: float, count: int = 1) -> MethodMeasurement:
    return MethodMeasurement(method, "shared", count, 1, rmse, 0, 0, 0, seconds, 0, 0)


def test_the_errors_put_in_are_measured() -> None:
    mask = disc_mask(R)
    truth = np.where(mask[..., None], [1.0, 2.0, 3.0], 0).astype(np.float32)

    def run(count: int, seed: int) -> np.ndarray:
        image = truth * (1 + (0.1 if seed % 2 else -0.1) / count)
        image[~mask] = 99  # nothing outside the disc counts
        return image

    measured = benchmark.measure_method(Method("known", "shared", run), 2, seeds=4, repeats=1, reference=truth)
    assert measured.rmse == pytest.approx(0.05, rel=1e-5)
    assert measured.rmse_spread == pytest.approx(0, abs=1e-7)
    assert measured.largest_error == pytest.approx(0.05, rel=1e-5)
    assert measured.bias == pytest.approx(0, abs=1e-7)
    assert measured.seeds == 4
    once = benchmark.measure_method(Method("known", "order", run, random=False), 1, seeds=4, repeats=1, reference=truth)
    assert once.bias == pytest.approx(-0.1, rel=1e-5)
    assert once.seeds == 1


@pytest.mark.parametrize(
    ("kind", "seeds", "estimated"), [("per pixel", 8, True), ("per pixel", 1, False), ("shared", 8, False)]
)
def test_the_error_is_estimated_from_the_spread_over_seeds(kind: str, seeds: int, estimated: bool) -> None:
    truth = np.where(disc_mask(R)[..., None], [1.0, 2.0, 3.0], 0).astype(np.float32)

    def run(count: int, seed: int) -> np.ndarray:
        return truth + np.random.default_rng(seed).normal(0, 0.2, truth.shape)

    measured = benchmark.measure_method(Method("noise", kind, run), 2, seeds, repeats=1, reference=truth)
    assert measured.estimated == (pytest.approx(measured.rmse, rel=0.05) if estimated else None)
    assert measured.rmse == pytest.approx(0.2 / np.sqrt(14 / 3), rel=0.05)


def test_times_are_those_of_the_median_run_and_the_first_is_separate(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = 0.0
    lasts = iter([20.0, 3.0, 1.0, 9.0, 2.0, 4.0])
    profile: dict[str, float] = {}

    def run(count: int, seed: int) -> np.ndarray:
        nonlocal clock
        seconds = next(lasts)
        clock += seconds
        profile["shade"] = profile.get("shade", 0) + seconds / 4
        return np.ones((R, R, 3), np.float32)

    monkeypatch.setattr(benchmark, "time", SimpleNamespace(perf_counter=lambda: clock))
    device = SimpleNamespace(profile=SimpleNamespace(clear=profile.clear, seconds=profile.copy))
    measured = benchmark.measure_method(Method("slow", "shared", run, device=device), 1, 1, 5, np.ones((R, R, 3)))
    assert measured.first_seconds == 20
    assert measured.wall_seconds == 3
    assert measured.wall_spread == 1
    assert measured.stages == {"shade": 0.75}


def test_the_front_holds_the_unbeaten_measurements() -> None:
    points = [point("a", 1, 0.5), point("b", 2, 0.6), point("c", 3, 0.1), point("d", 3, 0.2), point("e", 4, 0.1)]
    assert [p.method for p in metrics.pareto_front(points)] == ["a", "c"]
    best = metrics.cheapest(points, 0.2)
    assert best is not None
    assert best.method == "c"
    assert metrics.cheapest(points, 0.01) is None


def test_the_slope_is_the_exponent() -> None:
    points = [point("a", 1, 3 * n**-0.75, n) for n in (16, 64, 256)]
    assert metrics.slope(points) == pytest.approx(-0.75)
    assert metrics.slope(points[:1]) is None


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "count", "tolerance"),
    [
        ("independent", 65536, 0.01),
        ("stratified", 65536, 0.002),
        ("sobol", 65536, 0.002),
        ("r2", 65536, 0.002),
        ("lattice", 65536, 0.002),
        ("median-cut", 2048, 0.002),
        *((name, 65536, 0.01) for name in ("light", "mis")),
        *((name, 16384, 0.005) for name in ("light-sobol", "mis-sobol", "mis-compensated-sobol")),
        *((name, 16384, 0.005) for name in ("light-lattice", "mis-lattice")),
        *((name, 16384, 0.01) for name in ("product", "product-sobol", "product-lattice")),
        *((name, 2**18, 0.011) for name in ("bsdf", "bsdf-sobol", "bsdf-lattice")),
        ("harmonics", 32, 0.01),
        ("exact", 1, 1e-6),
        ("exact-areas", 1, 1e-6),
    ],
)
def test_every_method_converges_to_its_own_float64_image(
    device: Device, name: str, count: int, tolerance: float
) -> None:
    # Half a pixel of this map is 2.8 degrees, an error of 2 % or more: no method may hide that.
    envmap = EnvironmentMap(stiff_radiance(32, 64))
    if name.startswith("bsdf"):  # finds bright pixels only by chance, so use a milder map
        rng = np.random.default_rng(1)
        bands = rng.exponential(1, (16, 1, 1)) * np.exp(rng.normal(0, 1, (1, 32, 1)))
        envmap = EnvironmentMap(bands * np.exp(rng.normal(0, 1, (16, 32, 3))))
    mask = disc_mask(R)
    method = benchmark.methods(device, envmap, R)[name]
    areas = name.startswith(("bsdf", "mis", "exact-areas"))
    assert method.pixels == ("areas" if areas else "centres")
    truth = partial(reference.exact_areas, nodes=8) if areas else reference.exact
    expected = np.zeros((R, R, 3))
    expected[mask] = truth(envmap.radiance, reference.normals(R)[mask])
    image = method.run(count, 1)
    assert reference.relative_rmse(image, expected) < tolerance
    shifted = np.roll(envmap.radiance, 1, axis=1) / 2 + envmap.radiance / 2
    expected[mask] = truth(shifted, reference.normals(R)[mask])
    assert reference.relative_rmse(image, expected) > 2 * tolerance


def test_every_method_is_in_that_test(device: Device) -> None:
    marks = test_every_method_converges_to_its_own_float64_image.pytestmark
    tested = {parameters[0] for parameters in marks[0].args[1]}
    assert tested == set(benchmark.methods(device, EnvironmentMap(np.ones((4, 8, 3))), R))


@pytest.mark.slow
def test_the_script_end_to_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], drawn: dict[str, Figure]
) -> None:
    write_image(tmp_path / "map.pfm", stiff_radiance(16, 32))
    out = tmp_path / "out"
    options = ["--resolution", R, "--seeds", 2, "--repeats", 2, "--counts", 4, 8, "--spp", 2, "--out", out]
    monkeypatch.setattr(sys, "argv", ["bench.py", "--map", str(tmp_path / "map.pfm"), *map(str, options)])
    module_of("bench").main()
    assert len(drawn) == 5  # test_peers.py looks at the files
    assert "fastest method measured" in capsys.readouterr().out

    with (out / "bench.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    data = json.loads((out / "bench.json").read_text())
    assert len(rows) == len(data["measurements"])
    assert {(r["method"], r["count"]) for r in rows} >= {("sobol", "4"), ("sobol", "8"), ("light", "2"), ("exact", "1")}
    for row, measured in zip(rows, data["measurements"], strict=True):
        assert float(row["rmse"]) == measured["rmse"]
        assert sum(measured["stages"].values()) > 0
    assert {r["method"]: r["pixels"] for r in rows} == {
        name: "areas" if name.startswith(("bsdf", "mis", "exact-areas")) else "centres"
        for name in {r["method"] for r in rows}
    }
    for row in rows:
        assert bool(row["estimated"]) == (row["kind"] == "per pixel")
    assert max(float(r["rmse"]) for r in rows if r["method"].startswith("exact")) < 1e-6  # with its own exact image
    sobol = next(r for r in rows if r["method"] == "sobol")
    assert {f"stage {s}" for s in ("row cdf", "marginal cdf", "search", "shade", "download")} <= {
        name for name, value in sobol.items() if value
    }
    for section in ("machine", "device", "versions", "map", "options"):
        assert data[section]
    assert {p.name for p in out.iterdir()} == {
        "bench.csv",
        "bench.json",
        *(f"{plot}.png" for plot in ("error_time", "error_time_all", "error_count", "stages", "images")),
    }


def test_an_unknown_method_is_refused_before_anything_is_loaded(script: Script, tmp_path: Path) -> None:
    (tmp_path / "numpy.py").write_text("raise ImportError('numpy was loaded')")
    (tmp_path / "pyopencl.py").write_text("raise ImportError('pyopencl was loaded')")
    result = script("bench", "--methods", "sobol", "magic", "--out", tmp_path / "out", PYTHONPATH=str(tmp_path))
    assert result.returncode == 2
    assert "magic" in result.stderr
    assert all(name in result.stderr for name in METHODS)
    assert not (tmp_path / "out").exists()


def test_the_help_names_every_method(script: Script) -> None:
    text = "".join(script("bench", "--help").stdout.split())
    assert ",".join(METHODS) in text


def test_the_names_on_the_command_line_are_the_methods(device: Device) -> None:
    assert tuple(benchmark.methods(device, EnvironmentMap(np.ones((4, 8, 3))), R)) == METHODS


def test_a_named_pbrt_is_a_peer(run_here: Script, tmp_path: Path) -> None:
    write_image(tmp_path / "map.pfm", stiff_radiance(8, 16))
    options = ("--methods", "r2", "--counts", 4, "--spp", 1, "--resolution", 9, "--seeds", 1, "--repeats", 1)
    result = run_here("bench", "--map", tmp_path / "map.pfm", *options, "--pbrt", tmp_path, "--out", tmp_path / "out")
    assert result.returncode == 0, result.stderr
    assert f"peer pbrt {tmp_path}: absent (no program pbrt, pbrt-r4, pbrt-r3 in the folder {tmp_path}" in result.stdout


def test_a_method_is_random_if_another_seed_gives_another_image(device: Device) -> None:
    found = benchmark.methods(device, EnvironmentMap(stiff_radiance(9, 14)), 40)
    for name, method in found.items():
        images = [method.run(4, seed) for seed in (1, 2)]
        assert method.random == (not np.array_equal(*images)), name
