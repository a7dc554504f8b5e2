"""Work is split over launches, and kernels have several shapes: none of it changes a result."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers import stiff_radiance, with_small_launches
from lightdome import reference
from lightdome.disc import disc_mask
from lightdome.lighting.exact import exact
from lightdome.lighting.harmonics import clamped_cosine, project, shade_harmonics
from lightdome.lighting.median_cut import median_cut
from lightdome.lighting.shade import shade
from lightdome.maps.envmap import EnvironmentMap
from lightdome.maps.images import ImageRows, write_image
from lightdome.opencl.device import Device
from lightdome.opencl.programs import Programs
from lightdome.rendering.per_pixel import ESTIMATORS, render
from lightdome.rendering.per_pixel import SEQUENCES as RENDER_SEQUENCES
from lightdome.sampling.distribution import build_distribution
from lightdome.sampling.samples import SEQUENCES
from lightdome.sampling.streaming import sample_file

R = 21
POINTS = np.random.default_rng(8).random((600, 2))


def results(device: Device, envmap: EnvironmentMap, path: Path) -> dict[str, list[np.ndarray]]:
    """The results of every function for a map that takes more than one work-item; ``path`` is the map's file."""
    distribution = build_distribution(device, envmap)
    found: dict[str, list[np.ndarray]] = {}
    for sequence in SEQUENCES:
        for count in (90, 600):  # without and with guide tables
            drawn = distribution.sample(count, 6, sequence)
            found[f"{count} samples, {sequence}"] = [drawn.pixel, drawn.probability, drawn.direction, drawn.radiance]
        found[f"pixels, {sequence}"] = list(distribution.sample_pixels(600, 6, sequence))
        (drawn,) = sample_file(device, ImageRows(path, batch=5), [600], 6, sequence)
        found[f"samples of a file, {sequence}"] = [drawn.pixel, drawn.probability, drawn.direction, drawn.radiance]
    found["given points"] = [distribution.sample_at(POINTS).pixel]
    lights = median_cut(distribution, 40)
    found["median cut"] = [lights.direction, lights.flux]
    for name, flux in (("colour", lights.flux), ("grey", lights.flux[:, :1].repeat(3, axis=1))):
        for brute_force in (False, True):
            image = shade(device, lights.direction, flux, R, brute_force=brute_force)
            found[f"shade, {name}, brute force {brute_force}"] = [image]
    found["harmonics"] = [shade_harmonics(device, project(device, envmap, 5), R)]
    found["exact"] = [exact(device, envmap, R), exact(device, envmap, R, pixels="areas")]
    return found


@pytest.mark.parametrize("shape", ["its own", "gpu"])
def test_small_launches_change_no_bit(device: Device, gpu_shaped: Device, shape: str, tmp_path: Path) -> None:
    chosen = gpu_shaped if shape == "gpu" else device
    envmap = EnvironmentMap(stiff_radiance(21, 43))
    write_image(tmp_path / "map.pfm", envmap.radiance)
    whole, small = (results(each, envmap, tmp_path / "map.pfm") for each in (chosen, with_small_launches(chosen)))
    for name, arrays in whole.items():
        for one, many in zip(arrays, small[name], strict=True):
            np.testing.assert_array_equal(many, one, err_msg=name)
            assert one.any(), name


@pytest.mark.parametrize("shape", ["its own", "gpu"])
@pytest.mark.parametrize("sequence", RENDER_SEQUENCES)
@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_launches_of_few_samples_add_up(
    device: Device, gpu_shaped: Device, estimator: str, sequence: str, shape: str
) -> None:
    chosen = gpu_shaped if shape == "gpu" else device
    envmap = EnvironmentMap(stiff_radiance(21, 43))
    images = []
    for each in (chosen, with_small_launches(chosen)):
        distribution = build_distribution(each, envmap)
        images.append(dict(render(distribution, [2, 40], R, seed=3, estimator=estimator, sequence=sequence)))
    for spp, image in images[0].items():
        np.testing.assert_allclose(images[1][spp], image, rtol=2e-6, atol=2e-7 * image.max())


def test_groups_of_any_size_give_the_same(gpu_shaped: Device) -> None:
    """A GPU's driver chooses groups itself; the other tests have it run single work-items."""
    programs = Programs(gpu_shaped.context, FUSED=int(gpu_shaped.rates.is_fused))
    envmap = EnvironmentMap(stiff_radiance(21, 43))
    drawn, images = [], []
    for device in (gpu_shaped, replace(gpu_shaped, programs=programs)):
        distribution = build_distribution(device, envmap)
        samples = distribution.sample(600, 6, "sobol")
        drawn.append([samples.pixel, samples.probability, samples.direction, samples.radiance])
        images += [image for _, image in render(distribution, [4], R, seed=3, estimator="product")]
    for one, many in zip(*drawn, strict=True):
        np.testing.assert_array_equal(many, one)
    np.testing.assert_allclose(images[1], images[0], rtol=2e-6, atol=2e-7 * images[0].max())


LIGHTS = 2**19


@pytest.fixture(scope="module")
def lights() -> tuple[np.ndarray, np.ndarray]:
    """Half a million lights from everywhere; the first has a tenth of the flux of all the others."""
    rng = np.random.default_rng(2)
    direction = rng.normal(size=(LIGHTS, 3))
    direction = (direction / np.linalg.norm(direction, axis=1, keepdims=True)).astype(np.float32)
    flux = rng.random((LIGHTS, 3))
    direction[0], flux[0] = (0, 0, 1), 0.05 * LIGHTS
    return direction, flux


@pytest.mark.parametrize("is_grey", [False, pytest.param(True, marks=pytest.mark.slow)])
@pytest.mark.parametrize("road", ["its own", "brute force", "gpu"])
def test_half_a_million_lights_lose_no_digits(
    device: Device, gpu_shaped: Device, lights: tuple[np.ndarray, np.ndarray], road: str, is_grey: bool
) -> None:
    direction, flux = lights
    flux = flux[:, :1].repeat(3, axis=1) if is_grey else flux
    chosen = gpu_shaped if road == "gpu" else device
    image = shade(chosen, direction, flux, 5, brute_force=road == "brute force")
    mask = disc_mask(5)
    expected = reference.shade(reference.normals(5)[mask], direction, flux * LIGHTS, np.ones(LIGHTS))
    np.testing.assert_allclose(image[mask], expected, rtol=4e-7)


@pytest.mark.parametrize(("height", "width"), [(131, 53), (65, 127), (67, 13)])
def test_every_method_meets_the_float64_sum_on_maps_of_several_bands(
    device: Device, gpu_shaped: Device, height: int, width: int
) -> None:
    # Bands have 64 rows or fewer; the last ones of these maps have one, three or many.
    radiance = stiff_radiance(height, width)
    radiance[-1] = radiance[:, -1] = 1e5
    normal, mask = reference.normals(11), disc_mask(11)
    centres = reference.exact(radiance, normal[mask])
    some = slice(None, None, 17)
    areas = reference.exact_areas(radiance, normal[mask][some], nodes=8)
    for each in (device, gpu_shaped):
        envmap = EnvironmentMap(radiance)
        np.testing.assert_allclose(exact(each, envmap, 11)[mask], centres, rtol=1e-6)
        found = exact(each, envmap, 11, pixels="areas")[mask][some]
        np.testing.assert_allclose(found, areas, rtol=2e-6)
        series = [shade_harmonics(each, project(each, envmap, order), 11)[mask] for order in (0, 3, 9)]
        expected = [harmonic_sum(radiance, order, normal[mask]) for order in (0, 3, 9)]
        for image, truth in zip(series, expected, strict=True):
            np.testing.assert_allclose(image, truth, atol=2e-6 * truth.max())


def harmonic_sum(radiance: np.ndarray, order: int, normal: np.ndarray) -> np.ndarray:
    """The sphere's image by the series up to ``order``, from the addition theorem in float64, without any Y_lm."""
    height, width = radiance.shape[:2]
    light = radiance.astype(np.float64) * reference.pixel_solid_angles(height, width)[..., None]
    cosine = normal @ reference.directions(height, width).reshape(-1, 3).T
    a = clamped_cosine(order) * (2 * np.arange(order + 1) + 1) / (4 * np.pi**2)
    return np.polynomial.legendre.legval(cosine, a) @ light.reshape(-1, 3)
