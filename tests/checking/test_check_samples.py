"""Samples of other programs: each mistake is named, and correct samples agree."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers import stiff_radiance
from lightdome.checking.causes import CAUSES
from lightdome.checking.laws import LAWS
from lightdome.checking.samples import CAUSES_OF_SAMPLES, check_samples, read_samples
from lightdome.errors import LightdomeError
from lightdome.maps.conventions import from_uv
from lightdome.maps.envmap import EnvironmentMap
from lightdome.names import CONVENTIONS, SEQUENCES, WITHIN
from lightdome.opencl.device import Device
from lightdome.sampling.distribution import build_distribution
from student_samples import draw


def sky() -> np.ndarray:
    """A grey-blue sky with a sun a few pixels wide, three black rows, and a little noise."""
    v, u = (np.arange(32) + 0.5) / 32, (np.arange(64) + 0.5) / 64
    towards = from_uv(u[None], v[:, None])
    sun = np.exp(80 * (towards @ np.array([0.51, 0.62, 0.596]) - 1))[..., None]
    up = np.maximum(0, towards[..., 1:2])
    noise = np.random.default_rng(3).random((32, 64, 3))
    radiance = 0.3 + up * [0.5, 0.8, 1.4] + sun * [900, 700, 400] + 0.2 * noise
    radiance[:3] = 0
    return radiance.astype(np.float32)


MAPS = {"stiff": stiff_radiance(21, 43), "sky": sky(), "other": stiff_radiance(16, 32, 5)}
MISTAKES = [
    *dict.fromkeys(name for name, _ in LAWS if name not in ("pixels drawn evenly", "directions drawn evenly")),
    "channels swapped",
    "phi over half its range",
    "x and y swapped",
    "pixel edges for centres",
    "W - 1 for W",
    "directions not normalised",
    "radiance of other pixels",
    "radiance scaled",
    "density for probability",
    "solid angle missing",
    "density over the map",
    "probability of the row alone",
    "probability of the column alone",
    "not normalised",
    "zero-weight pixels drawn",
    "samples repeated",
    "pixel of another convention",
]


def points(count: int = 1024, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).random((count, 2))


@pytest.mark.parametrize("mistake", MISTAKES)
def test_each_mistake_is_named(mistake: str) -> None:
    # The sky is so smooth that neighbouring rows have nearly the same CDF.
    maps = [L for name, L in MAPS.items() if (mistake, name) != ("row CDF of another row", "sky")]
    for n, radiance in enumerate(maps):
        check = check_samples(EnvironmentMap(radiance), **draw(radiance, points(seed=n), mistake, within=n == 1))
        assert check.agrees is False, mistake
        assert check.cause is not None, check.verdict
        assert check.cause.name == mistake, check.verdict


@pytest.mark.parametrize(
    "mistake",
    [
        "no sin(theta)",
        "map clipped to 1",
        "CDF sorted",
        "one random number for row and column",
        "CDF starts at row 1",
        "rows drawn evenly",
        "columns drawn evenly",
        "x and y swapped",
    ],
)
def test_directions_and_radiance_are_enough_for_most_mistakes(mistake: str) -> None:
    for radiance in MAPS.values():
        drawn = draw(radiance, points(4096), mistake)
        check = check_samples(EnvironmentMap(radiance), drawn["direction"], drawn["radiance"])
        assert check.cause is not None, check.verdict
        assert check.cause.name == mistake, check.verdict


def turned(direction: np.ndarray, convention: str) -> np.ndarray:
    """The directions of the same places in the map in another convention."""
    u = np.arctan2(direction[:, 2], direction[:, 0]) / (2 * np.pi)
    return from_uv(u, np.arccos(np.clip(direction[:, 1], -1, 1)) / np.pi, convention)


@pytest.mark.slow
def test_correct_samples_agree_in_every_convention(device: Device) -> None:
    tried = 0
    for name, radiance in MAPS.items():
        envmap = EnvironmentMap(radiance)
        distribution = build_distribution(device, envmap)
        for n, sequence in enumerate(SEQUENCES):
            for within in WITHIN:
                for count in (1, 16, 100, 1024):
                    for seed in range(3):
                        tried += 1
                        samples = distribution.sample(count, seed, sequence, within)
                        convention = CONVENTIONS[(n + seed + count) % len(CONVENTIONS)]
                        own = [
                            {"radiance": samples.radiance, "probability": samples.probability, "pixel": samples.pixel},
                            {"radiance": samples.radiance, "pdf": samples.density},
                            {"radiance": np.round(samples.radiance, 5)},
                        ][seed]
                        direction = np.round(turned(samples.direction.astype(np.float64), convention), 6)
                        check = check_samples(envmap, direction, **own)
                        assert check.agrees, (name, sequence, within, count, seed, convention, check.verdict)
                        if count > 1:
                            expected = "" if convention == "lightdome" else f"the convention of {convention}"
                            assert check.orientation == expected or count < 100
    assert tried >= 200


def test_an_independent_correct_program_agrees() -> None:
    for radiance in MAPS.values():
        for seed in range(10):
            check = check_samples(EnvironmentMap(radiance), **draw(radiance, points(500, seed), within=seed % 2 == 0))
            assert check.agrees, check.verdict


@pytest.mark.parametrize(
    ("axes", "told"),
    [
        ([-1, 1, 1], "mirrored left to right"),
        ([1, 1, -1], "mirrored front to back, as if phi ran the other way"),
        ([1, -1, 1], "upside down"),
        ([-1, -1, -1], "directions point away from the light"),
    ],
)
def test_mirrored_and_turned_directions_are_reported(axes: list[int], told: str) -> None:
    for radiance in MAPS.values():
        drawn = draw(radiance, points())
        check = check_samples(EnvironmentMap(radiance), drawn["direction"] * axes, drawn["radiance"])
        assert not check.agrees
        assert check.orientation == told
        assert told in check.verdict


def test_a_map_turned_by_some_columns_is_reported() -> None:
    radiance = MAPS["sky"]
    drawn = draw(np.roll(radiance, 5, axis=1), points())
    check = check_samples(EnvironmentMap(radiance), drawn["direction"], drawn["radiance"])
    assert not check.agrees
    assert check.orientation == f"the map turned by {360 * (1 - 5 / 64):.4g} degrees about the vertical"


@pytest.mark.parametrize("suffix", [".npz", ".csv"])
def test_tables_are_read_by_their_names(tmp_path: Path, suffix: str) -> None:
    drawn = draw(MAPS["sky"], points(64))
    path = tmp_path / f"samples{suffix}"
    if suffix == ".npz":
        np.savez(path, **drawn)
    else:
        names = "x,y,z,red,green,blue,probability,pixel_x,pixel_y,pdf"
        arrays = [drawn[k].reshape(64, -1) for k in ("direction", "radiance", "probability", "pixel", "pdf")]
        np.savetxt(path, np.hstack(arrays), delimiter=",", header=names, comments="")
    for name, found in zip(("direction", "radiance", "probability", "pixel", "pdf"), read_samples(path), strict=True):
        np.testing.assert_allclose(found, drawn[name], rtol=1e-15)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "a header line"),
        ("x,y,z\n", "a header line"),
        ("PF\n1 1\n\0\0\0", "is not a table"),
        ("1,2,3\n4,5,6\n", "the first line has numbers"),
        ("x,y,z\n1,2\n", "line 2 has 2 values"),
        ("a,b,c\n1,2,3\n", "no directions"),
    ],
)
def test_a_file_that_is_not_a_table_of_samples_is_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "samples.csv"
    path.write_text(text)
    with pytest.raises(LightdomeError, match=message):
        read_samples(path)


def test_what_cannot_be_checked_is_refused() -> None:
    black, envmap = EnvironmentMap(np.zeros((4, 8, 3))), EnvironmentMap(MAPS["sky"])
    for of_map, direction, message in (
        (black, [[0, 1, 0]], "black"),
        (envmap, [[0, 0, 0]], "must be finite and not zero"),
        (envmap, np.empty((0, 3)), "at least one direction"),
        (envmap, [[0, 1]], "shape"),
    ):
        with pytest.raises(LightdomeError, match=message):
            check_samples(of_map, np.array(direction, float))
    with pytest.raises(LightdomeError, match="finite"):
        check_samples(envmap, np.array([[0.0, 1, 0]]), radiance=np.full((1, 3), np.nan))


def test_every_law_has_its_cause() -> None:
    assert {name for name, _ in LAWS} <= {cause.name for cause in (*CAUSES, *CAUSES_OF_SAMPLES)}
    names = [cause.name for cause in (*CAUSES, *CAUSES_OF_SAMPLES)]
    assert len(set(names)) == len(names)


def test_the_result_can_be_written_as_json() -> None:
    radiance = MAPS["sky"]
    told = check_samples(EnvironmentMap(radiance), draw(radiance, points(1))["direction"]).to_dict()
    assert told["agrees"] is True
    assert told["chi_square_deviations"] is None
