"""Maps that programs write and readers get wrong: each gives the right values, or is refused for the right reason."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from helpers import CHROMA_IS_HIDDEN
from lightdome.errors import LightdomeError
from lightdome.maps.envmap import EnvironmentMap
from lightdome.maps.images import ImageRows, read_image
from lightdome.maps.projections import PROJECTIONS

FOLDER = Path(__file__).parent / "field_cases"
READ = sorted(path.stem for path in FOLDER.glob("*.npy") if "chroma" not in path.stem)
REFUSED = {
    "exr_names_xyz.exr": "no R, G and B, and no Y.*X, Y, Z",
    "exr_R_and_G_only.exr": "no R, G and B, and no Y.*R, G",
    "exr_half_infinite_sun.exr": "1 infinite",
    "hdr_xyze.hdr": "XYZ.*ra_xyze",
    "pfm_scale_zero.pfm": "bad scale 0",
}


def test_every_case_is_held() -> None:
    maps = {path.name for path in FOLDER.iterdir() if path.suffix in (".exr", ".hdr", ".pfm")}
    assert maps == {*READ, *REFUSED, "exr_luminance_chroma_full.exr", "exr_envmap_attr_cube.exr"}


@pytest.mark.parametrize("name", READ)
def test_a_sound_file_gives_its_radiance(name: str) -> None:
    np.testing.assert_array_equal(read_image(FOLDER / name), np.load(FOLDER / f"{name}.npy"))


@pytest.mark.parametrize("name", REFUSED)
def test_an_ambiguous_file_is_refused_by_name(name: str) -> None:
    with pytest.raises(LightdomeError, match=REFUSED[name]):
        EnvironmentMap.read(FOLDER / name)


def test_luminance_and_chroma_are_converted_or_refused_by_that_name() -> None:
    path = FOLDER / "exr_luminance_chroma_full.exr"
    if CHROMA_IS_HIDDEN:
        with pytest.raises(LightdomeError, match="luminance-chroma"):
            read_image(path)
    else:  # the chroma is half floats
        np.testing.assert_allclose(read_image(path), np.load(f"{path}.npy"), rtol=2e-3, atol=0.01)


def test_a_cube_map_becomes_latitude_and_longitude_with_its_flux() -> None:
    path = FOLDER / "exr_envmap_attr_cube.exr"
    envmap = EnvironmentMap.read(path)
    cube, latlong = (PROJECTIONS[name].solid_angles for name in ("cube-openexr", "latlong"))
    flux = np.tensordot(cube((24, 4)), read_image(path).astype(np.float64), 2)
    np.testing.assert_allclose(np.tensordot(latlong((8, 16)), envmap.radiance.astype(np.float64), 2), flux, rtol=1e-6)
    assert "envmap = cube" in envmap.notes[0]
    rows = ImageRows(path)
    with pytest.raises(LightdomeError, match="row by row"):
        rows.read(np.arange(2))


def test_infinities_are_read_as_they_are() -> None:
    image = read_image(FOLDER / "exr_half_infinite_sun.exr")
    assert np.isinf(image).all(axis=2).sum() == 1


def test_what_a_header_does_to_the_radiance_is_reported() -> None:
    for notes in (
        ImageRows(FOLDER / "hdr_exposure_2.hdr").notes,
        EnvironmentMap.read(FOLDER / "hdr_exposure_2.hdr").notes,
    ):
        assert len(notes) == 1
        assert "divided by 2" in notes[0]
        assert "EXPOSURE=2.0" in notes[0]
