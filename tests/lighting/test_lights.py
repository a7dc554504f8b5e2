"""Lights as files: what a CSV and a PBRT include file hold, and PBRT's own image of them where there is a PBRT."""

from __future__ import annotations

import csv
import re
from pathlib import Path

import numpy as np
import pytest
from helpers import LONG
from lightdome import reference
from lightdome.errors import LightdomeError
from lightdome.lighting.lights import Lights, write_csv, write_pbrt
from lightdome.lighting.median_cut import median_cut
from lightdome.lighting.shade import shade, shade_samples
from lightdome.maps.envmap import EnvironmentMap
from lightdome.maps.rotation import rotation_matrix
from lightdome.opencl.device import Device
from lightdome.pbrt.run import Pbrt, render_scene
from lightdome.pbrt.scenes import Scene
from lightdome.sampling.distribution import build_distribution

# Version 3 sums all lights; version 4 picks one a sample, so its image has noise.
SCENE = {
    3: """\
Scale -1 1 1
LookAt 0 0 10  0 0 0  0 1 0
Camera "orthographic" "float screenwindow" [-1 1 -1 1]
Film "image" "string filename" ["image.pfm"] "integer xresolution" [64] "integer yresolution" [64]
Sampler "halton" "integer pixelsamples" [1] "bool samplepixelcenter" ["true"]
PixelFilter "box" "float xwidth" [0.5] "float ywidth" [0.5]
Integrator "directlighting" "string strategy" "all" "integer maxdepth" [1]
WorldBegin
Include "lights.pbrt"
Material "matte" "rgb Kd" [1 1 1]
Shape "sphere" "float radius" [1]
WorldEnd
""",
    4: """\
Option "disablepixeljitter" true
Scale -1 1 1
LookAt 0 0 10  0 0 0  0 1 0
Camera "orthographic" "float screenwindow" [-1 1 -1 1]
Film "rgb" "string filename" ["image.exr"] "bool savefp16" [false]
     "integer xresolution" [64] "integer yresolution" [64]
Sampler "zsobol" "integer pixelsamples" [128]
PixelFilter "box" "float xradius" [0.5] "float yradius" [0.5]
Integrator "path" "integer maxdepth" [1]
WorldBegin
Include "lights.pbrt"
Material "diffuse" "rgb reflectance" [1 1 1]
Shape "sphere" "float radius" [1]
""",
}


@pytest.fixture(scope="module")
def lights(device: Device, stiff: EnvironmentMap) -> Lights:
    return median_cut(build_distribution(device, stiff), 64)


def read_pbrt(path: Path) -> np.ndarray:
    """The ``distant`` lights of a PBRT file, (N, 6): direction towards the light as PBRT takes it, and L."""
    number = r"([-+.\de]+)"
    triple = rf"\[{number} {number} {number}\]"
    pattern = re.compile(rf'LightSource "distant" "point3 from" {triple} "point3 to" {triple} "rgb L" {triple}')
    found = []
    for line in path.read_text().splitlines():
        if line.startswith("#"):
            continue
        match = pattern.fullmatch(line)
        assert match, line
        source, target, L = np.array(match.groups(), float).reshape(3, 3)
        found.append(np.concatenate([source - target, L]))
    return np.array(found)


def test_samples_are_lights(device: Device, stiff: EnvironmentMap) -> None:
    samples = build_distribution(device, stiff).sample(100)
    lights = Lights.of(samples)
    assert len(lights) == 100
    np.testing.assert_array_equal(shade(device, lights.direction, lights.flux, 32), shade_samples(device, samples, 32))


def test_a_csv_gives_the_lights_back(lights: Lights, tmp_path: Path) -> None:
    write_csv(tmp_path / "lights.csv", lights)
    with (tmp_path / "lights.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert list(rows[0]) == ["x", "y", "z", "red", "green", "blue"]
    values = np.array([list(row.values()) for row in rows], float)
    np.testing.assert_array_equal(values[:, :3].astype(np.float32), lights.direction)
    np.testing.assert_allclose(values[:, 3:], lights.flux, rtol=1e-8)


def test_a_pbrt_file_gives_the_lights_back(lights: Lights, tmp_path: Path) -> None:
    write_pbrt(tmp_path / "lights.pbrt", lights)
    found = read_pbrt(tmp_path / "lights.pbrt")
    np.testing.assert_array_equal(found[:, :3].astype(np.float32), lights.direction)
    np.testing.assert_allclose(found[:, 3:], lights.flux, rtol=1e-8)


def test_pbrt_gets_no_light_without_flux(tmp_path: Path) -> None:
    lights = Lights(np.eye(3, dtype=np.float32), np.array([[1.0, 2, 3], [0, 0, 0], [0, 0, 1]]))
    write_pbrt(tmp_path / "lights.pbrt", lights)
    np.testing.assert_array_equal(read_pbrt(tmp_path / "lights.pbrt"), [[1, 0, 0, 1, 2, 3], [0, 0, 1, 0, 0, 1]])


def test_what_pbrt_cannot_hold_is_refused_in_words(tmp_path: Path) -> None:
    with pytest.raises(LightdomeError, match="scale the map"):
        write_pbrt(tmp_path / "lights.pbrt", Lights(np.eye(3)[:1], np.full((1, 3), 1e39)))
    assert not list(tmp_path.iterdir())


def test_a_folder_that_is_not_there_is_told_in_words(lights: Lights, tmp_path: Path) -> None:
    for write in (write_csv, write_pbrt):
        with pytest.raises(LightdomeError, match="cannot write"):
            write(tmp_path / "nowhere" / "lights", lights)


@pytest.mark.peer
def test_pbrt_draws_the_same_sphere(device: Device, tmp_path: Path, program: Pbrt) -> None:
    version = program.version
    # Mild colours: version 4 renders spectra, and saturated ones carry noise of their own.
    rng = np.random.default_rng(5)
    direction = rng.normal(0.3, 1, (64, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    lights = Lights(direction.astype(np.float32), rng.uniform(0.5, 1.5, (64, 3)) * rng.uniform(0.5, 1.5, (64, 1)))
    write_pbrt(tmp_path / "lights.pbrt", lights)
    (tmp_path / "scene.pbrt").write_text(SCENE[version])
    image = render_scene(program, Scene(tmp_path / "scene.pbrt", version, 64, 64), LONG)
    ours = shade(device, lights.direction, lights.flux, 64)
    assert reference.relative_rmse(image, ours) < {3: 1e-5, 4: 0.05}[version]
    np.testing.assert_allclose(image.mean(axis=(0, 1)), ours.mean(axis=(0, 1)), rtol={3: 1e-5, 4: 5e-3}[version])
    for turned in (image[::-1], image[:, ::-1], image.swapaxes(0, 1)):
        assert reference.relative_rmse(turned, ours) > 0.05


def test_lights_turn_with_the_map(device: Device, stiff: EnvironmentMap) -> None:
    distribution = build_distribution(device, stiff)
    lights = Lights.of(distribution.sample(200))
    turned = lights.rotated(20, 30, 40)
    np.testing.assert_array_equal(turned.flux, lights.flux)
    expected = lights.direction.astype(np.float64) @ rotation_matrix(20, 30, 40).T
    np.testing.assert_array_equal(turned.direction, expected.astype(np.float32))
    assert not turned.direction.flags.writeable
    yaw = 5 * 360 / stiff.width
    of_map = Lights.of(build_distribution(device, stiff.rotated(yaw)).sample(200))
    # The map's seam moved, so that the samples are others; their images are near each other.
    images = [shade(device, each.direction, each.flux, 31) for each in (lights.rotated(yaw), of_map, lights)]
    assert reference.relative_rmse(images[0], images[1]) < reference.relative_rmse(images[2], images[1]) / 2
    with pytest.raises(LightdomeError, match=r"^pitch must be a finite angle"):
        lights.rotated(0, float("nan"))
