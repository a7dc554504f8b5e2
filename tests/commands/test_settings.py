"""Results record what they were made with, and a record is valid only next to the files it was written for."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest
from helpers import Script, stiff_radiance
from lightdome import __version__
from lightdome.commands import settings
from lightdome.maps.envmap import EnvironmentMap
from lightdome.maps.images import write_image


def test_parts_1_to_4_record_what_made_their_files(run_here: Script, tmp_path: Path) -> None:
    path = tmp_path / "map.pfm"
    write_image(path, stiff_radiance(16, 32))
    assert run_here("part1_fresnel", "--out", tmp_path / "part1").returncode == 0
    assert run_here("part2_sample", "--map", path, "--counts", 3, 7, "--out", tmp_path / "part2").returncode == 0
    samples = [tmp_path / "part2" / f"samples_{n}.npz" for n in (3, 7)]
    assert run_here("part3_shade", *samples, "--resolution", 20, "--out", tmp_path / "part3").returncode == 0
    arguments = ("--map", path, "--spp", 2, "--renderer", "opencl", "--resolution", 20)
    assert run_here("part4_pbrt", *arguments, "--out", tmp_path / "part4").returncode == 0

    found = {}
    for part in ("part1", "part2", "part3", "part4"):
        record = settings.read(tmp_path / part / settings.NAME)
        assert record is not None
        there = {p.name for p in (tmp_path / part).iterdir() if p.is_file()} - {settings.NAME}
        assert set(record["files"]) == there
        assert record["versions"]["lightdome"] == __version__
        found[part] = record
    same_map = {"map": {"sha256": settings.map_sum(EnvironmentMap.read(path))}}
    for part in ("part2", "part4"):
        assert settings.difference(found[part], same_map) is None
        assert found[part]["device"]["name"]
    assert found["part2"]["options"]["counts"] == [3, 7]
    assert found["part3"]["options"]["resolution"] == 20
    assert found["part3"]["inputs"] == {p.name: found["part2"]["files"][p.name] for p in samples}
    assert found["part4"]["pbrt"] is None


def test_samples_without_pictures_record_what_made_them_too(run_here: Script, tmp_path: Path) -> None:
    path, out = tmp_path / "map.pfm", tmp_path / "out"
    write_image(path, stiff_radiance(16, 32))
    assert run_here("part2_sample", "--map", path, "--counts", 3, 7, "--seed", 5, "--out", out).returncode == 0
    whole = settings.read(out / settings.NAME)
    arguments = ("--map", path, "--counts", 7, "--seed", 5, "--samples-only", "--out", out)
    assert run_here("part2_sample", *arguments).returncode == 0
    record = settings.read(out / settings.NAME)
    assert record is not None
    assert record["files"] == {"samples_7.npz": whole["files"]["samples_7.npz"]}
    assert record["map"] == {"width": 32, "height": 16, "file_sha256": hashlib.sha256(path.read_bytes()).hexdigest()}
    assert (record["options"]["seed"], record["options"]["samples_only"]) == (5, True)
    # Not valid for anyone who asks for a map by its radiance.
    assert settings.difference(record, {"map": whole["map"]}) == "map.sha256"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "a.pfm").write_bytes(b"pixels")
    settings.write(tmp_path, settings.settings(None, None, {"out": tmp_path, "samples": [tmp_path]}), ["a.pfm"])
    return tmp_path


def test_paths_are_kept_as_text(folder: Path) -> None:
    record = settings.read(folder / settings.NAME)
    assert record is not None
    assert record["options"] == {"out": str(folder), "samples": [str(folder)]}


@pytest.mark.parametrize("content", [b"other pixels", None])
def test_changed_or_missing_files_have_no_settings(folder: Path, content: bytes | None) -> None:
    (folder / "a.pfm").unlink()
    if content:
        (folder / "a.pfm").write_bytes(content)
    assert settings.read(folder / settings.NAME) is None


@pytest.mark.parametrize("text", ["", "{", "[]", "3", '{"files": 3}', '{"files": {"a.pfm": 1}}', "\xff"])
def test_damaged_settings_count_as_none(folder: Path, text: str) -> None:
    (folder / settings.NAME).write_text(text, encoding="latin-1")
    assert settings.read(folder / settings.NAME) is None


def test_the_first_difference_is_named() -> None:
    found = {"map": {"sha256": "a", "width": 2}, "options": {"spp": [1, 2], "seed": None}}
    assert settings.difference(found, {"map": {"sha256": "a"}, "options": {"spp": [1, 2], "seed": None}}) is None
    assert settings.difference(found, {"map": {"sha256": "b"}}) == "map.sha256"
    assert settings.difference(found, {"options": {"seed": None, "quick": None}}) == "options.quick"
    assert settings.difference(found, {"versions": {"lightdome": "1"}}) == "versions"
    assert settings.difference({"map": None}, {"map": {"sha256": "a"}}) == "map"


def test_the_checksum_of_a_map_is_that_of_its_radiance() -> None:
    one, other = stiff_radiance(4, 8), stiff_radiance(4, 8, seed=2)
    assert settings.map_sum(EnvironmentMap(one)) == settings.map_sum(EnvironmentMap(np.asfortranarray(one)))
    assert settings.map_sum(EnvironmentMap(one)) != settings.map_sum(EnvironmentMap(other))
