"""The exercise for a class: its starter runs with nothing filled in, and a correct solution passes the checks."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import lightdome
import numpy as np
import pytest
import solution
from helpers import ROOT
from lightdome.checking.folder import FolderCheck

STARTER = ROOT / "docs" / "teaching" / "starter.py"
PARTS = ("fresnel", "sample", "shade", "render")


@pytest.fixture
def starter(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    spec = importlib.util.spec_from_file_location("starter", STARTER)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    monkeypatch.setattr(module, "RESOLUTION", 63)
    return module


@pytest.fixture
def small_map(tmp_path: Path) -> Path:
    radiance = lightdome.EnvironmentMap.read(ROOT / "data" / "default.exr").radiance
    lightdome.write_image(tmp_path / "map.pfm", radiance.reshape(64, 8, 128, 8, 3).mean(axis=(1, 3)))
    return tmp_path / "map.pfm"


def test_what_is_not_filled_in_is_reported(
    starter: ModuleType, small_map: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    starter.main(small_map, tmp_path / "out")
    assert capsys.readouterr().out.count("still to do") == 4
    assert not list((tmp_path / "out").glob("*.pfm"))


@pytest.mark.slow
def test_a_correct_solution_passes(
    starter: ModuleType, small_map: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for part in PARTS:
        monkeypatch.setattr(starter, part, getattr(solution, part))
    out = tmp_path / "out"
    starter.main(small_map, out)
    device, envmap = lightdome.open_device(), lightdome.EnvironmentMap.read(small_map)
    for count in starter.COUNTS:
        image = lightdome.read_image(out / f"shaded_{count}.pfm")
        assert lightdome.check_image(device, image, envmap, samples=count).agrees is True
        with np.load(out / f"samples_{count}.npz") as arrays:
            assert lightdome.check_samples(envmap, **arrays).agrees is True
    for spp in starter.SPP:
        image = lightdome.read_image(out / f"rendered_{spp}spp.pfm")
        assert lightdome.check_image(device, image, envmap, spp=spp).agrees is True
    for name, leaving in (("entering", False), ("leaving", True)):
        table = np.genfromtxt(out / f"fresnel_{name}.csv", delimiter=",", names=True)
        curves = np.radians(table["angle_degrees"]), None, table["p"], table["s"]
        assert lightdome.check_fresnel(*curves, eta=1.4, leaving=leaving).agrees is True
    rows = FolderCheck(device, envmap).rows(out)  # for reflectances, the file's name says whether light leaves
    assert [row.file for row in rows if not row.agrees] == []
    assert len(rows) == len(list(out.iterdir()))
