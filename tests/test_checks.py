"""Public functions refuse what they cannot use, in one line that says what was expected and what was given."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import lightdome
import numpy as np
import pytest
from helpers import stiff_radiance
from lightdome import checks, fresnel, pbrt, reference
from lightdome.disc import disc_mask
from lightdome.errors import LightdomeError
from lightdome.lighting.exact import exact, exact_kept
from lightdome.lighting.harmonics import Harmonics, clamped_cosine, project, shade_harmonics
from lightdome.lighting.light_files import write_csv, write_pbrt
from lightdome.lighting.lights import Lights
from lightdome.lighting.median_cut import median_cut, regions
from lightdome.lighting.shade import shade, shade_samples
from lightdome.maps.envmap import EnvironmentMap
from lightdome.maps.geometry import column_angles, row_angles, solid_angles
from lightdome.maps.images import ImageRows, auto_exposure, read_image, tone_map, write_image
from lightdome.maps.markers import mark_pixels
from lightdome.opencl.device import Device
from lightdome.pbrt import equal_area
from lightdome.rendering import product
from lightdome.rendering.per_pixel import render
from lightdome.sampling.distribution import build_distribution
from lightdome.sampling.samples import Samples

UP = np.array([[0, 1, 0]], np.float32)
FLUX = np.ones((1, 3))
IMAGE = np.ones((2, 4, 3), np.float32)
BYTES = IMAGE.astype(np.uint8)
Given = SimpleNamespace


@pytest.fixture(scope="module")
def given(device: Device, tmp_path_factory: pytest.TempPathFactory) -> Given:
    """Valid arguments of every kind."""
    folder = tmp_path_factory.mktemp("checks")
    write_image(folder / "map.pfm", stiff_radiance(4, 8))
    envmap = EnvironmentMap.read(folder / "map.pfm")
    distribution = build_distribution(device, envmap)
    return Given(
        device=device,
        envmap=envmap,
        distribution=distribution,
        samples=distribution.sample(5),
        lights=median_cut(distribution, 2),
        harmonics=project(device, envmap),
        rows=ImageRows(folder / "map.pfm"),
        folder=folder,
    )


def samples_with(g: Given, **changes: object) -> Samples:
    names = ("direction", "radiance", "probability", "pixel", "map_shape", "sequence", "seed")
    return Samples(**{**{name: getattr(g.samples, name) for name in names}, **changes})


def with_value(value: float) -> np.ndarray:
    image = IMAGE.copy()
    image[1, 2, 0] = value
    return image


# A call that is wrong in one place, and words that its message must have: what was expected, and what was given.
WRONG: dict[str, tuple[Callable[[Given], object], tuple[str, ...]]] = {
    # Swapped arguments, and arguments of another type.
    "build exchanged": (lambda g: build_distribution(g.envmap, g.device), ("Device", "EnvironmentMap")),
    "build array": (lambda g: build_distribution(g.device, IMAGE), ("EnvironmentMap", "(2, 4, 3)")),
    "exact exchanged": (lambda g: exact(g.envmap, g.device), ("Device", "EnvironmentMap")),
    "exact distribution": (lambda g: exact(g.device, g.distribution), ("EnvironmentMap", "Distribution")),
    "exact_kept exchanged": (lambda g: exact_kept(g.envmap, g.device), ("Device", "EnvironmentMap")),
    "shade exchanged": (lambda g: shade(UP, g.device, FLUX), ("Device", "(1, 3)")),
    "shade_samples exchanged": (lambda g: shade_samples(g.samples, g.device), ("Device", "Samples")),
    "shade_samples lights": (lambda g: shade_samples(g.device, g.lights), ("Samples", "Lights")),
    "project exchanged": (lambda g: project(g.envmap, g.device), ("Device", "EnvironmentMap")),
    "shade_harmonics exchanged": (lambda g: shade_harmonics(g.harmonics, g.device), ("Device", "Harmonics")),
    "median_cut device": (lambda g: median_cut(g.device, 4), ("Distribution", "Device")),
    "regions map": (lambda g: regions(g.envmap, 4), ("Distribution", "EnvironmentMap")),
    "product map": (lambda g: product.build_product_cdfs(g.envmap, 4), ("Distribution", "EnvironmentMap")),
    "render map": (lambda g: render(g.envmap, [4]), ("Distribution", "EnvironmentMap")),
    "sample_file exchanged": (lambda g: lightdome.sample_file(g.rows, g.device, [4]), ("Device", "ImageRows")),
    "sample_file path": (lambda g: lightdome.sample_file(g.device, "map.pfm", [4]), ("ImageRows", "map.pfm")),
    "write_csv exchanged": (lambda g: write_csv(g.lights, "a.csv"), ("path", "Lights")),
    "write_csv samples": (lambda g: write_csv(g.folder / "a.csv", g.samples), ("Lights", "Samples")),
    "write_pbrt samples": (lambda g: write_pbrt(g.folder / "a.pbrt", g.samples), ("Lights", "Samples")),
    "lights of lights": (lambda g: Lights.of(g.lights), ("Samples", "Lights")),
    "write_image exchanged": (lambda g: write_image(IMAGE, "a.pfm"), ("path", "(2, 4, 3)")),
    "device number": (lambda g: lightdome.open_device(0), ("string", "got 0")),
    "class": (lambda g: exact(Device, g.envmap), ("Device", "the class Device")),
    "scenes exchanged": (lambda g: pbrt.write_scenes(g.envmap, g.folder, [4]), ("path", "EnvironmentMap")),
    "scenes array": (lambda g: pbrt.write_scenes(g.folder, IMAGE, [4]), ("EnvironmentMap", "(2, 4, 3)")),
    "pbrt path": (lambda g: pbrt.render("pbrt", []), ("Pbrt", "'pbrt'")),
    "pbrt scenes": (lambda g: pbrt.render_scene(pbrt.Pbrt(Path("pbrt"), 4), "a.pbrt"), ("Scene", "'a.pbrt'")),
    # Paths.
    "read None": (lambda g: read_image(None), ("path", "None")),
    "read nul": (lambda g: read_image("a\0.pfm"), ("name of a file", "a")),
    "read half a character": (lambda g: read_image("\ud800.pfm"), ("name of a file", "ud800")),
    "save as half a character": (lambda g: g.samples.save("\ud800.npz"), ("name of a file", "ud800")),
    "write to no name": (lambda g: write_csv("", g.lights), ("name",)),
    "load a long name": (lambda g: Samples.load("x" * 260), ("cannot read",)),
    "layer number": (lambda g: read_image(g.folder / "map.pfm", 5), ("layer", "string", "5")),
    "layer bytes": (lambda g: ImageRows(g.folder / "map.pfm", layer=b"key"), ("layer", "string", "b'key'")),
    "layer list": (lambda g: EnvironmentMap.read(g.folder / "map.pfm", layer=["key"]), ("layer", "['key']")),
    "flip text": (lambda g: EnvironmentMap.read(g.folder / "map.pfm", flip="no"), ("flip", "True or False", "'no'")),
    "flip of rows": (lambda g: ImageRows(g.folder / "map.pfm", flip=IMAGE), ("flip", "(2, 4, 3)")),
    "brute force": (lambda g: shade(g.device, UP, FLUX, 4, 1.0, "no"), ("brute_force", "'no'")),
    "compensation": (lambda g: render(g.distribution, [1], 4, mis_compensation="no"), ("mis_compensation", "'no'")),
    "rows number": (lambda g: ImageRows(3), ("path", "3")),
    "load list": (lambda g: Samples.load([1]), ("path", "[1]")),
    "save None": (lambda g: g.samples.save(None), ("path", "None")),
    "find number": (lambda g: pbrt.find_pbrt(3), ("path", "3")),
    # Lights.
    "long direction": (lambda g: shade(g.device, 2 * UP, FLUX), ("unit vector", "2.0", "light 0")),
    "no direction": (lambda g: shade(g.device, 0 * UP, FLUX), ("unit vector", "0.0")),
    "NaN direction": (lambda g: shade(g.device, UP * np.nan, FLUX), ("unit vector", "nan")),
    "huge direction": (lambda g: shade(g.device, UP * np.float32(1e30), FLUX), ("unit vector", "e+30")),
    "flat direction": (lambda g: shade(g.device, UP[0], FLUX), ("(N, 3)", "(3,)")),
    "wide direction": (lambda g: shade(g.device, np.ones((1, 4)), FLUX), ("(N, 3)", "(1, 4)")),
    "texts": (lambda g: shade(g.device, [["a", "b", "c"]], FLUX), ("real numbers",)),
    "ragged": (lambda g: shade(g.device, [[1, 0, 0], [1]], FLUX), ("(N, 3)", "[[1, 0, 0], [1]]")),
    "complex": (lambda g: shade(g.device, UP.astype(complex), FLUX), ("real numbers of shape (N, 3), got", "complex")),
    "more directions": (lambda g: shade(g.device, np.repeat(UP, 2, 0), FLUX), ("2 and 1",)),
    "more fluxes": (lambda g: shade(g.device, np.zeros((0, 3)), FLUX), ("0 and 1",)),
    "negative flux": (lambda g: shade(g.device, UP, -FLUX), ("flux", "-1")),
    "NaN flux": (lambda g: shade(g.device, UP, FLUX * np.nan), ("flux", "nan")),
    "infinite flux": (lambda g: shade(g.device, UP, FLUX * np.inf), ("flux", "inf")),
    "flat flux": (lambda g: shade(g.device, UP, [1.0]), ("(N, 3)", "(1,)")),
    "Lights": (lambda g: Lights(2 * UP, FLUX), ("unit vector", "2.0")),
    "Lights flux": (lambda g: Lights(UP, -FLUX), ("flux", "-1")),
    # Numbers.
    "albedo of exact": (lambda g: exact(g.device, g.envmap, 4, -1), ("albedo", "-1")),
    "albedo of shade": (lambda g: shade(g.device, UP, FLUX, 4, np.nan), ("albedo", "nan")),
    "albedo of samples": (lambda g: shade_samples(g.device, g.samples, 4, np.inf), ("albedo", "inf")),
    "albedo of harmonics": (lambda g: shade_harmonics(g.device, g.harmonics, 4, -0.5), ("albedo", "-0.5")),
    "albedo of render": (lambda g: render(g.distribution, [1], 4, -1.0), ("albedo", "-1")),
    "albedo beyond": (lambda g: exact(g.device, g.envmap, 4, 1e39), ("albedo", "1e+39")),
    "albedo text": (lambda g: exact(g.device, g.envmap, 4, "1"), ("albedo", "'1'")),
    "albedo array": (lambda g: exact(g.device, g.envmap, 4, np.ones(3)), ("albedo", "(3,)")),
    "albedo None": (lambda g: exact(g.device, g.envmap, 4, None), ("albedo", "None")),
    "albedo of a scene": (lambda g: pbrt.scene_text(4, 8, 4, 1.5), ("albedo", "1.5", "0 to 1")),
    "NaN of a scene": (lambda g: pbrt.scene_text(4, 8, 4, np.nan), ("albedo", "nan")),
    "resolution": (lambda g: exact(g.device, g.envmap, 0), ("resolution", "0")),
    "resolution 5.0": (lambda g: exact(g.device, g.envmap, 5.0), ("resolution", "whole number", "5.0")),
    "resolution text": (lambda g: shade(g.device, UP, FLUX, "64"), ("resolution", "'64'")),
    "resolution True": (lambda g: shade(g.device, UP, FLUX, True), ("resolution", "True")),
    "resolution huge": (lambda g: shade(g.device, UP, FLUX, 10**5000), ("resolution", "bits")),
    "resolution of samples": (lambda g: shade_samples(g.device, g.samples, None), ("resolution", "None")),
    "resolution of harmonics": (lambda g: shade_harmonics(g.device, g.harmonics, 9.5), ("resolution", "9.5")),
    "resolution of render": (lambda g: render(g.distribution, [1], 16385), ("resolution", "16385")),
    "resolution of scenes": (lambda g: pbrt.scene_text(4, 8, -4), ("resolution", "-4")),
    "resolution of product": (lambda g: product.build_product_cdfs(g.distribution, 0), ("resolution", "0")),
    "resolution of disc": (lambda g: disc_mask(2.5), ("resolution", "2.5")),
    "count": (lambda g: g.distribution.sample(1.5), ("samples", "1.5")),
    "count text": (lambda g: g.distribution.sample("64"), ("samples", "'64'")),
    "count of pixels": (lambda g: g.distribution.sample_pixels(2**31), ("samples", "2147483648")),
    "seed": (lambda g: g.distribution.sample(4, seed=-1), ("seed", "-1")),
    "seed 0.5": (lambda g: g.distribution.sample(4, seed=0.5), ("seed", "0.5")),
    "seed of render": (lambda g: render(g.distribution, [1], 4, seed="1"), ("seed", "'1'")),
    "seed of scenes": (lambda g: pbrt.scene_text(4, 8, seed=-1), ("seed", "-1")),
    "sequence": (lambda g: g.distribution.sample(4, sequence="magic"), ("sequence", "'magic'", "sobol")),
    "sequence number": (lambda g: g.distribution.sample(4, sequence=2), ("sequence", "2", "sobol")),
    "within": (lambda g: g.distribution.sample(4, within="edge"), ("within a pixel", "'edge'", "centre, pixel")),
    "within number": (lambda g: g.distribution.sample_at([[0.5, 0.5]], 1), ("within a pixel", "1", "centre, pixel")),
    "within list": (lambda g: g.distribution.sample(4, within=["pixel"]), ("within a pixel", "['pixel']")),
    "pdf": (lambda g: g.distribution.pdf([0, 1, 0]), ("directions", "(N, 3)", "(3,)")),
    "pdf text": (lambda g: g.distribution.pdf("up"), ("directions", "(N, 3)", "'up'")),
    "pdf long": (lambda g: g.distribution.pdf([[0, 1, 0], [0, 2, 0]]), ("unit vector", "number 1", "normalise it")),
    "pdf NaN": (lambda g: g.distribution.pdf([[np.nan, 1, 0]]), ("unit vector", "nan", "number 0")),
    "points": (lambda g: g.distribution.sample_at([0.5, 0.5]), ("(N, 2)", "(2,)")),
    "points text": (lambda g: g.distribution.sample_at("0.5"), ("(N, 2)", "'0.5'")),
    "points NaN": (lambda g: g.distribution.sample_at([[np.nan, 0]]), ("[0, 1)",)),
    "spp number": (lambda g: render(g.distribution, 8), ("samples per pixel", "list", "8")),
    "spp text": (lambda g: render(g.distribution, "8"), ("samples per pixel", "'8'")),
    "spp none": (lambda g: render(g.distribution, []), ("samples per pixel", "none")),
    "spp 0": (lambda g: render(g.distribution, [4, 0]), ("samples per pixel", "0")),
    "spp 1.5": (lambda g: render(g.distribution, np.array([1.5])), ("samples per pixel", "1.5")),
    "estimator": (lambda g: render(g.distribution, [1], 4, estimator="magic"), ("estimator", "'magic'", "bsdf")),
    "estimator list": (lambda g: render(g.distribution, [1], 4, estimator=["mis"]), ("estimator", "['mis']")),
    "spp of scenes": (lambda g: pbrt.write_scenes(g.folder, g.envmap, 8), ("samples per pixel", "8")),
    "version of scenes": (lambda g: pbrt.scene_text(5, 8), ("version", "5")),
    "timeout": (lambda g: pbrt.find_pbrt(timeout=-1), ("timeout", "-1")),
    "counts number": (lambda g: lightdome.sample_file(g.device, g.rows, 64), ("counts", "64")),
    "counts none": (lambda g: lightdome.sample_file(g.device, g.rows, []), ("counts", "none")),
    "counts 2.5": (lambda g: lightdome.sample_file(g.device, g.rows, [2.5]), ("counts", "2.5")),
    "counts of lists": (lambda g: lightdome.sample_file(g.device, g.rows, [[1, 2], [3]]), ("counts", "list")),
    "batch": (lambda g: ImageRows(g.folder / "map.pfm", 0), ("batch", "0")),
    "rows outside": (lambda g: g.rows.read(np.array([4])), ("rows", "0 to 3")),
    "rows down": (lambda g: g.rows.read([2, 1]), ("rows", "ascending")),
    "rows of floats": (lambda g: g.rows.read([0.5]), ("rows", "whole numbers")),
    "two sizes": (lambda g: reference.relative_rmse(np.ones((2, 2, 3)), IMAGE), ("(2, 2, 3)", "(2, 4, 3)")),
    "lights 2.5": (lambda g: median_cut(g.distribution, 2.5), ("lights", "2.5")),
    "lights 0": (lambda g: median_cut(g.distribution, 0), ("lights", "0")),
    "order 1.5": (lambda g: project(g.device, g.envmap, 1.5), ("order", "1.5")),
    "order 65": (lambda g: project(g.device, g.envmap, 65), ("order", "65")),
    "order of a cosine": (lambda g: clamped_cosine(-1), ("order", "-1")),
    "truncated": (lambda g: g.harmonics.truncated(-2), ("order", "-2")),
    "rows": (lambda g: row_angles(0), ("height", "0")),
    "rows of solid angles": (lambda g: solid_angles("4", 8), ("height", "'4'")),
    "no rows of solid angles": (lambda g: solid_angles(0, 8), ("height", "0")),
    "pixels": (lambda g: exact(g.device, g.envmap, 4, pixels="corners"), ("pixels", "centres, areas", "'corners'")),
    "pixels of a kept image": (lambda g: exact_kept(g.device, g.envmap, 4, pixels=3), ("centres, areas", "3")),
    "columns": (lambda g: column_angles(1.5), ("width", "1.5")),
    "solid angles": (lambda g: solid_angles(4, 0), ("width", "0")),
    # Arrays that do not fit a map, samples, harmonics or an image.
    "map of text": (lambda g: EnvironmentMap("map.exr"), ("(H, W, 3)", "'map.exr'")),
    "map of bools": (lambda g: EnvironmentMap(IMAGE > 0), ("real numbers", "bool")),
    "map of objects": (lambda g: EnvironmentMap(IMAGE.astype(object)), ("real numbers", "object")),
    "map of rows": (lambda g: EnvironmentMap([[[1, 2, 3]], [[1, 2]]]), ("(H, W, 3)",)),
    "sanitize": (lambda g: EnvironmentMap(IMAGE, sanitize="red"), ("'black'", "'clamp'", "'red'")),
    "sanitize of read": (lambda g: EnvironmentMap.read("missing.pfm", sanitize=2), ("'black'", "'clamp'", "2")),
    "sanitize of a file": (lambda g: lightdome.sample_file(g.device, g.rows, [1], sanitize="x"), ("'clamp'", "'x'")),
    "fewer probabilities": (lambda g: samples_with(g, probability=np.ones(4)), ("4", "5")),
    "no samples": (
        lambda g: Samples(np.ones((0, 3)), np.ones((0, 3)), np.ones(0), np.ones((0, 2), int), (4, 8)),
        ("one or more",),
    ),
    "probability 0": (lambda g: samples_with(g, probability=np.zeros(5)), ("probability", "(0, 1]")),
    "wrong direction": (lambda g: samples_with(g, direction=np.repeat(UP, 5, 0)), ("direction", "pixel")),
    "pixel outside": (lambda g: samples_with(g, pixel=g.samples.pixel + 8), ("pixel", "outside")),
    "pixel of floats": (lambda g: samples_with(g, pixel=g.samples.pixel * 1.0), ("pixel", "float64")),
    "map_shape": (lambda g: samples_with(g, map_shape=(4,)), ("map_shape", "[4]")),
    "seed of samples": (lambda g: samples_with(g, seed=-1), ("seed", "-1")),
    "sequence of samples": (lambda g: samples_with(g, sequence=3), ("sequence", "3")),
    "seven coefficients": (lambda g: Harmonics(np.ones((7, 3))), ("coefficients", "7")),
    "one channel": (lambda g: Harmonics(np.ones((9, 1))), ("coefficients", "(9, 1)")),
    "NaN coefficient": (lambda g: Harmonics(np.full((9, 3), np.nan)), ("coefficients", "NaN")),
    "radiance as png": (lambda g: write_image(g.folder / "x.png", IMAGE), ("8-bit", "float32", "tone_map")),
    "NaN as ppm": (lambda g: write_image(g.folder / "x.ppm", IMAGE * np.nan), ("8-bit", "float32")),
    "int64 as png": (lambda g: write_image(g.folder / "x.png", IMAGE.astype(int)), ("8-bit", "int64")),
    "bytes as pfm": (lambda g: write_image(g.folder / "x.pfm", BYTES), ("floating point", "uint8")),
    "bytes as exr": (lambda g: write_image(g.folder / "x.EXR", BYTES), ("floating point", "uint8")),
    "too large": (lambda g: write_image(g.folder / "x.pfm", np.full((2, 4, 3), 1e39)), ("3.4e+38",)),
    "jpg": (lambda g: write_image(g.folder / "x.jpg", BYTES), (".pfm, .exr, .ppm, .png", "x.jpg")),
    "no suffix": (lambda g: write_image(g.folder / "x", BYTES), (".pfm, .exr, .ppm, .png",)),
    "flat image": (lambda g: write_image(g.folder / "x.pfm", IMAGE[0]), ("(H, W, 3)", "(4, 3)")),
    "alpha": (lambda g: write_image(g.folder / "x.png", np.zeros((2, 4, 4), np.uint8)), ("(H, W, 3)", "(2, 4, 4)")),
    "no image": (lambda g: write_image(g.folder / "x.pfm", IMAGE[:0]), ("(0, 4, 3)",)),
    "list of text": (lambda g: write_image(g.folder / "x.pfm", "pixels"), ("(H, W, 3)", "'pixels'")),
    "tone of NaN": (lambda g: tone_map(with_value(np.nan), 1.0), ("NaN", "1")),
    "tone of nothing": (lambda g: tone_map(IMAGE[:0], 1.0), ("(0, 4, 3)",)),
    "tone of None": (lambda g: tone_map(None, 1.0), ("real numbers", "None")),
    "exposure": (lambda g: tone_map(IMAGE, 0), ("exposure", "0")),
    "exposure auto": (lambda g: tone_map(IMAGE, "auto"), ("exposure", "'auto'")),
    "exposure NaN": (lambda g: tone_map(IMAGE, np.nan), ("exposure", "nan")),
    "gamma": (lambda g: tone_map(IMAGE, 1.0, -2.2), ("gamma", "-2.2")),
    "gamma inf": (lambda g: tone_map(IMAGE, 1.0, np.inf), ("gamma", "inf")),
    "exposure of NaN": (lambda g: auto_exposure(with_value(np.nan)), ("NaN", "1")),
    "side": (lambda g: equal_area.to_equal_area(IMAGE, 5), ("even", "5")),
    "side of what": (lambda g: equal_area.to_equal_area(IMAGE[0]), ("(H, W, 3)", "(4, 3)")),
    "marker": (lambda g: mark_pixels(IMAGE.copy(), np.array([[0, 0]]), 0, (0, 0, 1)), ("size", "0")),
    "marker list": (lambda g: mark_pixels(IMAGE.tolist(), [[0, 0]], 1, (0, 0, 1)), ("image", "ndarray")),
    "marker on a map": (lambda g: mark_pixels(g.envmap.radiance, [[0, 0]], 1, (0, 0, 1)), ("read-only", "copy")),
    "marker grey": (lambda g: mark_pixels(IMAGE.copy(), [[0, 0]], 1, 1), ("colour", "(3,)")),
    "marker outside": (lambda g: mark_pixels(IMAGE.copy(), np.array([[4, 0]]), 1, (0, 0, 1)), ("4 x 2",)),
    # Fresnel.
    "angle": (lambda g: fresnel.fresnel(2.0, 1.0, 1.5), ("angle", "pi/2", "2")),
    "angles": (lambda g: fresnel.unpolarised([0.1, -0.5], 1.0, 1.5), ("angle", "-0.5")),
    "angle text": (lambda g: fresnel.fresnel("steep", 1.0, 1.5), ("angle", "'steep'")),
    "angle None": (lambda g: fresnel.refraction_angle(None, 1.0, 1.5), ("angle", "None")),
    "shapes": (lambda g: fresnel.fresnel(np.zeros(3), np.ones(2), 1.5), ("(3,)", "(2,)")),
    "index": (lambda g: fresnel.brewster_angle(1.0, -1.5), ("index n_t", "-1.5")),
    "index text": (lambda g: fresnel.critical_angle("glass", 1.0), ("index", "'glass'")),
    "indices": (lambda g: fresnel.schlick_error(1.0, [1.4, 1.5]), ("one number", "(2,)")),
    "eta": (lambda g: fresnel.summarise(np.nan), ("index", "nan")),
    "etas": (lambda g: fresnel.summarise([1.4, 1.5]), ("one number", "(2,)")),
    "r0": (lambda g: fresnel.schlick(0.1, 1.5), ("reflectance", "1.5")),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_argument_is_reported_in_one_line(given: Given, name: str) -> None:
    call, words = WRONG[name]
    before = sorted(given.folder.iterdir())
    with pytest.raises(LightdomeError) as error:
        call(given)
    text = str(error.value)
    assert text.isprintable()
    assert " is a " not in text
    assert len(text) < 300
    for word in words:
        assert word in text
    assert sorted(given.folder.iterdir()) == before  # and nothing was written


def test_numbers_of_any_type_are_taken(given: Given) -> None:
    plain = exact(given.device, given.envmap, 5, 2.0)
    for resolution, albedo in ((np.int64(5), np.float32(2)), (np.uint8(5), 2), (np.array(5), np.array(2.0))):
        np.testing.assert_array_equal(exact(given.device, given.envmap, resolution, albedo), plain)
    half = given.distribution.sample(np.int32(4), seed=np.uint64(7))
    np.testing.assert_array_equal(half.pixel, given.distribution.sample(4, 7).pixel)


def test_an_albedo_above_1_scales_every_image(given: Given) -> None:
    g = given
    for image in (
        lambda albedo: exact(g.device, g.envmap, 9, albedo),
        lambda albedo: shade(g.device, UP, FLUX, 9, albedo),
        lambda albedo: shade_samples(g.device, g.samples, 9, albedo),
        lambda albedo: shade_harmonics(g.device, g.harmonics, 9, albedo),
        lambda albedo: next(render(g.distribution, [2], 9, albedo))[1],
    ):
        np.testing.assert_allclose(image(2.0), 2 * image(1.0), rtol=1e-6)


def test_the_brightest_lights_under_the_largest_albedo_stay_finite(given: Given) -> None:
    image = shade(given.device, UP, FLUX * 1e200, 9, 3e38)
    assert np.isfinite(image).all()
    assert image.max() == np.finfo(np.float32).max
    harmonics = Harmonics(np.full((9, 3), 1e200))
    assert np.isfinite(shade_harmonics(given.device, harmonics, 9, 3e38)).all()


def test_an_image_of_infinite_pixels_is_white_there(given: Given) -> None:
    image = with_value(np.inf)
    assert auto_exposure(image) == 1
    assert tone_map(image, 1e308)[1, 2, 0] == 255


def test_checks_cost_no_time(given: Given) -> None:
    rng = np.random.default_rng(1)
    direction = rng.normal(size=(131072, 3))
    direction = (direction / np.linalg.norm(direction, axis=1, keepdims=True)).astype(np.float32)
    flux = rng.random((131072, 3))

    def seconds(call: Callable[[], object]) -> float:
        times = []
        for _ in range(3):
            start = time.perf_counter()
            call()
            times.append(time.perf_counter() - start)
        return min(times)

    checked = seconds(lambda: checks.lights(direction, flux))
    assert checked < 0.1 * seconds(lambda: shade(given.device, direction, flux, 127))


def test_a_wrong_value_is_described_in_few_words() -> None:
    told = checks.told
    assert told(np.zeros((1000, 1000))) == "an array of shape (1000, 1000) and type float64"
    assert len(told("x" * 10**6)) < 100
    assert len(told([0] * 10**6)) < 100
    assert not re.search(r"[\n\x1b]", told("a\n\x1b[31mb"))
