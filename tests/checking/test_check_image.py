"""Correct images of any program agree; each mistake in a student's renderer is named."""

from __future__ import annotations

import json
import math
import re

import lightdome
import numpy as np
import pytest
from helpers import ROOT
from lightdome.checking.causes import CAUSES
from lightdome.checking.disc import find_disc
from lightdome.checking.image import Reference
from lightdome.commands.check import image_lines
from lightdome.disc import disc_mask
from lightdome.errors import LightdomeError
from lightdome.lighting.exact import exact
from lightdome.lighting.shade import shade_samples
from lightdome.maps.conventions import yaw_between
from lightdome.maps.envmap import EnvironmentMap
from lightdome.maps.geometry import column_angles, directions, row_angles
from lightdome.maps.images import tone_map
from lightdome.names import CONVENTIONS, ESTIMATORS, SEQUENCES
from lightdome.opencl.device import Device
from lightdome.rendering.per_pixel import render as render_per_pixel
from lightdome.sampling.distribution import build_distribution
from student import ALBEDO, MISTAKES, render

COUNT, SIDE = 2**16, 63


@pytest.fixture(scope="module")
def lamps() -> EnvironmentMap:
    """An irregular sky with coloured lamps, one of them brighter than 255."""
    height, width = 32, 64
    towards = directions(row_angles(height)[:, None], column_angles(width)[None])
    radiance = 0.3 + 0.25 * towards @ np.array([[0.6, 0.1, 0.2], [0.1, 0.7, 0.1], [0.3, 0.2, -0.6]])
    rng = np.random.default_rng(3)
    radiance *= rng.uniform(0.2, 2, radiance.shape)
    for azimuth, elevation, size, colour in (
        (20, 45, 0.98, (9, 3, 1)),
        (110, -15, 0.985, (2, 5, 12)),
        (215, 65, 0.98, (3, 8, 2)),
        (70, 20, 0.9975, (500, 400, 350)),
    ):
        middle = directions(np.radians(90 - elevation), np.radians(azimuth))
        radiance[towards @ middle > size] = colour
    return EnvironmentMap(radiance.astype(np.float32))


@pytest.fixture(scope="module")
def references(device: Device, lamps: EnvironmentMap) -> dict[float, Reference]:
    """By albedo."""
    return {albedo: Reference(device, lamps, albedo) for albedo in (1.0, *ALBEDO.values())}


@pytest.fixture(scope="module")
def image(lamps: EnvironmentMap) -> np.ndarray:
    return render(lamps.radiance, COUNT, SIDE)


@pytest.mark.slow
@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_named(lamps: EnvironmentMap, references: dict[float, Reference], mistake: str) -> None:
    albedo = ALBEDO.get(mistake, 1.0)
    check = references[albedo].check(render(lamps.radiance, COUNT, SIDE, 1, mistake, albedo), COUNT)
    assert MISTAKES[mistake] in check.verdict
    assert "; either " not in check.verdict
    assert check.agrees is (MISTAKES[mistake] == "agrees")


def test_the_student_can_make_every_mistake() -> None:
    said = " ".join(MISTAKES.values())
    assert [cause.name for cause in CAUSES if cause.name not in said and not cause.in_pictures] == []


def test_the_page_on_checks_lists_every_cause() -> None:
    page = (ROOT / "docs" / "check.md").read_text(encoding="utf-8")
    rows = [" | ".join((c.name, c.what, c.seen, c.where)) for c in CAUSES]
    listed = re.findall(r"^\| (.*) \|$", page.replace("\\|", "|").partition("## Causes")[2], re.MULTILINE)
    assert listed[2 : 2 + len(rows)] == rows


@pytest.mark.parametrize("count", [16, pytest.param(4096, marks=pytest.mark.slow)])
@pytest.mark.parametrize("sequence", [*SEQUENCES, "numpy"])
def test_correct_images_of_shared_samples_agree(
    device: Device, lamps: EnvironmentMap, references: dict[float, Reference], sequence: str, count: int
) -> None:
    if sequence == "numpy":
        made = render(lamps.radiance, count, SIDE)
    else:
        within = "centre" if count == 16 else "pixel"
        made = shade_samples(device, build_distribution(device, lamps).sample(count, 0, sequence, within), SIDE)
    assert references[1.0].check(made, count).agrees


@pytest.mark.slow
@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_correct_images_of_fresh_samples_agree(
    device: Device, lamps: EnvironmentMap, references: dict[float, Reference], estimator: str
) -> None:
    distribution = build_distribution(device, lamps)
    for spp, made in render_per_pixel(distribution, [1, 16], SIDE, estimator=estimator):
        assert references[1.0].check(made, spp, per_pixel=True).agrees
        if estimator != "bsdf":
            assert references[1.0].check(made[::-1], spp, per_pixel=True).agrees is False


def test_exact_images_agree_without_a_number_of_samples(
    device: Device, lamps: EnvironmentMap, references: dict[float, Reference]
) -> None:
    for pixels in ("centres", "areas"):
        assert references[1.0].check(exact(device, lamps, 101, pixels=pixels)).agrees


@pytest.mark.slow
def test_without_a_number_of_samples_only_a_gross_mistake_is_named(
    lamps: EnvironmentMap, references: dict[float, Reference], image: np.ndarray
) -> None:
    few = references[1.0].check(render(lamps.radiance, 256, SIDE))
    assert few.agrees is None
    assert "give the" in few.verdict
    assert references[1.0].check(image[:, ::-1]).orientation == "mirrored left to right"


def test_the_sphere_is_found_in_a_larger_image(references: dict[float, Reference], image: np.ndarray) -> None:
    larger = np.zeros((200, 300, 3), np.float32)
    larger[40 : 40 + SIDE, 70 : 70 + SIDE] = image
    assert find_disc(larger) == pytest.approx((70 + SIDE / 2, 40 + SIDE / 2, SIDE / 2), abs=1)
    assert references[1.0].check(larger, COUNT).agrees


@pytest.mark.slow
@pytest.mark.parametrize("name", CONVENTIONS)
def test_a_map_of_another_convention_is_recognised(
    lamps: EnvironmentMap, references: dict[float, Reference], name: str
) -> None:
    file_of_that = lamps.to_convention(name)
    check = references[1.0].check(render(file_of_that.radiance, COUNT, SIDE), COUNT)
    if name in ("lightdome", "pbrt"):
        assert check.agrees
    else:
        # The image of a file read without its convention is correct for this map read with the inverse convention.
        (said,) = re.findall("--convention (.*)", check.verdict)
        assert any(np.array_equal(EnvironmentMap(file_of_that.radiance).radiance, f) for f in _files(lamps, said))


def _files(envmap: EnvironmentMap, said: str) -> list[np.ndarray]:
    """The map read as a file of each convention that the verdict mentions."""
    width = envmap.width
    turns = [-round(yaw_between(name, "lightdome") / 360 * width) % width for name in said.split(" or ")]
    return [np.roll(envmap.radiance, turn, axis=1) for turn in turns]


def test_factors_are_reported_apart_from_the_shape(references: dict[float, Reference], image: np.ndarray) -> None:
    twice = references[1.0].check(2 * image, COUNT)
    assert twice.agrees is False
    assert "an extra factor of 2" in twice.verdict
    np.testing.assert_allclose(twice.factor, 2, rtol=0.02)
    tinted = references[1.0].check(image * np.array([1, 1.2, 0.8], np.float32), COUNT)
    np.testing.assert_allclose(tinted.factor, [1, 1.2, 0.8], rtol=0.02)
    assert "red 1" in tinted.verdict


@pytest.mark.parametrize("exposure", [0.1, 0.5])
def test_the_brightness_of_a_picture_does_not_matter(
    references: dict[float, Reference], image: np.ndarray, exposure: float
) -> None:
    decoded = (tone_map(image, exposure) / 255.0) ** 2.2
    assert references[1.0].check(decoded, COUNT, linear=False).agrees
    assert references[1.0].check(decoded[::-1], COUNT, linear=False).orientation == "upside down"
    assert references[1.0].check(np.ones_like(image), COUNT, linear=False).agrees is None


@pytest.mark.slow
def test_an_unknown_mistake_is_not_named(references: dict[float, Reference], image: np.ndarray) -> None:
    noise = np.random.default_rng(0).random(image.shape).astype(np.float32)
    assert "does not look like a sphere" in references[1.0].check(noise, COUNT).verdict
    for bad in (
        np.where(disc_mask(SIDE)[..., None], noise, 0),
        image * np.linspace(0.5, 1.5, SIDE, dtype=np.float32)[:, None],
    ):
        check = references[1.0].check(bad, COUNT)
        assert check.agrees is False
        assert check.cause is None
        assert "no known mistake explains it" in check.verdict
    assert "black" in references[1.0].check(np.zeros_like(image), COUNT).verdict


def test_the_result_has_the_largest_error_and_can_be_written_as_json(
    device: Device, lamps: EnvironmentMap, image: np.ndarray
) -> None:
    image = image.copy()
    image[30, 12] += 5
    check = lightdome.check_image(device, image, lamps, samples=COUNT)
    assert check.agrees
    assert check.largest_at == (12, 30)
    assert check.largest_error == pytest.approx(5, rel=0.2)
    assert check.verdict in repr(check)
    told = json.loads(json.dumps(check.to_dict(), allow_nan=False))
    assert told["agrees"] is True
    assert told["expected"]["samples"] == COUNT
    truth = exact(device, lamps, SIDE)[disc_mask(SIDE)]
    seen = image[disc_mask(SIDE)]
    assert check.relative_rmse == pytest.approx(math.sqrt(((seen - truth) ** 2).mean() / (truth**2).mean()), rel=0.05)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"samples": 4, "spp": 4}, "not both"),
        ({"samples": 0}, "a number of samples"),
        ({"image": np.zeros((8, 8, 3))}, "16 x 16"),
        ({"image": np.zeros((32, 32))}, "the image"),
        ({"image": np.full((32, 32, 3), np.nan)}, "1024 pixels of the image are NaN or infinite"),
        ({"envmap": EnvironmentMap(np.zeros((8, 16, 3), np.float32))}, "the map is black"),
        ({"albedo": 0.0}, "albedo 0"),
        ({"linear": 1}, "linear must be True or False"),
    ],
)
def test_what_cannot_be_checked_is_refused(
    device: Device, lamps: EnvironmentMap, image: np.ndarray, changes: dict[str, object], words: str
) -> None:
    arguments = {"device": device, "image": image, "envmap": lamps, **changes}
    with pytest.raises(LightdomeError, match=words):
        lightdome.check_image(**arguments)


def test_a_large_map_is_reduced_to_simulate_mistakes(device: Device) -> None:
    radiance = np.random.default_rng(0).random((1100, 130, 3)).astype(np.float32)
    reference = Reference(device, EnvironmentMap(radiance))
    assert reference.small.height == 367
    assert len(reference.blocks(reference.small.radiance)[0]) < 130 * 128
    np.testing.assert_allclose(reference.seen, reference.right, rtol=0.02)


PAIRS = (
    "no sine + map clipped",
    "x and y swapped + sine twice",
    "channels swapped + flat normals",
    "absolute cosine + no sine",
    "no sine + mirrored",
    "normals without root + rows upside down",
)


@pytest.mark.slow
@pytest.mark.parametrize("pair", PAIRS)
def test_two_mistakes_are_both_named(lamps: EnvironmentMap, references: dict[float, Reference], pair: str) -> None:
    check = references[1.0].check(render(lamps.radiance, COUNT, SIDE, 1, pair), COUNT)
    assert check.agrees is False
    assert "two mistakes: " in check.verdict or "more than one mistake; closest: " in check.verdict
    for mistake in pair.split(" + "):
        assert MISTAKES[mistake].rstrip(":") in check.verdict
    if "two mistakes: " in check.verdict:
        lines = "\n".join(image_lines(check))
        assert len(check.causes) + bool(check.orientation) == 2
        assert all(f"{cause.seen}\n" in lines and f"{cause.where}\n" in lines for cause in check.causes)


@pytest.mark.slow
@pytest.mark.parametrize("exposure", [0.1, 0.5])
def test_a_picture_encoded_never_or_twice_is_named(
    references: dict[float, Reference], image: np.ndarray, exposure: float
) -> None:
    linear = np.rint(255 * np.clip(image * exposure, 0, 1)) / 255  # written without encoding
    check = references[1.0].check(linear**2.2, COUNT, linear=False)
    assert check.cause is not None
    assert check.cause.name == "picture not gamma-encoded"
    twice = np.rint(255 * np.clip(image * exposure, 0, 1) ** (1 / 2.2**2)) / 255
    check = references[1.0].check(twice**2.2, COUNT, linear=False)
    assert check.cause is not None
    assert check.cause.name == "picture gamma-encoded twice"
