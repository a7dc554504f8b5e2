"""Presets compared with the programs' formulas, written out, and with the programs themselves."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import conventions as programs
import numpy as np
import pytest
from helpers import stiff_radiance
from lightdome import reference
from lightdome.errors import LightdomeError
from lightdome.maps.conventions import PRESETS, from_uv, to_axes, to_uv, yaw_between
from lightdome.maps.envmap import EnvironmentMap
from lightdome.maps.images import write_image
from lightdome.names import CONVENTIONS
from lightdome.pbrt.run import Pbrt

Formula = Callable[[float, float, float], tuple[float, float]]

# (u, v) of a direction in the program's own axes, as in its source; v is flipped if it grows upwards.
FORMULAS: dict[str, Formula] = {
    "lightdome": lambda x, y, z: (math.atan2(z, x) / (2 * math.pi), math.acos(y) / math.pi),
    "pbrt": lambda x, y, z: (math.atan2(y, x) / (2 * math.pi), math.acos(z) / math.pi),
    "mitsuba": lambda x, y, z: (math.atan2(x, -z) / (2 * math.pi), math.acos(y) / math.pi),
    "cycles": lambda x, y, z: (
        (math.atan2(y, x) - math.pi) / (-2 * math.pi),
        1 - (math.acos(z) - math.pi) / (-math.pi),
    ),
    "gltf": lambda x, y, z: (math.atan2(z, x) / (2 * math.pi) + 0.5, 1 - (math.asin(y) / math.pi + 0.5)),
    "skylibs": lambda x, y, z: ((1 + math.atan2(x, -z) / math.pi) / 2, math.acos(y) / math.pi),
}
# Lightdome's (x, y, z) in the program's axes.
AXES = {"pbrt": lambda x, y, z: (x, z, y), "cycles": lambda x, y, z: (x, -z, y)}


def some_directions() -> np.ndarray:
    d = np.random.default_rng(3).normal(size=(50, 3))
    d /= np.linalg.norm(d, axis=1)[:, None]
    seam = [[1, -1e-20, 1e-20], [1, 1e-20, -1e-20], [-1e-20, -1e-20, -1], [1e-20, 1e-20, 1], [-1, 0, 0]]
    return np.concatenate([d, seam, -np.array(seam)])


def test_there_is_a_preset_for_every_name() -> None:
    assert tuple(PRESETS) == CONVENTIONS == tuple(FORMULAS)


@pytest.mark.parametrize("name", CONVENTIONS)
def test_a_direction_lies_where_the_programs_formula_has_it(name: str) -> None:
    for direction, (u, v) in zip(some_directions(), to_uv(some_directions(), name), strict=True):
        expected_u, expected_v = FORMULAS[name](*direction)
        assert (u - expected_u + 0.5) % 1 == pytest.approx(0.5, abs=1e-14)
        assert v == pytest.approx(expected_v, abs=1e-14)
        assert 0 <= u < 1
    assert to_uv([[0, 3, 0], [0, 0, 3]], name)[:, 1].tolist() == ([0.5, 0] if name in AXES else [0, 0.5])


@pytest.mark.parametrize("name", CONVENTIONS)
def test_a_place_and_its_direction_lead_to_each_other(name: str) -> None:
    d = some_directions()
    np.testing.assert_allclose(from_uv(*to_uv(d, name).T, name), d, atol=1e-15)
    u, v = np.meshgrid((np.arange(8) + 0.5) / 8, (np.arange(4) + 0.5) / 4)
    np.testing.assert_allclose(to_uv(from_uv(u, v, name), name), np.stack([u, v], axis=-1), atol=1e-15)


@pytest.mark.parametrize("kind", [np.float32, np.float64, np.uint8])
@pytest.mark.parametrize("name", CONVENTIONS)
def test_axes_change_exactly(name: str, kind: type) -> None:
    d = (10 * some_directions()).astype(kind)
    there = to_axes(d, name)
    expected = np.stack(AXES.get(name, lambda *xyz: xyz)(*d.T.astype(there.dtype)), axis=1)
    np.testing.assert_array_equal(there, expected)
    np.testing.assert_array_equal(to_axes(there, "lightdome", name), d)
    np.testing.assert_array_equal(to_axes(to_axes(d, "cycles"), name, "cycles"), there)
    assert there.dtype == (np.float64 if kind is np.uint8 else kind)


@pytest.mark.parametrize("name", CONVENTIONS)
def test_up_stays_up_and_only_pbrts_axes_are_left_handed(name: str) -> None:
    x, y, z = to_axes(np.eye(3), name)
    assert np.dot(np.cross(x, y), z) == (-1 if name == "pbrt" else 1)
    assert tuple(y) == ((0, 0, 1) if name in AXES else (0, 1, 0))


@pytest.mark.parametrize("name", CONVENTIONS)
def test_the_program_sees_each_pixel_in_its_direction(name: str) -> None:
    envmap = EnvironmentMap(stiff_radiance(6, 12))
    file = envmap.to_convention(name)
    for y, x in np.ndindex(6, 12):
        direction = reference.directions(6, 12)[y, x]
        u, v = FORMULAS[name](*AXES.get(name, lambda *xyz: xyz)(*direction))
        np.testing.assert_array_equal(file.radiance[int(6 * v), int(12 * (u % 1))], envmap.radiance[y, x])


@pytest.mark.parametrize("name", CONVENTIONS)
def test_there_and_back_no_bit_changes(name: str) -> None:
    envmap = EnvironmentMap(stiff_radiance(5, 8))
    back = envmap.to_convention(name).to_convention("lightdome", from_=name)
    np.testing.assert_array_equal(back.radiance, envmap.radiance)
    via = envmap.to_convention("skylibs").to_convention(name, from_="skylibs")
    np.testing.assert_array_equal(via.radiance, envmap.to_convention(name).radiance)


def test_half_turns_are_exact_where_the_width_is_even() -> None:
    radiance = stiff_radiance(5, 6)
    np.testing.assert_array_equal(EnvironmentMap(radiance).to_convention("gltf").radiance, np.roll(radiance, 3, axis=1))


def test_other_widths_are_resampled_and_keep_their_flux() -> None:
    envmap = EnvironmentMap(stiff_radiance(9, 18))
    turned = envmap.to_convention("mitsuba")
    solid_angle = reference.pixel_solid_angles(9, 18)
    flux, expected = (np.einsum("yx,yxc->c", solid_angle, m.radiance.astype(float)) for m in (turned, envmap))
    np.testing.assert_allclose(flux, expected, rtol=1e-5)


def test_a_map_is_read_in_its_convention(tmp_path: Path) -> None:
    envmap = EnvironmentMap(stiff_radiance(4, 8))
    for name in CONVENTIONS:
        write_image(tmp_path / f"{name}.pfm", envmap.to_convention(name).radiance)
        read = EnvironmentMap.read(tmp_path / f"{name}.pfm", convention=name)
        np.testing.assert_array_equal(read.radiance, envmap.radiance)
        assert read.peak == envmap.peak


def test_the_file_says_where_a_pixel_is_bad(tmp_path: Path) -> None:
    radiance = np.ones((4, 8, 3), np.float32)
    radiance[1, 2] = -1
    write_image(tmp_path / "bad.pfm", radiance)
    with pytest.raises(LightdomeError, match="x = 2, y = 1"):
        EnvironmentMap.read(tmp_path / "bad.pfm", convention="gltf")
    read = EnvironmentMap.read(tmp_path / "bad.pfm", convention="gltf", sanitize=True)
    assert read.replaced is not None
    assert read.replaced.pixels == 1
    assert not read.radiance[1, 6].any()


def test_what_cannot_be_used_is_refused_in_one_line() -> None:
    envmap = EnvironmentMap(np.ones((2, 4, 3), np.float32))
    for call in (
        lambda: envmap.to_convention("unity"),
        lambda: envmap.to_convention("pbrt", from_="Cycles"),
        lambda: EnvironmentMap.read("nowhere.exr", convention="unity"),
        lambda: to_axes([0, 1, 0], None),
        lambda: to_uv([0, 1, 0], "unity"),
        lambda: from_uv(0, 0, "unity"),
        lambda: yaw_between("unity", "pbrt"),
    ):
        with pytest.raises(LightdomeError, match=r"^unknown convention .* lightdome, pbrt, mitsuba[^\n]*$"):
            call()
    for wrong in ([0, 1], 1.0, [[1, 2, 3, 4]], "up"):
        with pytest.raises(LightdomeError, match=r"^direction must be"):
            to_axes(wrong, "pbrt")


# ---- the programs ----

HALF_A_PIXEL = 180 / programs.labelled_map().height / 2


def test_a_wrong_map_is_seen() -> None:
    """Images of the tool's views, made here: right, mirrored and turned."""
    step = np.tan(np.radians(programs.ANGLE / 2)) * (2 * (np.arange(programs.SIZE) + 0.5) / programs.SIZE - 1)

    def images(envmap: EnvironmentMap) -> np.ndarray:
        result = []
        for forward, up in programs.VIEWS:
            towards = forward + step[None, :, None] * np.cross(forward, up) - step[:, None, None] * up
            u, v = np.moveaxis(to_uv(towards), -1, 0)
            result.append(envmap.radiance[(v * envmap.height).astype(int), (u * envmap.width).astype(int)])
        return np.array(result)

    envmap = programs.labelled_map()
    assert programs.differences(images(envmap)).max() < HALF_A_PIXEL / 2
    assert programs.differences(images(envmap.mirrored())).max() > 100
    assert programs.differences(images(envmap.rotated(45))).max() > 40


@pytest.mark.peer
@pytest.mark.parametrize("name", programs.PACKAGES)
def test_a_program_sees_the_labelled_map_as_its_preset_says(name: str) -> None:
    if programs.python_with(programs.PACKAGES[name]) is None:
        pytest.skip(f"needs the package {programs.PACKAGES[name]}, here or in a Python of LIGHTDOME_PEERS")
    assert programs.of_package(name).max() < HALF_A_PIXEL


@pytest.mark.peer
def test_pbrt_sees_the_labelled_map_as_its_preset_says(program: Pbrt) -> None:
    assert programs.of_pbrt(program).max() < HALF_A_PIXEL
