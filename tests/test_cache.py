"""The exact image is computed once per map, resolution and integral, and checked when it is read back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import stiff_radiance
from lightdome.cache import key_of
from lightdome.lighting.exact import KERNELS, PIXELS, exact, exact_kept
from lightdome.maps.envmap import EnvironmentMap
from lightdome.opencl.device import Device
from lightdome.opencl.programs import Kernel, Programs


class Counted(Programs):
    """Programs that count the images they sum."""

    images = 0

    def kernel(self, name: str, **defines: int) -> Kernel:
        self.images += name in KERNELS.values()  # once per image, for maps as small as these
        return super().kernel(name, **defines)


@pytest.fixture
def counting(device: Device, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Device:
    """A device with :class:`Counted` programs, and an empty cache."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return replace(device, programs=Counted(device.context, FUSED=1))


def test_the_same_image_is_computed_once(counting: Device) -> None:
    first = exact_kept(counting, EnvironmentMap(np.ones((4, 8, 3))), 5)
    np.testing.assert_array_equal(exact_kept(counting, EnvironmentMap(np.ones((4, 8, 3))), 5), first)
    assert counting.programs.images == 1


def test_another_map_resolution_or_integral_is_another_image(counting: Device) -> None:
    exact_kept(counting, EnvironmentMap(np.ones((4, 8, 3))), 5)
    exact_kept(counting, EnvironmentMap(np.ones((8, 4, 3))), 5)
    exact_kept(counting, EnvironmentMap(np.eye(4, 8)[..., None].repeat(3, 2)), 5)
    exact_kept(counting, EnvironmentMap(np.ones((4, 8, 3))), 6)
    exact_kept(counting, EnvironmentMap(np.ones((4, 8, 3))), 5, "areas")
    assert counting.programs.images == 5


@pytest.mark.parametrize(
    ("kernel", "text", "other"),
    [
        ("lighting/arc_sums", "const float weight = row_weight[y];", "const float weight = 2.0f * row_weight[y];"),
        ("lighting/exact", "add_to_pixel(light_of(", "add_to_pixel(2.0f * light_of("),
        ("lighting/exact_areas", "add_to_pixel(light_of(", "add_to_pixel(2.0f * light_of("),
        ("lighting/exact", "*y = b * inverse", "*y = -b * inverse"),
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
    for pixels in PIXELS:
        kept = exact_kept(device, envmap, 5, pixels)
        again = exact_kept(changed, envmap, 5, pixels)
        np.testing.assert_array_equal(again, exact(changed, envmap, 5, pixels=pixels))
        is_concerned = kernel in ("lighting/arc_sums", KERNELS[pixels])
        assert np.allclose(again, kept) != is_concerned
        np.testing.assert_array_equal(exact_kept(device, envmap, 5, pixels), kept)


def test_a_damaged_image_is_computed_again(counting: Device, tmp_path: Path) -> None:
    envmap = EnvironmentMap(np.ones((4, 8, 3)))
    image = exact_kept(counting, envmap, 5)
    (path,) = (tmp_path / "lightdome" / "exact").iterdir()
    for damaged in (path.read_bytes()[:-1], b"\1" + path.read_bytes()[1:], b""):
        path.write_bytes(damaged)
        np.testing.assert_array_equal(exact_kept(counting, envmap, 5), image)
    assert counting.programs.images == 4


def test_without_a_folder_nothing_is_kept(counting: Device, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    for _ in range(2):
        exact_kept(counting, EnvironmentMap(np.ones((4, 8, 3))), 5)
    assert counting.programs.images == 2


def test_parts_of_a_key_do_not_run_into_each_other() -> None:
    assert key_of("ab", "c") != key_of("a", "bc")
