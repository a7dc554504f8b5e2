"""Images and tables of densities: each mistake is named, and correct densities agree."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers import stiff_radiance
from lightdome.checking.pdf import check_pdf, read_pdf
from lightdome.errors import LightdomeError
from lightdome.maps.conventions import from_uv
from lightdome.maps.envmap import EnvironmentMap
from lightdome.maps.images import write_image
from lightdome.opencl.device import Device
from lightdome.sampling.distribution import build_distribution

MAPS = [stiff_radiance(21, 43), stiff_radiance(16, 32, 5), stiff_radiance(24, 24, 9)]


def images(radiance: np.ndarray) -> dict[str, np.ndarray]:
    """Images of densities (H, W): the correct one under "", the others under the name of the mistake."""
    L = radiance.astype(np.float64)
    height, width = L.shape[:2]
    theta = np.pi * (np.arange(height) + 0.5) / height
    sine = np.sin(theta)[:, None]
    light = L.sum(axis=2) / 3
    area = 4 * np.pi * sine / (sine.sum() * width)

    def density(weight: np.ndarray) -> np.ndarray:
        return weight / weight.sum() / area

    return {
        "": density(light * sine),
        "no sin(theta)": density(light),
        "sin(theta) twice": density(light * sine**2),
        "luminance of Rec. 709": density(L @ np.array([0.2126, 0.7152, 0.0722]) * sine),
        "map clipped to 1": density(np.minimum(L, 1).sum(axis=2) * sine),
        "map gamma-encoded": density((L ** (1 / 2.2)).sum(axis=2) * sine),
        "not normalised": light,
        "density over the map": light * sine / (light * sine).mean(),
    }


def test_each_mistake_is_named() -> None:
    for radiance in MAPS:
        envmap = EnvironmentMap(radiance)
        for name, image in images(radiance).items():
            check = check_pdf(envmap, image)
            assert check.agrees is (name == ""), check.verdict
            assert (check.cause.name if check.cause else "") == name, check.verdict


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda image: image[::-1], "upside down"),
        (lambda image: image[:, ::-1], "mirrored left to right"),
        (lambda image: np.roll(image, 3, axis=1), "columns moved by 3 of 32"),
        (lambda image: np.roll(image[:, ::-1], 3, axis=1), "mirrored left to right and columns moved by 3 of 32"),
        (lambda image: np.roll(image, 1, axis=0), "rows moved by 1"),
        (lambda image: image.T, "rows and columns exchanged"),
    ],
)
def test_the_orientation_is_reported(change, told: str) -> None:  # type: ignore[no-untyped-def]
    check = check_pdf(EnvironmentMap(MAPS[1]), change(images(MAPS[1])[""]))
    assert check.agrees is False
    assert check.orientation == told


def test_lightdomes_own_agree(device: Device) -> None:
    directions = from_uv(*np.random.default_rng(1).random((2, 500)))
    for radiance in MAPS:
        envmap = EnvironmentMap(radiance)
        distribution = build_distribution(device, envmap)
        probabilities = distribution.probability_image()
        assert check_pdf(envmap, probabilities.astype(np.float32)).agrees
        assert check_pdf(envmap, probabilities, per="pixel").agrees
        assert check_pdf(envmap, distribution.pdf(directions), directions).agrees
        cause = check_pdf(envmap, probabilities, per="steradian").cause
        assert cause is not None
        assert cause.name == "solid angle missing"


@pytest.mark.slow
def test_densities_by_direction_are_named_too() -> None:
    for radiance in MAPS:
        height, width = radiance.shape[:2]
        v, u = np.random.default_rng(2).random((2, 800))
        at = (v * height).astype(int), (u * width).astype(int)
        for name, image in images(radiance).items():
            check = check_pdf(EnvironmentMap(radiance), image[at], from_uv(u, v))
            assert (check.cause.name if check.cause else "") == name, check.verdict


def test_files(tmp_path: Path) -> None:
    image = images(MAPS[0])[""].astype(np.float32)
    write_image(tmp_path / "pdf.pfm", np.repeat(image[..., None], 3, axis=2))
    np.savez(tmp_path / "image.npz", pdf=image)
    np.savez(tmp_path / "table.npz", pdf=image[0], direction=np.ones((43, 3)))
    for name, expected in (("pdf.pfm", image), ("image.npz", image), ("table.npz", image[0])):
        values, direction = read_pdf(tmp_path / name)
        np.testing.assert_array_equal(values, expected)
        assert (direction is None) == (name != "table.npz")


def test_what_cannot_be_checked_is_refused(tmp_path: Path) -> None:
    write_image(tmp_path / "map.pfm", MAPS[0])
    np.savez(tmp_path / "other.npz", image=MAPS[0])
    np.savez(tmp_path / "samples.npz", direction=np.ones((2, 3)), probability=np.ones(2))
    for name, message in (("map.pfm", "must be grey"), ("other.npz", "no densities"), ("samples.npz", "no densities")):
        with pytest.raises(LightdomeError, match=message):
            read_pdf(tmp_path / name)
    with pytest.raises(LightdomeError, match="the map's size, 43 x 21"):
        check_pdf(EnvironmentMap(MAPS[0]), np.ones((3, 4)))
    with pytest.raises(LightdomeError, match="finite"):
        check_pdf(EnvironmentMap(MAPS[0]), np.full((21, 43), np.inf))
