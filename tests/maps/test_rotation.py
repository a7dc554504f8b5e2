"""Rotations of maps: exact by whole columns; others keep flux and directions."""

from __future__ import annotations

import math

import numpy as np
import pytest
from helpers import stiff_radiance
from lightdome import reference
from lightdome.errors import LightdomeError
from lightdome.maps.envmap import EnvironmentMap
from lightdome.maps.rotation import rotation_matrix, whole_columns


def turned(direction: np.ndarray, axis: int, degrees: float) -> np.ndarray:
    """A direction turned about an axis by Rodrigues' formula."""
    k = np.eye(3)[axis]
    angle = math.radians(degrees)
    across = np.cross(k, direction)
    return direction * math.cos(angle) + across * math.sin(angle) + k * (k @ direction) * (1 - math.cos(angle))


def flux(envmap: EnvironmentMap) -> np.ndarray:
    solid_angle = reference.pixel_solid_angles(envmap.height, envmap.width)
    return np.einsum("yx,yxc->c", solid_angle, envmap.radiance.astype(np.float64))


def test_roll_comes_first_then_pitch_then_yaw() -> None:
    direction = np.array([0.48, 0.6, -0.64])
    expected = turned(turned(turned(direction, 2, 33), 0, -71), 1, 250)
    np.testing.assert_allclose(rotation_matrix(250, -71, 33) @ direction, expected, atol=1e-15)
    np.testing.assert_allclose(np.linalg.det(rotation_matrix(250, -71, 33)), 1)


def test_quarter_turns_are_exact_and_follow_the_right_hand() -> None:
    x, y, z = np.eye(3)
    np.testing.assert_array_equal(rotation_matrix(90) @ z, x)
    np.testing.assert_array_equal(rotation_matrix(0, 90) @ y, z)
    np.testing.assert_array_equal(rotation_matrix(0, 0, 90) @ x, y)
    for angles in ((-450, 720, -90), (1e6 * 360 + 180, 0, 270), (np.float32(90), np.int64(180), 0)):
        matrix = rotation_matrix(*angles)
        np.testing.assert_array_equal(np.abs(matrix), np.abs(matrix).round())
        assert not np.signbit(matrix[matrix == 0]).any()


@pytest.mark.parametrize("width", [1, 2, 8, 43, 1000])
def test_a_yaw_by_whole_columns_moves_the_pixels_as_they_are(width: int) -> None:
    radiance = stiff_radiance(3, width)
    for columns in (0, 1, -1, width // 3, 5 * width + 2, -7 * width - 1):
        rotated = EnvironmentMap(radiance).rotated(columns * 360 / width)
        np.testing.assert_array_equal(rotated.radiance, np.roll(radiance, -columns, axis=1))
        assert not rotated.radiance.flags.writeable
        assert rotated.peak == radiance.max()


def test_a_whole_column_is_the_rotation_of_its_directions() -> None:
    matrix = rotation_matrix(3 * 360 / 12)
    moved = whole_columns(12, matrix)
    assert moved == 9
    directions = reference.directions(5, 12)
    np.testing.assert_allclose(np.roll(directions @ matrix.T, moved, axis=1), directions, atol=1e-14)


def test_a_pitch_and_a_roll_of_180_are_a_yaw_of_180() -> None:
    radiance = stiff_radiance(3, 8)
    rotated = EnvironmentMap(radiance).rotated(90, 180, 180)
    np.testing.assert_array_equal(rotated.radiance, np.roll(radiance, -6, axis=1))
    assert whole_columns(8, rotation_matrix(0, 180)) is None
    assert whole_columns(8, rotation_matrix(44.99)) is None


@pytest.mark.parametrize("angles", [(7.3,), (0, 90), (0, 180), (20, 30, 40), (0, 0, -90), (123, -45, 260)])
def test_any_other_rotation_keeps_the_flux(angles: tuple[float, ...]) -> None:
    envmap = EnvironmentMap(stiff_radiance(18, 36))
    rotated = envmap.rotated(*angles)
    assert rotated.radiance.shape == envmap.radiance.shape
    assert rotated.peak == rotated.radiance.max()
    np.testing.assert_allclose(flux(rotated), flux(envmap), rtol=1e-5)


@pytest.mark.parametrize("pixel", [(0, 5), (17, 0), (9, 35), (4, 20)])
@pytest.mark.parametrize("angles", [(7.3,), (0, 90), (20, 30, 40)])
def test_a_bright_pixel_arrives_where_its_direction_is_turned(
    pixel: tuple[int, int], angles: tuple[float, ...]
) -> None:
    height, width = 18, 36
    radiance = np.zeros((height, width, 3), np.float32)
    radiance[pixel] = 1
    rotated = EnvironmentMap(radiance).rotated(*angles).radiance[..., 0]
    light = rotated * reference.pixel_solid_angles(height, width)
    mean = np.einsum("yx,yxc->c", light, reference.directions(height, width))
    expected = rotation_matrix(*angles) @ reference.directions(height, width)[pixel]
    assert math.degrees(math.acos(min(1, mean @ expected / np.linalg.norm(mean)))) < 180 / height / 2


def test_a_mirrored_map_has_z_the_other_way_round() -> None:
    radiance = stiff_radiance(4, 8)
    mirrored = EnvironmentMap(radiance).mirrored()
    assert not mirrored.radiance.flags.writeable
    np.testing.assert_array_equal(mirrored.mirrored().radiance, radiance)
    where = reference.directions(4, 8)
    for y, x in np.ndindex(4, 8):
        seen = np.abs(where - where[y, x] * (1, 1, -1)).sum(axis=2).argmin()
        np.testing.assert_array_equal(mirrored.radiance.reshape(-1, 3)[seen], radiance[y, x])


def test_what_a_file_said_stays_with_the_map() -> None:
    radiance = stiff_radiance(4, 8)
    radiance[2, 2] = np.nan
    envmap = EnvironmentMap(radiance, sanitize=True)
    for other in (envmap.rotated(45), envmap.rotated(10, 20), envmap.mirrored()):
        assert other.replaced == envmap.replaced


@pytest.mark.parametrize("angles", [(math.nan,), (0, math.inf), (0, 0, -math.inf), ("90",), (None,), (10**400,)])
def test_angles_that_are_no_finite_numbers_are_refused(angles: tuple[float, ...]) -> None:
    with pytest.raises(LightdomeError, match=r"^(yaw|pitch|roll) must be a finite angle in degrees, got [^\n]*$"):
        EnvironmentMap(np.ones((2, 4, 3), np.float32)).rotated(*angles)
