"""Spherical harmonics: nine coefficients as published, and higher orders that approach the exact image."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import stiff_radiance
from lightdome import reference
from lightdome.disc import disc_mask
from lightdome.errors import LightdomeError
from lightdome.lighting.exact import exact
from lightdome.lighting.harmonics import MAX_ORDER, Harmonics, clamped_cosine, project, shade_harmonics
from lightdome.lighting.shade import shade
from lightdome.maps.envmap import EnvironmentMap
from lightdome.maps.rotation import rotation_matrix
from lightdome.opencl.device import Device


def nine(direction: np.ndarray) -> np.ndarray:
    """Y_lm for l = 0 to 2 as Ramamoorthi and Hanrahan print them (equation 3), in our axes: (..., 9)."""
    x, z, y = np.moveaxis(direction, -1, 0)  # their pole is z, ours y
    return np.stack(
        [
            np.full_like(x, 0.282095),
            0.488603 * y,
            0.488603 * z,
            0.488603 * x,
            1.092548 * x * y,
            1.092548 * y * z,
            0.315392 * (3 * z**2 - 1),
            1.092548 * x * z,
            0.546274 * (x**2 - y**2),
        ],
        axis=-1,
    )


def legendre(order: int, x: np.ndarray) -> np.ndarray:
    """Legendre polynomials P_0 .. P_order at x, by Bonnet's recurrence."""
    p = [np.ones_like(x), x]
    for n in range(1, order):
        p.append(((2 * n + 1) * x * p[n] - n * p[n - 1]) / (n + 1))
    return np.array(p[: order + 1])


def cosine_series(order: int) -> np.ndarray:
    """A_l by integration of max(0, cos) P_l over the sphere."""
    t, weight = np.polynomial.legendre.leggauss(200)
    t, weight = (t + 1) / 2, weight / 2
    return 2 * np.pi * (legendre(order, t) * t) @ weight


def point_light(height: int, width: int, x: int, y: int) -> EnvironmentMap:
    radiance = np.zeros((height, width, 3), np.float32)
    radiance[y, x] = (1, 2, 3)
    return EnvironmentMap(radiance)


def test_the_clamped_cosines_coefficients_are_its_integrals() -> None:
    np.testing.assert_allclose(clamped_cosine(MAX_ORDER), cosine_series(MAX_ORDER), atol=1e-12)
    np.testing.assert_allclose(clamped_cosine(4), [np.pi, 2.094395, 0.785398, 0, -0.130900], atol=1e-6)
    assert len(clamped_cosine(0)) == 1


@pytest.mark.parametrize("shape", [(21, 43), (32, 64), (1, 5)])
def test_nine_coefficients_are_the_published_ones(device: Device, shape: tuple[int, int]) -> None:
    radiance = stiff_radiance(*shape)
    light = radiance * reference.pixel_solid_angles(*shape)[..., None]
    expected = np.einsum("yxk,yxc->kc", nine(reference.directions(*shape)), light)
    found = project(device, EnvironmentMap(radiance), 2).coefficients
    np.testing.assert_allclose(found, expected, atol=3e-6 * np.abs(expected).max())


def test_order_2_is_the_published_quadratic_form(device: Device) -> None:
    envmap = EnvironmentMap(stiff_radiance(21, 43))
    harmonics = project(device, envmap)
    image = shade_harmonics(device, harmonics, 41, albedo=0.7)
    mask = disc_mask(41)
    c1, c2, c3, c4, c5 = 0.429043, 0.511664, 0.743125, 0.886227, 0.247708
    for channel in range(3):
        L = harmonics.coefficients[:, channel]
        # Equation 12; rows are (x, y, z, 1) in their axes.
        M = np.array(
            [
                [c1 * L[8], c1 * L[4], c1 * L[7], c2 * L[3]],
                [c1 * L[4], -c1 * L[8], c1 * L[5], c2 * L[1]],
                [c1 * L[7], c1 * L[5], c3 * L[6], c2 * L[2]],
                [c2 * L[3], c2 * L[1], c2 * L[2], c4 * L[0] - c5 * L[6]],
            ]
        )
        n = reference.normals(41)[mask]
        n = np.stack([n[:, 0], n[:, 2], n[:, 1], np.ones(len(n))], axis=1)
        expected = 0.7 / np.pi * np.einsum("ni,ij,nj->n", n, M, n)
        np.testing.assert_allclose(image[mask][:, channel], expected, atol=5e-6 * np.abs(expected).max())
    assert not image[~mask].any()


@pytest.mark.parametrize(("x", "y"), [(3, 5), (40, 2), (17, 30), (0, 0), (63, 16)])
@pytest.mark.parametrize("order", [0, 1, 2, 7, 30, MAX_ORDER])
def test_one_pixel_gives_the_clamped_cosines_series(device: Device, x: int, y: int, order: int) -> None:
    image = shade_harmonics(device, project(device, point_light(32, 64, x, y), order), 33)
    mask = disc_mask(33)
    cosine = reference.normals(33)[mask] @ reference.directions(32, 64)[y, x]
    n = np.arange(order + 1)
    series = ((2 * n + 1) / (4 * np.pi) * cosine_series(order)) @ legendre(order, cosine)
    flux = reference.pixel_solid_angles(32, 64)[y, x]
    expected = (series * flux / np.pi)[:, None] * (1, 2, 3)
    np.testing.assert_allclose(image[mask], expected, atol=1e-5 * flux)


def some_harmonics(order: int) -> Harmonics:
    return Harmonics(np.random.default_rng(order).normal(size=((order + 1) ** 2, 3)))


def test_nine_rotated_coefficients_are_those_of_the_rotated_light() -> None:
    direction = reference.directions(4, 6).reshape(-1, 3)
    light = np.random.default_rng(2).random((24, 3))
    before = Harmonics(nine(direction).T @ light).rotated(250, -71, 33)
    after = nine(direction @ rotation_matrix(250, -71, 33).T).T @ light
    np.testing.assert_allclose(before.coefficients, after, atol=3e-6)  # the printed factors have six digits


@pytest.mark.slow
@pytest.mark.parametrize("order", [0, 1, 5, 30, MAX_ORDER])
def test_rotated_harmonics_come_back(order: int) -> None:
    harmonics = some_harmonics(order)
    there = harmonics.rotated(20, 30, 40)
    back = there.rotated(-20).rotated(0, -30, 0).rotated(0, 0, -40)
    np.testing.assert_allclose(back.coefficients, harmonics.coefficients, atol=2e-13)
    for n in range(order + 1):
        of_degree = slice(n * n, (n + 1) ** 2)
        power = (harmonics.coefficients[of_degree] ** 2).sum()
        assert (there.coefficients[of_degree] ** 2).sum() == pytest.approx(power, rel=1e-12)


def test_a_yaw_turns_the_phase_of_each_coefficient() -> None:
    harmonics, yaw = some_harmonics(9), np.radians(25)
    turned = harmonics.rotated(25).coefficients
    for n in range(10):
        for m in range(1, n + 1):
            of_cosine, of_sine = harmonics.coefficients[n * n + n + m], harmonics.coefficients[n * n + n - m]
            # Azimuths fall by the yaw.
            c, s = np.cos(m * yaw), np.sin(m * yaw)
            np.testing.assert_allclose(turned[n * n + n + m], c * of_cosine + s * of_sine, atol=1e-13)
            np.testing.assert_allclose(turned[n * n + n - m], c * of_sine - s * of_cosine, atol=1e-13)


@pytest.mark.slow
def test_the_highest_order_turns_as_its_light(device: Device) -> None:
    # Addition theorem: for two directions, degree l gives (2 l + 1) / 4 pi P_l of their cosine.
    one, other = (project(device, point_light(32, 64, *place), MAX_ORDER) for place in ((5, 9), (40, 3)))
    a, b = reference.directions(32, 64)[9, 5], reference.directions(32, 64)[3, 40]
    flux = reference.pixel_solid_angles(32, 64)[9, 5] * reference.pixel_solid_angles(32, 64)[3, 40]
    turned = one.rotated(70, -20, 130).coefficients[:, 0] * other.coefficients[:, 0] / flux
    found = np.add.reduceat(turned, np.arange(MAX_ORDER + 1) ** 2)
    cosine = rotation_matrix(70, -20, 130) @ a @ b
    n = np.arange(MAX_ORDER + 1)
    np.testing.assert_allclose(found, (2 * n + 1) / (4 * np.pi) * legendre(MAX_ORDER, cosine), atol=1e-5)


def test_a_constant_map_is_its_colour(device: Device) -> None:
    envmap = EnvironmentMap(np.full((64, 128, 3), (0.25, 0.5, 1), np.float32))
    image = shade_harmonics(device, project(device, envmap, 0), 16)
    np.testing.assert_allclose(image[disc_mask(16)], np.broadcast_to((0.25, 0.5, 1), (disc_mask(16).sum(), 3)), 1e-5)


def test_higher_orders_approach_the_exact_image(device: Device) -> None:
    envmap = EnvironmentMap(stiff_radiance(64, 128))
    target = exact(device, envmap, 64)
    harmonics = project(device, envmap, MAX_ORDER)
    errors = [
        reference.relative_rmse(shade_harmonics(device, harmonics.truncated(n), 64), target)
        for n in (0, 2, 4, 8, 16, 32, MAX_ORDER)
    ]
    assert (np.diff(errors) < 0).all()
    assert errors[-1] < 1e-3


def test_truncation_is_the_projection_of_lower_order(device: Device, stiff: EnvironmentMap) -> None:
    harmonics = project(device, stiff, 9).truncated(4)
    assert harmonics.order == 4
    np.testing.assert_array_equal(harmonics.coefficients, project(device, stiff, 4).coefficients)


def test_what_was_used_and_skipped_is_reported(device: Device, stiff: EnvironmentMap) -> None:
    device.decisions.take()
    harmonics = project(device, stiff, 5)
    told = {d.what: d.used for d in device.decisions.take()}
    assert (told["separate channels"], told["harmonics above order 5"]) == (True, False)
    for order in (2, 5):
        shade_harmonics(device, harmonics.truncated(order), 33)
        told = {d.what: d.used for d in device.decisions.take()}
        assert (told["separate channels"], told["tiles outside the disc"]) == (True, False)
        assert told.get("odd orders above 1") == (None if order == 2 else False)


@pytest.mark.parametrize("power", [-120, 100])
def test_scaling_the_map_scales_the_coefficients(device: Device, power: int) -> None:
    radiance = np.maximum(stiff_radiance(20, 40), 1e-2)
    plain = project(device, EnvironmentMap(radiance), 6).coefficients
    scaled = project(device, EnvironmentMap(np.ldexp(radiance, power)), 6).coefficients
    np.testing.assert_allclose(np.ldexp(scaled, -power), plain, atol=1e-6 * np.abs(plain).max())


def test_pixels_beside_a_bright_one_keep_their_light(device: Device) -> None:
    # A wide row: sums along it keep, for every coefficient, what float32 alone would lose.
    radiance = np.full((3, 60001, 3), 1e-3, np.float32)
    radiance[:, :15000] = 3e-3
    radiance[1, 77] = 3e3
    light = radiance * reference.pixel_solid_angles(3, 60001)[..., None]
    expected = np.einsum("yxk,yxc->kc", nine(reference.directions(3, 60001)), light)
    expected[0] = light.sum(axis=(0, 1)) * np.sqrt(1 / (4 * np.pi))  # the printed factors have six digits
    found = project(device, EnvironmentMap(radiance), 2).coefficients
    np.testing.assert_allclose(found[0], expected[0], rtol=5e-7)
    np.testing.assert_allclose(found, expected, atol=3e-6 * np.abs(expected).max())


def test_a_black_map_gives_black(device: Device) -> None:
    harmonics = project(device, EnvironmentMap(np.zeros((4, 8, 3))), 3)
    assert not shade_harmonics(device, harmonics, 16).any()


def test_other_orders_and_resolutions_are_refused(device: Device, stiff: EnvironmentMap) -> None:
    for order in (-1, MAX_ORDER + 1):
        with pytest.raises(LightdomeError, match="order"):
            project(device, stiff, order)
    with pytest.raises(LightdomeError, match="order"):
        shade_harmonics(device, Harmonics(np.zeros(((MAX_ORDER + 2) ** 2, 3))))
    with pytest.raises(LightdomeError, match="resolution"):
        shade_harmonics(device, Harmonics(np.zeros((9, 3))), 0)
    with pytest.raises(LightdomeError, match="order"):
        Harmonics(np.zeros(((MAX_ORDER + 2) ** 2, 3))).rotated(1)
    with pytest.raises(LightdomeError, match=r"^yaw must be a finite angle"):
        Harmonics(np.zeros((9, 3))).rotated(np.inf)


def test_errors_on_grace(device: Device, grace: EnvironmentMap) -> None:
    target = exact(device, grace, 127)
    harmonics = project(device, grace, 18)
    for order, known in ((0, 0.515), (1, 0.169), (2, 0.0315), (8, 0.0031), (18, 0.00088)):
        error = reference.relative_rmse(shade_harmonics(device, harmonics.truncated(order), 127), target)
        assert error == pytest.approx(known, rel=0.05)


def test_harmonics_and_light_agree_on_the_axes(device: Device) -> None:
    # Up to order 64, one pixel's light is brightest where a directional light from there is.
    envmap = point_light(32, 64, 5, 9)
    direction = reference.directions(32, 64)[9, 5][None].astype(np.float32)
    directional = shade(device, direction, reference.pixel_solid_angles(32, 64)[9, 5] * np.array([[1, 2, 3]]), 64)
    image = shade_harmonics(device, project(device, envmap, MAX_ORDER), 64)
    assert reference.relative_rmse(image, directional) < 1e-2
    for turned in (directional[::-1], directional[:, ::-1], directional.swapaxes(0, 1)):
        assert reference.relative_rmse(image, turned) > 0.1
