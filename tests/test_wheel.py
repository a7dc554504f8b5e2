"""The package as a wheel installs it, from an empty folder: the program of the README, the commands, the types."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import venv
from pathlib import Path

import numpy as np
import pytest
from helpers import LONG, ROOT
from lightdome.maps.images import read_image
from lightdome.sampling.samples import Samples

pytestmark = pytest.mark.slow


def run(*command: object, folder: Path) -> str:
    """Run a command, which must succeed; returns its output."""
    words = [*map(str, command)]
    result = subprocess.run(words, capture_output=True, text=True, timeout=LONG, cwd=folder)
    assert result.returncode == 0, f"{words}\n{result.stdout}{result.stderr}"
    return result.stdout


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A new environment with a wheel built from the source archive, and with the dependencies of the tests."""
    pytest.importorskip("build", reason="needs build, of the extra [dev]")
    folder = tmp_path_factory.mktemp("wheel")
    (folder / "clone").mkdir()
    leave = shutil.ignore_patterns("__pycache__", "grace_latlong.exr")
    for path in ROOT.iterdir():
        if path.name in ("pyhost", "clkernels", "data"):
            shutil.copytree(path, folder / "clone" / path.name, ignore=leave)
        elif path.suffix in (".cfg", ".py", ".toml", ".md") or path.name == "LICENSE":
            shutil.copy(path, folder / "clone")
    command = [sys.executable, "-m", "build", "--outdir", str(folder), str(folder / "clone")]
    built = subprocess.run(command, capture_output=True, text=True, timeout=LONG)
    if "No matching distribution found for setuptools" in built.stdout + built.stderr:
        pytest.skip("needs a network: the build tools cannot be fetched")
    assert built.returncode == 0, built.stdout + built.stderr
    (wheel,) = folder.glob("*.whl")
    venv.create(folder / "venv", with_pip=False)
    python = folder / "venv" / "bin" / "python"
    run(sys.executable, "-m", "pip", "--python", python, "install", "--no-index", "--no-deps", wheel, folder=folder)
    (packages,) = (folder / "venv").glob("lib/python*/site-packages")
    assert (packages / "lightdome" / "data" / "default.exr").read_bytes() == (
        ROOT / "data" / "default.exr"
    ).read_bytes()
    assert [path.name for path in (packages / "lightdome" / "data").iterdir()] == ["default.exr"]
    (packages / "of_the_tests.pth").write_text(f"{Path(np.__file__).parents[1]}\n")
    return folder / "venv" / "bin"


def test_the_program_of_the_readme_runs(environment: Path, tmp_path: Path) -> None:
    (program,) = re.findall(r"^```python\n(.*?)^```$", (ROOT / "README.md").read_text(), re.MULTILINE | re.DOTALL)
    assert len(program.splitlines()) <= 10
    (tmp_path / "program.py").write_text(program.replace("511", "31") + "print(lightdome.__file__)")
    said = run(environment / "python", "program.py", folder=tmp_path)
    assert str(environment.parent) in said.splitlines()[-1]
    assert read_image(tmp_path / "sphere.pfm").shape == (31, 31, 3)


def test_commands_run_on_the_map_that_is_installed(environment: Path, tmp_path: Path) -> None:
    lightdome = environment / "lightdome"
    said = run(lightdome, "sample", "--counts", 4, "--samples-only", folder=tmp_path)
    (map_line,) = (line for line in said.splitlines() if line.startswith("map: "))
    assert re.fullmatch(f"map: {environment.parent}/.*/lightdome/data/default.exr, 1024 x 512", map_line)
    assert len(Samples.load(tmp_path / "out" / "part2" / "samples_4.npz")) == 4
    sphere = ("--resolution", 15, "--format", "exr")
    run(lightdome, "render", "--spp", 1, "--estimator", "mis", *sphere, folder=tmp_path)
    run(lightdome, "exact", "--pixels", "areas", *sphere, folder=tmp_path)
    images = [read_image(tmp_path / "out" / name) for name in ("part4/sphere_1spp.exr", "exact/exact_areas.exr")]
    assert images[0].mean() == pytest.approx(images[1].mean(), rel=0.5)


def test_results_are_checked_against_the_map_that_is_installed(environment: Path, tmp_path: Path) -> None:
    lightdome = environment / "lightdome"
    run(lightdome, "sample", "--counts", 64, "--samples-only", folder=tmp_path)
    samples = tmp_path / "out" / "part2" / "samples_64.npz"
    run(lightdome, "shade", samples, "--resolution", 31, folder=tmp_path)
    assert run(lightdome, "check", "samples", samples, folder=tmp_path).startswith("agrees: ")
    image = ("check", "image", tmp_path / "out" / "part3" / "sphere_64.pfm", "--samples", 64, "--json")
    found = json.loads(run(lightdome, *image, folder=tmp_path))
    assert found["agrees"] is True
    assert found["expected"]["samples"] == 64
    (tmp_path / "curve.csv").write_text("angle_degrees,p,s\n0,0.0278,0.0278\n45,0.0685,0.0047\n90,1,1\n")
    words = [str(lightdome), "check", "fresnel", "curve.csv"]
    wrong = subprocess.run(words, capture_output=True, text=True, timeout=LONG, cwd=tmp_path)
    assert wrong.returncode == 1
    assert wrong.stdout.startswith("does not agree; p and s swapped: ")


def test_without_opencl_one_line_says_what_to_do(environment: Path, tmp_path: Path) -> None:
    (tmp_path / "vendors").mkdir()
    words = [str(environment / "lightdome"), "render", "--spp", "1", "--resolution", "15"]
    nothing = {**os.environ, "OCL_ICD_VENDORS": str(tmp_path / "vendors"), "XDG_CACHE_HOME": str(tmp_path)}
    ended = subprocess.run(words, capture_output=True, text=True, timeout=LONG, cwd=tmp_path, env=nothing)
    assert ended.returncode == 1
    assert re.fullmatch(r"lightdome render: no OpenCL device works here.*; for one that does: .*\n", ended.stderr)


def test_a_user_s_program_has_the_right_types(environment: Path, tmp_path: Path) -> None:
    pytest.importorskip("mypy", reason="needs mypy, of the extra [dev]")
    shutil.copy(ROOT / "tests" / "user_code.py", tmp_path)
    wrong = 'import lightdome\nlightdome.Samples.load("a.npz")[0].flux\nlightdome.exact(pixels=1)\n'
    (tmp_path / "wrong.py").write_text(wrong)
    check = [sys.executable, "-m", "mypy", "--strict", "--python-executable", str(environment / "python")]
    words = [*check, "--no-incremental", "user_code.py", "wrong.py"]
    result = subprocess.run(words, capture_output=True, text=True, timeout=LONG, cwd=tmp_path)
    found = re.findall(r"^(\S+?:\d+): error", result.stdout, re.MULTILINE)
    assert found == ["wrong.py:2", "wrong.py:3", "wrong.py:3"], result.stdout + result.stderr
