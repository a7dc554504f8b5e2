"""Lights that stand for a map: each mistake is named, and correct lights agree."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers import stiff_radiance
from lightdome.checking.lights import check_lights, read_lights
from lightdome.commands.lights import make
from lightdome.errors import LightdomeError
from lightdome.lighting.light_files import write_csv
from lightdome.maps.conventions import from_uv
from lightdome.maps.envmap import EnvironmentMap
from lightdome.names import CONVENTIONS, LIGHT_METHODS
from lightdome.opencl.device import Device
from lightdome.sampling.distribution import build_distribution
from student_lights import cut


def room() -> np.ndarray:
    """Two coloured lamps and a window in a dark room with some noise."""
    v, u = (np.arange(24) + 0.5) / 24, (np.arange(48) + 0.5) / 48
    towards = from_uv(u[None], v[:, None])
    radiance = 0.1 + 0.1 * np.random.default_rng(4).random((24, 48, 3))
    for at, colour, width in (((0.9, 0.3, 0.3), (9, 3, 1), 40), ((0, 0.8, -0.6), (2, 3, 9), 9), ((-1, -0.4, 0), 3, 5)):
        radiance += np.exp(width * (towards @ np.array(at) - 1))[..., None] * np.array(colour)
    return radiance.astype(np.float32)


MAPS = {"room": room(), "stiff": stiff_radiance(21, 43)}
MISTAKES = [
    "no sin(theta)",
    "sin(theta) twice",
    "solid angle missing",
    "map clipped to 1",
    "map gamma-encoded",
    "cut line in both halves",
    "cut line in neither half",
    "flux normalised away",
    "pi missing",
    "flux scaled",
    "channels swapped",
    "theta over half its range",
    "phi over half its range",
    "x and y swapped",
    "directions not normalised",
    "wrong directions",
]
TURNED = ["mirrored left to right", "upside down", "directions point away from the light"]


@pytest.mark.parametrize("mistake", MISTAKES)
def test_each_mistake_is_named(device: Device, mistake: str) -> None:
    for radiance in MAPS.values():
        check = check_lights(device, EnvironmentMap(radiance), *cut(radiance, 64, mistake))
        assert check.agrees is False
        assert check.cause is not None, check.verdict
        assert check.cause.name == mistake, check.verdict


@pytest.mark.parametrize("mistake", TURNED)
def test_the_orientation_is_reported(device: Device, mistake: str) -> None:
    for radiance in MAPS.values():
        check = check_lights(device, EnvironmentMap(radiance), *cut(radiance, 64, mistake))
        assert check.agrees is False
        assert check.orientation == mistake


def test_an_independent_correct_median_cut_agrees(device: Device) -> None:
    for radiance in MAPS.values():
        for count in (4, 16, 64, 256):
            check = check_lights(device, EnvironmentMap(radiance), *cut(radiance, count))
            assert check.agrees, check.verdict


@pytest.mark.slow
def test_lightdomes_own_agree_in_every_convention(device: Device, tmp_path: Path) -> None:
    tried = 0
    for radiance in MAPS.values():
        envmap = EnvironmentMap(radiance)
        for n, method in enumerate(
            name for name in LIGHT_METHODS if name != "sun+median-cut"
        ):  # these maps have no sun
            for count in (2, 16, 100):
                tried += 1
                write_csv(tmp_path / "lights.csv", make(device, envmap, method, count, tried))
                direction, flux = read_lights(tmp_path / "lights.csv")
                u = np.arctan2(direction[:, 2], direction[:, 0]) / (2 * np.pi)
                v = np.arccos(np.clip(direction[:, 1], -1, 1)) / np.pi
                convention = CONVENTIONS[(n + count) % len(CONVENTIONS)]
                check = check_lights(device, envmap, from_uv(u, v, convention), flux)
                assert check.agrees, (method, count, convention, check.verdict)
    assert tried == 6 * (len(LIGHT_METHODS) - 1)


def test_samples_given_as_lights_have_the_wrong_flux(device: Device) -> None:
    envmap = EnvironmentMap(MAPS["room"])
    samples = build_distribution(device, envmap).sample(1024, 0)
    check = check_lights(device, envmap, samples.direction, samples.radiance)
    assert check.cause is not None
    assert check.cause.name == "flux scaled"


def test_what_cannot_be_checked_is_refused(device: Device, tmp_path: Path) -> None:
    envmap = EnvironmentMap(MAPS["room"])
    one = np.array([[0.0, 1, 0]])
    for of_map, direction, flux, message in (
        (EnvironmentMap(np.zeros((4, 8, 3))), one, one, "black"),
        (envmap, one, one * np.nan, "finite"),
        (envmap, one[:0], one[:0], "at least one"),
        (envmap, one, np.ones((2, 3)), "shape"),
    ):
        with pytest.raises(LightdomeError, match=message):
            check_lights(device, of_map, direction, flux)
    (tmp_path / "lights.csv").write_text("x,y,z\n0,1,0\n")
    with pytest.raises(LightdomeError, match="flux"):
        read_lights(tmp_path / "lights.csv")
