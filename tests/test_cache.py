"""The exact image is computed once per map, resolution and convention, and never believed blindly."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import stiff_radiance
from lightdome.cache import key_of
from lightdome.lighting import exact as exact_module
from lightdome.maps.envmap import EnvironmentMap
from lightdome.opencl.device import Device
from lightdome.opencl.programs import Programs


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[int]:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    made: list[int] = []

    def exact(device: Device, envmap: EnvironmentMap, resolution: int, *, pixels: str) -> np.ndarray:
        made.append(resolution)
        return np.full((resolution, resolution, 3), envmap.radiance.sum(), np.float32)

    monkeypatch.setattr(exact_module, "exact", exact)
    return made


def test_the_same_image_is_computed_once(device: Device, calls: list[int]) -> None:
    envmap = EnvironmentMap(np.ones((4, 8, 3)))
    first = exact_module.exact_kept(device, envmap, 5)
    np.testing.assert_array_equal(exact_module.exact_kept(device, EnvironmentMap(np.ones((4, 8, 3))), 5), first)
    assert calls == [5]


def test_another_map_resolution_integral_or_convention_is_another_image(
    device: Device, calls: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    exact_module.exact_kept(device, EnvironmentMap(np.ones((4, 8, 3))), 5)
    exact_module.exact_kept(device, EnvironmentMap(np.ones((8, 4, 3))), 5)
    exact_module.exact_kept(device, EnvironmentMap(np.eye(4, 8)[..., None].repeat(3, 2)), 5)
    exact_module.exact_kept(device, EnvironmentMap(np.ones((4, 8, 3))), 6)
    exact_module.exact_kept(device, EnvironmentMap(np.ones((4, 8, 3))), 5, "areas")
    monkeypatch.setattr(exact_module, "CONVENTION", "upside down")
    exact_module.exact_kept(device, EnvironmentMap(np.ones((4, 8, 3))), 5)
    assert calls == [5, 5, 5, 6, 5, 5]


@pytest.mark.parametrize(
    ("kernel", "text", "other"),
    [
        ("lighting/arc_sums", "const float weight = row_weight[y];", "const float weight = 2.0f * row_weight[y];"),
        ("lighting/exact", "add_to_pixel(light_of(", "add_to_pixel(2.0f * light_of("),
        ("lighting/exact_areas", "float3 rgb = light_of(", "float3 rgb = 2.0f * light_of("),
        ("lighting/exact", "return (float3)(a, b, c2", "return (float3)(a, -b, c2"),
    ],
    ids=["of both", "of centres", "of areas", "a header"],
)
def test_an_image_of_other_kernels_is_not_used(
    device: Device, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, kernel: str, text: str, other: str
) -> None:
    class Changed(Programs):
        def text(self, name: str) -> str:
            assert name != kernel or text in super().text(name)
            return super().text(name).replace(text, other) if name == kernel else super().text(name)

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    envmap = EnvironmentMap(stiff_radiance(9, 14))
    changed = replace(device, programs=Changed(device.context, FUSED=1))
    for pixels in exact_module.PIXELS:
        kept = exact_module.exact_kept(device, envmap, 5, pixels)
        again = exact_module.exact_kept(changed, envmap, 5, pixels)
        np.testing.assert_array_equal(again, exact_module.exact(changed, envmap, 5, pixels=pixels))
        is_concerned = kernel in ("lighting/arc_sums", exact_module.KERNELS[pixels])
        assert np.allclose(again, kept) != is_concerned
        np.testing.assert_array_equal(exact_module.exact_kept(device, envmap, 5, pixels), kept)


def test_a_damaged_image_is_computed_again(device: Device, calls: list[int], tmp_path: Path) -> None:
    envmap = EnvironmentMap(np.ones((4, 8, 3)))
    image = exact_module.exact_kept(device, envmap, 5)
    (path,) = (tmp_path / "lightdome" / "exact").iterdir()
    for damaged in (path.read_bytes()[:-1], b"\1" + path.read_bytes()[1:], b""):
        path.write_bytes(damaged)
        np.testing.assert_array_equal(exact_module.exact_kept(device, envmap, 5), image)
    assert len(calls) == 4


def test_without_a_place_nothing_is_kept(
    device: Device, calls: list[int], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    for _ in range(2):
        exact_module.exact_kept(device, EnvironmentMap(np.ones((4, 8, 3))), 5)
    assert calls == [5, 5]


def test_parts_of_a_key_do_not_run_into_each_other() -> None:
    assert key_of("ab", "c") != key_of("a", "bc")
