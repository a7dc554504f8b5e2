"""Directions anywhere in their pixels: uniform in solid angle, never outside, and with the matching density."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers import stiff_radiance
from lightdome import reference
from lightdome.errors import LightdomeError
from lightdome.evaluation.stability import chi_square_z
from lightdome.lighting.exact import exact
from lightdome.lighting.shade import shade_samples
from lightdome.maps.envmap import EnvironmentMap
from lightdome.opencl import memory
from lightdome.opencl.device import Device
from lightdome.sampling.distribution import Distribution, build_distribution
from lightdome.sampling.samples import SEQUENCES, Samples

SHAPES = [(1, 1), (1, 3), (3, 1), (8, 16), (16, 8), (21, 43)]
LARGE = [pytest.param(shape, marks=pytest.mark.slow) for shape in ((512, 1024), (1, 2**15), (2**15, 1))]


def made(device: Device, height: int, width: int, seed: int = 1) -> Distribution:
    radiance = stiff_radiance(height, width, seed)
    radiance[0, 0] = 1
    return build_distribution(device, EnvironmentMap(radiance))


def places(direction: np.ndarray, height: int, width: int) -> tuple[np.ndarray, np.ndarray]:
    """The places of directions, in columns and rows from the map's corner, float64."""
    w_x, w_y, w_z = np.asarray(direction, np.float64).T
    theta, phi = np.arctan2(np.hypot(w_x, w_z), w_y), np.arctan2(w_z, w_x) % (2 * np.pi)
    return phi * width / (2 * np.pi), theta * height / np.pi


def solid_shares(down: np.ndarray, height: int) -> np.ndarray:
    """The share of a row's solid angle that lies above each place in it."""
    row = np.floor(down)
    top, at, bottom = (np.cos(np.pi * y / height) for y in (row, down, row + 1))
    return (top - at) / (top - bottom)


@pytest.mark.parametrize("shape", [*SHAPES, *LARGE])
@pytest.mark.parametrize("sequence", SEQUENCES)
def test_directions_are_unit_vectors_strictly_in_their_pixels(
    device: Device, gpu_shaped: Device, shape: tuple[int, int], sequence: str
) -> None:
    for chosen in (device, gpu_shaped):
        distribution = made(chosen, *shape)
        for count in (11, 50_000):
            samples = distribution.sample(count, 3, sequence, within="pixel")
            assert np.abs(np.linalg.norm(samples.direction.astype(np.float64), axis=1) - 1).max() < 2.5e-7
            across, down = places(samples.direction, *shape)
            np.testing.assert_array_equal(np.stack([np.floor(across), np.floor(down)], axis=1), samples.pixel)
            assert (across % 1 > 0).all()
            assert (down % 1 > 0).all()


def test_the_pixels_are_those_of_centres(device: Device, stiff: EnvironmentMap) -> None:
    distribution = build_distribution(device, stiff)
    for count in (9, 1000):
        centre, pixel = (distribution.sample(count, 5, "sobol", within) for within in ("centre", "pixel"))
        for name in ("pixel", "probability", "radiance", "density", "flux"):
            np.testing.assert_array_equal(getattr(pixel, name), getattr(centre, name))
        assert (pixel.within, centre.within) == ("pixel", "centre")
        assert (pixel.direction != centre.direction).any(axis=1).all()


@pytest.mark.parametrize("sequence", ["independent", "stratified", "sobol", "lattice"])
@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (8, 16), (16, 8)])
def test_parts_of_pixels_pass_chi_square(device: Device, shape: tuple[int, int], sequence: str) -> None:
    # Seven by five parts of equal solid angle in each pixel. Well-spread points do better than chance, except that the
    # lattice r2 is worse in narrow parts.
    distribution = made(device, *shape)
    samples = distribution.sample(400_000, 7, sequence, within="pixel")
    across, down = places(samples.direction, *shape)
    part = (across % 1 * 7).astype(int), (solid_shares(down, shape[0]) * 5).astype(int)
    x, y = samples.pixel.T
    seen = np.zeros((*shape, 7, 5))
    np.add.at(seen, (y, x, *part), 1)
    p = np.broadcast_to(distribution.probability_image()[..., None, None] / 35, seen.shape)
    z = chi_square_z(seen, p)
    assert (abs(z) if sequence == "independent" else z) < 4


def test_rows_are_even_in_cosine_and_not_in_the_angle(device: Device) -> None:
    distribution = build_distribution(device, EnvironmentMap(np.ones((2, 1, 3), np.float32)))
    _, down = places(distribution.sample(100_000, 2, within="pixel").direction, 2, 1)
    for share, passes in ((solid_shares(down, 2), True), (down % 1, False)):
        seen = np.bincount((share * 40).astype(int), minlength=40)
        assert (abs(chi_square_z(seen, np.full(40, 1 / 40))) < 4) == passes


def test_a_pixel_that_few_points_pick_is_filled_evenly(device: Device) -> None:
    # Next to a sun, pixels with one CDF step or a few: all of their points, with uniform further bits.
    radiance = np.ones((1, 8, 3), np.float32)
    radiance[0, :, :] = np.array([0, 1, 2, 3, 5, 2.0**29, 7, 1])[:, None]
    distribution = build_distribution(device, EnvironmentMap(radiance))
    cdf = memory.download(device, distribution.cdf.rows)[0].tolist()
    total = cdf[-1]
    seen = []
    for x in (1, 2, 3, 4, 6, 7):
        begin, end = (-(-(c << 32) // total) for c in (cdf[x - 1], cdf[x]))
        further = (np.arange(64) + 0.5) / 64
        across = ((np.arange(begin, end)[:, None] + further) / 2.0**32).ravel()
        samples = distribution.sample_at(np.stack([across, np.full_like(across, 0.5)], axis=1), within="pixel")
        assert (samples.pixel[:, 0] == x).all()
        place = places(samples.direction, 1, 8)[0] % 1
        np.testing.assert_allclose(place, (np.arange(len(place)) + 0.5) / len(place), atol=1e-6)
        seen.append(end - begin)
    assert min(seen) <= 8


def test_points_become_the_directions_of_continuous_inversion(device: Device) -> None:
    radiance = np.random.default_rng(4).random((16, 8, 3), np.float32) + np.float32(0.1)
    points = np.random.default_rng(5).random((5000, 2))
    samples = build_distribution(device, EnvironmentMap(radiance)).sample_at(points, within="pixel")
    p = reference.probability(radiance)
    rows, columns = np.cumsum(p.sum(axis=1)), np.cumsum(p / p.sum(axis=1, keepdims=True), axis=1)
    expected = []
    for u_x, u_y in points:
        y = int(np.searchsorted(rows, u_y, side="right"))
        x = int(np.searchsorted(columns[y], u_x, side="right"))
        down = (u_y - (rows[y] - p[y].sum())) / p[y].sum()
        before = columns[y, x] - p[y, x] / p[y].sum()
        across = (u_x - before) / (columns[y, x] - before)
        c = (1 - down) * np.cos(np.pi * y / 16) + down * np.cos(np.pi * (y + 1) / 16)
        phi = 2 * np.pi * (x + across) / 8
        expected.append((np.sqrt(1 - c * c) * np.cos(phi), c, np.sqrt(1 - c * c) * np.sin(phi)))
    # A point within 2^-29 of a step of the CDF may fall on either side, and only there do directions jump.
    off = np.abs(samples.direction - expected).max(axis=1)
    assert np.mean(off < 3e-6) > 0.999


def test_well_spread_points_stay_so_in_a_pixel(device: Device) -> None:
    distribution = build_distribution(device, EnvironmentMap(np.ones((1, 1, 3), np.float32)))
    samples = distribution.sample(4096, 1, "sobol", within="pixel")
    across, down = places(samples.direction, 1, 1)
    cells = np.bincount((across * 64).astype(int) * 64 + (solid_shares(down, 1) * 64).astype(int), minlength=4096)
    assert np.mean(cells == 1) > 0.999  # Owen scrambling: one in each of 64 x 64 cells; rounding may cross a border


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (16, 8), (21, 43), (64, 100)])
def test_the_density_is_the_probability_over_the_solid_angle(device: Device, shape: tuple[int, int]) -> None:
    height, width = shape
    distribution = made(device, *shape)
    w = np.random.default_rng(0).normal(size=(20_000, 3))
    w /= np.linalg.norm(w, axis=1, keepdims=True)
    across, down = places(w, *shape)
    pixel = np.minimum(down.astype(int), height - 1), np.minimum(across.astype(int), width - 1)
    expected = (reference.probability(distribution.envmap.radiance) / reference.pixel_solid_angles(*shape))[pixel]
    np.testing.assert_allclose(distribution.pdf(w), expected, rtol=1e-6)
    samples = distribution.sample(5000, within="pixel")
    np.testing.assert_allclose(distribution.pdf(samples.direction), samples.density, rtol=2e-6)
    np.testing.assert_array_equal(distribution.pdf(w.astype(np.float32)).shape, (20_000,))


@pytest.mark.parametrize("shape", [(1, 1), (16, 8), (21, 43)])
def test_the_density_integrates_to_one(device: Device, shape: tuple[int, int]) -> None:
    rows, columns = 3 * shape[0], 4 * shape[1]  # each cell lies within one pixel
    pdf = made(device, *shape).pdf(reference.directions(rows, columns).reshape(-1, 3))
    integral = (pdf.reshape(rows, columns) * reference.pixel_solid_angles(rows, columns)).sum()
    assert integral == pytest.approx(1, abs=1e-6)


def test_a_density_for_every_direction(device: Device) -> None:
    distribution = made(device, 16, 8)
    axes = np.concatenate([np.eye(3), -np.eye(3), [[1, 0, -1e-30], [1, 0, -0.0], [-1, 0, -0.0], [0.0, -1, -0.0]]])
    pdf = distribution.pdf(axes)
    density = distribution.probability_image() / reference.pixel_solid_angles(16, 8)
    # A border belongs to the row below it and the column after it; a pole belongs to any column.
    y, x = [8, 0, 8, 8, 15, 8, 8, 8, 8, 15], [0, 0, 2, 4, 4, 6, 7, 0, 4, 0]
    np.testing.assert_allclose(pdf, density[y, x], rtol=1e-6)
    assert distribution.pdf(np.empty((0, 3))).shape == (0,)


@pytest.mark.parametrize("factor", [2.0**-130, 1.0, 2.0**100])
def test_the_image_of_probabilities_is_the_reference_s_at_any_scale(device: Device, factor: float) -> None:
    radiance = np.random.default_rng(2).integers(0, 100, (20, 40, 3)).astype(np.float32) * np.float32(factor)
    distribution = build_distribution(device, EnvironmentMap(radiance))
    p = distribution.probability_image()
    assert p.sum() == pytest.approx(1, abs=1e-12)
    np.testing.assert_allclose(p, reference.probability(radiance), rtol=1e-12)
    samples = distribution.sample(1000)
    x, y = samples.pixel.T
    np.testing.assert_allclose(samples.probability, p[y, x], rtol=1e-6)
    w = reference.directions(20, 40).reshape(-1, 3)
    density = p / reference.pixel_solid_angles(20, 40)
    np.testing.assert_allclose(distribution.pdf(w), density.ravel(), rtol=1e-6)


def test_a_black_map_has_no_density(device: Device) -> None:
    distribution = build_distribution(device, EnvironmentMap(np.zeros((4, 8, 3))))
    for call in (lambda: distribution.pdf([[0, 1, 0]]), distribution.probability_image):
        with pytest.raises(LightdomeError, match="black"):
            call()


def lamp() -> np.ndarray:
    """A map of 8 rows and 16 columns, dark except for one pixel."""
    radiance = np.full((8, 16, 3), 0.01, np.float32)
    radiance[4, 13] = (5, 4, 3)
    return radiance


MAPS = {"lamp": lamp(), "upright": lamp().swapaxes(0, 1).copy(), "log-normal": stiff_radiance(32, 64)}


@pytest.mark.parametrize("name", MAPS)
def test_shared_samples_converge_to_the_image_of_areas(device: Device, name: str) -> None:
    envmap = EnvironmentMap(MAPS[name])
    distribution = build_distribution(device, envmap)
    areas, centres = (exact(device, envmap, 32, pixels=pixels) for pixels in ("areas", "centres"))
    errors = {
        count: reference.relative_rmse(
            shade_samples(device, distribution.sample(count, 1, "sobol", "pixel"), 32), areas
        )
        for count in (256, 2**18)
    }
    assert errors[2**18] < 3e-4
    assert errors[2**18] < errors[256] / 10
    assert errors[2**18] < reference.relative_rmse(centres, areas) / 4


@pytest.fixture
def saved(device: Device, stiff: EnvironmentMap, tmp_path: Path) -> Path:
    build_distribution(device, stiff).sample(50, 9, within="pixel").save(tmp_path / "samples.npz")
    return tmp_path / "samples.npz"


def rewrite(path: Path, **changes: object) -> None:
    with np.load(path) as file:
        arrays = {name: file[name] for name in file.files} | changes
    np.savez(path, **{name: array for name, array in arrays.items() if array is not None})


def test_files_say_where_directions_lie(saved: Path, device: Device, stiff: EnvironmentMap) -> None:
    loaded = Samples.load(saved)
    assert loaded.within == "pixel"
    drawn = build_distribution(device, stiff).sample(50, 9, within="pixel")
    np.testing.assert_array_equal(loaded.direction, drawn.direction)


def test_files_that_do_not_say_it_are_of_centres(saved: Path, device: Device, stiff: EnvironmentMap) -> None:
    rewrite(saved, within=None, direction=build_distribution(device, stiff).sample(50, 9).direction)
    assert Samples.load(saved).within == "centre"


@pytest.mark.parametrize("shift", [(0, 1e-4, 0), (1e-3, 1e-3, 0)])
def test_a_direction_that_is_no_unit_vector_is_refused(saved: Path, shift: tuple[float, float, float]) -> None:
    direction = Samples.load(saved).direction.copy()
    direction[7] *= 1 + shift[1]
    rewrite(saved, direction=direction)
    with pytest.raises(LightdomeError, match=r"not a unit vector \(sample 7\)"):
        Samples.load(saved)


@pytest.mark.parametrize(("axis", "step"), [(0, 1), (1, 1), (0, -1), (1, -1)])
def test_a_direction_in_a_neighbour_of_its_pixel_is_refused(saved: Path, axis: int, step: int) -> None:
    samples = Samples.load(saved)
    sample = int(np.argmin(np.abs(samples.pixel - (21, 10)).max(axis=1)))
    pixel = samples.pixel.copy()
    pixel[sample, axis] += step
    rewrite(saved, pixel=pixel)
    with pytest.raises(LightdomeError, match=rf"not in its pixel \(sample {sample}\)"):
        Samples.load(saved)


def test_the_seam_belongs_to_both_ends_of_a_row(device: Device) -> None:
    samples = made(device, 4, 8).sample(2000, within="pixel")
    assert {0, 7} <= set(samples.pixel[:, 0].tolist())
    assert len(Samples(**vars(samples))) == 2000


def test_samples_of_other_places_are_refused(saved: Path) -> None:
    rewrite(saved, within=np.array("corner"))
    with pytest.raises(LightdomeError, match="unknown place within a pixel 'corner'; expected one of centre, pixel"):
        Samples.load(saved)
