"""Where each projection puts a direction, the solid angles of its pixels, and how projections are detected."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest
from conventions import python_with
from lightdome import maps
from lightdome.errors import LightdomeError
from lightdome.maps.conversion import detected
from lightdome.maps.envmap import EnvironmentMap
from lightdome.maps.images import write_image
from lightdome.maps.projections import PROJECTIONS
from lightdome.names import PROJECTIONS as NAMES
from lightdome.pbrt.equal_area import to_equal_area

# The positions of +x, -x, +y, -y, +z, -z in an image of size 1, x to the right and y down, by definition.
AXES = np.array([(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)], float)
HALF = np.sqrt(0.5) / 2
PLACES = {
    "latlong": [(0, 0.5), (1, 0.5), None, None, (0.5, 0.5), (1.5, 0.5)],  # phi is undefined at the poles
    "angular": [(0.75, 0.5), (0.25, 0.5), (0.5, 0.25), (0.5, 0.75), None, (0.5, 0.5)],
    "mirror": [(0.5 + HALF, 0.5), (0.5 - HALF, 0.5), (0.5, 0.5 - HALF), (0.5, 0.5 + HALF), None, (0.5, 0.5)],
    "cube-cross": [(2.5, 1.5), (0.5, 1.5), (1.5, 0.5), (1.5, 2.5), (1.5, 3.5), (1.5, 1.5)],
    "cube-cross-horizontal": [(2.5, 1.5), (0.5, 1.5), (1.5, 0.5), (1.5, 2.5), (3.5, 1.5), (1.5, 1.5)],
    "cube-strip": [(0.5, n + 0.5) for n in range(6)],
    "cube-strip-horizontal": [(n + 0.5, 0.5) for n in range(6)],
    "cube-openexr": [(0.5, n + 0.5) for n in range(6)],
    "octahedral": [(1, 0.5), (0, 0.5), (0.5, 0.5), None, (0.5, 1), (0.5, 0)],  # -y is in the corners
}
SIZE = 12


def centres(shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    y, x = np.indices(shape) + 0.5
    return x, y


def test_the_names_are_those_of_the_command_line() -> None:
    assert tuple(PROJECTIONS) == NAMES == tuple(PLACES)


@pytest.mark.parametrize("name", PROJECTIONS)
def test_the_axes_lie_where_the_definition_says(name: str) -> None:
    projection = PROJECTIONS[name]
    x, y = projection.positions(AXES, projection.shape(SIZE))
    for place, *found in zip(PLACES[name], x / SIZE, y / SIZE, strict=True):
        if place:
            assert found == pytest.approx(place, abs=1e-12)


# The directions to the right of the middle of each face, and below it: +x, -x, +y, -y, +z, -z.
RIGHT = np.array([(0, 0, 1), (0, 0, -1), (1, 0, 0), (1, 0, 0), (-1, 0, 0), (1, 0, 0)], float)
BELOW = np.array([(0, -1, 0), (0, -1, 0), (0, 0, -1), (0, 0, 1), (0, -1, 0), (0, -1, 0)], float)


@pytest.mark.parametrize("name", [name for name in PROJECTIONS if name.startswith("cube")])
def test_faces_are_seen_from_inside(name: str) -> None:
    projection = PROJECTIONS[name]
    for face in range(6):
        turned = -1 if name == "cube-cross" and face == 4 else 1  # its back is upside down
        direction = AXES[face] + 0.2 * RIGHT[face] + 0.4 * BELOW[face]
        x, y = projection.positions(direction / np.linalg.norm(direction), projection.shape(SIZE))
        place = np.array(PLACES[name][face])
        span = (SIZE - 1) / SIZE if name == "cube-openexr" else 1
        assert (x / SIZE, y / SIZE) == pytest.approx(place + turned * span * np.array([0.1, 0.2]), abs=1e-12)


def test_openexr_puts_the_centres_of_outer_pixels_on_the_edges() -> None:
    """ImfEnvmap.cpp: pif = (d / major + 1) / 2 * (size - 1); on the face +x, column pif(z), row size - 1 - pif(y)."""
    direction = np.array([1, -1, 1]) / np.sqrt(3)
    x, y = PROJECTIONS["cube-openexr"].positions(direction, (24, 4))
    assert (x, y) == pytest.approx((3.5, 3.5))


@pytest.mark.parametrize("name", ["angular", "mirror"])
def test_a_disc_is_what_debevec_and_a_mirror_say(name: str) -> None:
    direction = np.random.default_rng(3).normal(size=(500, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    x, y, z = direction.T
    if name == "angular":
        r = np.arccos(-z) / np.pi
    else:  # the normal of the ball where it mirrors the direction to an eye far away at -z
        normal = direction - (0, 0, 1)
        r = np.hypot(*normal.T[:2]) / np.linalg.norm(normal, axis=1)
    psi = np.arctan2(y, x)
    expected = 50 * (1 + r * np.cos(psi)), 50 * (1 - r * np.sin(psi))
    np.testing.assert_allclose(PROJECTIONS[name].positions(direction, (100, 100)), expected, atol=1e-9)


@pytest.mark.parametrize("name", PROJECTIONS)
def test_directions_are_unit_vectors_that_lead_back(name: str) -> None:
    projection = PROJECTIONS[name]
    shape = projection.shape(SIZE)
    direction = np.random.default_rng(2).normal(size=(1000, 3))
    signs = np.indices((3, 3, 3)).reshape(3, 27).T - 1  # edges and corners of a cube, where faces meet
    direction = np.concatenate([signs[np.abs(signs).sum(axis=1) > 1], direction])
    direction = np.concatenate([AXES, direction / np.linalg.norm(direction, axis=1)[:, None]])
    x, y = projection.positions(direction, shape)
    assert ((x >= 0) & (x <= shape[1]) & (y >= 0) & (y <= shape[0])).all()
    np.testing.assert_allclose(projection.directions(x, y, shape), direction, atol=1e-7)
    np.testing.assert_allclose(projection.directions(x, y, shape)[6:], direction[6:], atol=1e-12)


@pytest.mark.parametrize("name", PROJECTIONS)
@pytest.mark.parametrize("size", [1, 2, 3, 12, 31])
def test_solid_angles_are_those_of_the_directions(name: str, size: int) -> None:
    """They sum to 4 pi, and each is the integral of the density over the pixel."""
    projection = PROJECTIONS[name]
    shape = projection.shape(max(size, projection.smallest))
    area = projection.solid_angles(shape)
    assert area.sum() == pytest.approx(4 * np.pi, rel=1e-13)
    np.testing.assert_array_equal(area > 0, projection.used(shape))
    fine = 8 if size == 31 and projection.owners(shape) is None else 32  # a rim needs more
    x, y = centres((shape[0] * fine, shape[1] * fine))
    density = projection.density(x / fine, y / fine, shape).reshape(shape[0], fine, shape[1], fine).mean(axis=(1, 3))
    owners = projection.owners(shape)
    if owners is not None:  # what lies beyond the used pixels counts towards them
        density = np.bincount(owners, density.ravel(), density.size).reshape(shape)
    np.testing.assert_allclose(density, area, atol=0.02 * area.max())


@pytest.mark.parametrize("name", PROJECTIONS)
def test_the_density_is_that_of_the_directions(name: str) -> None:
    projection = PROJECTIONS[name]
    shape, step = projection.shape(40), 1e-4
    x, y = (a.ravel()[::7] + 0.13 for a in centres(shape))
    inside = projection.density(x, y, shape) > 0
    inside &= np.minimum(projection.density(x + 0.5, y, shape), projection.density(x, y + 0.5, shape)) > 0
    x, y = x[inside], y[inside]
    across, down = (
        (projection.directions(x + a, y + b, shape) - projection.directions(x - a, y - b, shape)) / (2 * step)
        for a, b in ((step, 0), (0, step))
    )
    area = np.linalg.norm(np.cross(across, down), axis=1)
    np.testing.assert_allclose(projection.density(x, y, shape), area, rtol=1e-5)


def test_the_octahedral_square_is_that_of_pbrt() -> None:
    """The exact conversion for PBRT, whose frame has z up: (x, z, y) of lightdome's."""
    x, y = centres((24, 48))
    radiance = np.exp(2 * PROJECTIONS["latlong"].directions(x, y, (24, 48))).astype(np.float32)
    ours, exact = maps.convert(radiance, to="octahedral", size=32), to_equal_area(radiance, 32)
    assert np.sqrt(np.mean((ours / exact - 1) ** 2)) < 0.01


@pytest.mark.slow
@pytest.mark.parametrize("name", PROJECTIONS)
def test_a_labelled_map_keeps_its_six_lights(name: str) -> None:
    """There and back: six lights of 6 degrees, each alone in its direction, keep flux and direction."""
    x, y = centres((64, 128))
    area = PROJECTIONS["latlong"].solid_angles((64, 128))
    direction = PROJECTIONS["latlong"].directions(x, y, (64, 128))
    there = maps.convert((direction @ AXES.T > np.cos(0.1))[..., :3].astype(np.float32), to=name)
    back = maps.convert(there, name, "latlong", 64).astype(np.float64)
    for channel in range(3):
        before = (direction @ AXES[channel] > np.cos(0.1)) * area
        after = back[..., channel] * area
        assert after.sum() == pytest.approx(before.sum(), rel=1e-6)
        mean = np.tensordot(after, direction, 2)
        assert mean / np.linalg.norm(mean) @ AXES[channel] > np.cos(0.5 * np.pi / 64)


def square(name: str, shape: tuple[int, int]) -> np.ndarray:
    return np.ones((*shape, 3), np.float32) * PROJECTIONS[name].used(shape)[..., None]


def with_rim(radiance: np.ndarray) -> np.ndarray:
    """The image with a rim, as after resizing."""
    return np.maximum(radiance, 0.1 * np.roll(radiance, 1, axis=1))


@pytest.mark.parametrize(
    ("name", "radiance", "said"),
    [
        ("latlong", np.ones((16, 32, 3)), None),
        ("latlong", np.ones((16, 33, 3)), None),
        ("latlong", np.ones((16, 16, 3)), "angular or mirror"),
        ("latlong", np.zeros((16, 16, 3)), None),
        ("angular", square("mirror", (16, 16)), "or mirror"),
        ("cube-cross", square("cube-cross", (16, 12)), "3:4"),
        ("latlong", np.ones((16, 12, 3)), "is cube-cross"),
        ("latlong", np.ones((12, 16, 3)), "is cube-cross-horizontal"),
        ("cube-cross-horizontal", square("cube-cross-horizontal", (12, 16)), "4:3"),
        ("cube-cross", with_rim(square("cube-cross", (48, 36))), "3:4"),
        ("latlong", np.zeros((12, 16, 3)), None),
        ("cube-strip", np.ones((48, 8, 3)), "1:6"),
        ("cube-strip-horizontal", np.ones((8, 48, 3)), "6:1"),
        ("latlong", np.ones((1, 6, 3)), None),
    ],
)
def test_a_projection_is_detected_by_sides_and_black_corners(name: str, radiance: np.ndarray, said: str | None) -> None:
    found, note = detected(radiance)
    assert found == name
    assert (note is None) == (said is None)
    assert said is None or (said in note and "--projection" in note)


def test_a_file_is_read_as_detected_or_as_asked(tmp_path: Path) -> None:
    direction = PROJECTIONS["angular"].directions(*centres((32, 32)), (32, 32))
    radiance = ((direction + 1) * PROJECTIONS["angular"].used((32, 32))[..., None]).astype(np.float32)
    radiance[0, 0] = np.nan  # nothing outside the disc matters
    write_image(tmp_path / "probe.pfm", radiance)
    envmap = EnvironmentMap.read(tmp_path / "probe.pfm", projection="angular")
    assert (envmap.width, envmap.height) == (44, 22)
    assert "resampled to 44 x 22" in envmap.notes[-1]
    assert envmap.peak == envmap.radiance.max()
    ours = PROJECTIONS["latlong"].directions(*centres((22, 44)), (22, 44)) + 1
    assert np.abs(envmap.radiance - ours).max() < 0.3
    radiance[0, 0] = 0
    write_image(tmp_path / "probe.pfm", radiance)
    found = EnvironmentMap.read(tmp_path / "probe.pfm")
    np.testing.assert_array_equal(found.radiance, envmap.radiance)
    assert np.array_equal(EnvironmentMap.read(tmp_path / "probe.pfm", projection="latlong").radiance, radiance)


def test_bad_pixels_of_a_probe_report_their_share_of_the_flux(tmp_path: Path) -> None:
    radiance = np.ones((16, 16, 3), np.float16)
    radiance[8, 8] = np.inf
    write_image(tmp_path / "probe.pfm", radiance.astype(np.float32))
    envmap = EnvironmentMap.read(tmp_path / "probe.pfm", sanitize="clamp", projection="angular")
    assert envmap.replaced is not None
    assert envmap.replaced.infinite == 1
    assert envmap.replaced.flux_share == pytest.approx(1)


@pytest.mark.parametrize(
    ("words", "call"),
    [
        ("unknown projection 'fisheye'", lambda: maps.convert(np.ones((4, 8, 3)), "fisheye")),
        ("unknown projection 'fisheye'", lambda: maps.convert(np.ones((4, 8, 3)), to="fisheye")),
        ("1:1 as angular", lambda: maps.convert(np.ones((4, 5, 3)), "angular")),
        ("3:4 as cube-cross", lambda: maps.convert(np.ones((17, 12, 3)), "cube-cross")),
        ("1:6 as cube-openexr", lambda: maps.convert(np.ones((6, 1, 3)), "cube-openexr")),
        ("2:1", lambda: maps.convert(np.ones((0, 0, 3)), to="mirror")),
        ("finite", lambda: maps.convert(np.full((4, 8, 3), np.inf), to="mirror")),
        (
            "size of the mirror map must be a whole number from 1",
            lambda: maps.convert(np.ones((4, 8, 3)), to="mirror", size=0),
        ),
        ("size of the cube-cross", lambda: maps.convert(np.ones((4, 8, 3)), to="cube-cross", size=30000)),
    ],
)
def test_what_cannot_be_converted_is_refused(words: str, call) -> None:
    with pytest.raises(LightdomeError, match=words):
        call()


SKYLIBS = """
import sys, warnings
warnings.simplefilter("ignore")
import numpy as np
from envmap import EnvironmentMap
for ours, theirs, size in (("angular", "angular", 64), ("mirror", "sphere", 64), ("cube-cross", "cube", 64)):
    x, y, z, valid = EnvironmentMap(size, theirs).worldCoordinates()
    np.save(f"{sys.argv[1]}/{ours}.npy", np.dstack([x, y, z, valid]))
"""


@pytest.mark.peer
def test_directions_are_those_of_skylibs(tmp_path: Path) -> None:
    python = python_with("envmap")
    if python is None:
        pytest.skip("needs the package skylibs, here or in a Python of LIGHTDOME_PEERS")
    subprocess.run([python, "-c", SKYLIBS, tmp_path], check=True, timeout=120)
    for name in ("angular", "mirror", "cube-cross"):
        theirs = np.load(tmp_path / f"{name}.npy")
        shape = theirs.shape[:2]
        used = PROJECTIONS[name].used(shape)
        np.testing.assert_array_equal(used, theirs[..., 3] > 0)
        ours = PROJECTIONS[name].directions(*centres(shape), shape)
        np.testing.assert_allclose(ours[used], theirs[used][:, :3], atol=1e-5)
