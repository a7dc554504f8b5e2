"""The exact image is computed once per map, resolution and convention, and never believed blindly."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from lightdome import sphere
from lightdome.cache import key_of
from lightdome.device import Device
from lightdome.envmap import EnvironmentMap


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[int]:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    made: list[int] = []

    def exact(device: Device, envmap: EnvironmentMap, resolution: int, *, pixels: str) -> np.ndarray:
        made.append(resolution)
        return np.full((resolution, resolution, 3), envmap.radiance.sum(), np.float32)

    monkeypatch.setattr(sphere, "exact", exact)
    return made


def test_the_same_image_is_computed_once(device: Device, calls: list[int]) -> None:
    envmap = EnvironmentMap(np.ones((4, 8, 3)))
    first = sphere.exact_kept(device, envmap, 5)
    np.testing.assert_array_equal(sphere.exact_kept(device, EnvironmentMap(np.ones((4, 8, 3))), 5), first)
    assert calls == [5]


def test_another_map_resolution_integral_or_convention_is_another_image(
    device: Device, calls: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    sphere.exact_kept(device, EnvironmentMap(np.ones((4, 8, 3))), 5)
    sphere.exact_kept(device, EnvironmentMap(np.ones((8, 4, 3))), 5)
    sphere.exact_kept(device, EnvironmentMap(np.eye(4, 8)[..., None].repeat(3, 2)), 5)
    sphere.exact_kept(device, EnvironmentMap(np.ones((4, 8, 3))), 6)
    sphere.exact_kept(device, EnvironmentMap(np.ones((4, 8, 3))), 5, "areas")
    monkeypatch.setattr(sphere, "CONVENTION", "upside down")
    sphere.exact_kept(device, EnvironmentMap(np.ones((4, 8, 3))), 5)
    assert calls == [5, 5, 5, 6, 5, 5]


def test_a_damaged_image_is_computed_again(device: Device, calls: list[int], tmp_path: Path) -> None:
    envmap = EnvironmentMap(np.ones((4, 8, 3)))
    image = sphere.exact_kept(device, envmap, 5)
    (path,) = (tmp_path / "lightdome" / "exact").iterdir()
    for damaged in (path.read_bytes()[:-1], b"\1" + path.read_bytes()[1:], b""):
        path.write_bytes(damaged)
        np.testing.assert_array_equal(sphere.exact_kept(device, envmap, 5), image)
    assert len(calls) == 4


def test_without_a_place_nothing_is_kept(
    device: Device, calls: list[int], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    for _ in range(2):
        sphere.exact_kept(device, EnvironmentMap(np.ones((4, 8, 3))), 5)
    assert calls == [5, 5]


def test_parts_of_a_key_do_not_run_into_each_other() -> None:
    assert key_of("ab", "c") != key_of("a", "bc")
