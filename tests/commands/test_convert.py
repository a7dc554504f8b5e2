"""``lightdome convert`` writes a map in another projection, and says in one line which projection it detected."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from helpers import stiff_radiance
from lightdome.commands.convert import main
from lightdome.errors import LightdomeError
from lightdome.maps import convert
from lightdome.maps.envmap import EnvironmentMap
from lightdome.maps.images import ImageRows, read_image, write_image

MAP = stiff_radiance(16, 32)


def run(patch: pytest.MonkeyPatch, *arguments: object) -> None:
    patch.setattr(sys, "argv", ["lightdome convert", *map(str, arguments)])
    main()


@pytest.fixture
def path(tmp_path: Path) -> Path:
    write_image(tmp_path / "map.pfm", MAP)
    return tmp_path / "map.pfm"


@pytest.mark.parametrize("suffix", ["exr", "pfm"])
def test_the_command_writes_what_convert_returns(
    path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = path.with_name(f"out.{suffix}")
    run(monkeypatch, path, out, "--to", "cube-cross", "--size", 5)
    np.testing.assert_array_equal(read_image(out), convert(MAP, to="cube-cross", size=5))
    said = capsys.readouterr()
    assert not said.err
    assert "32 x 16, latlong" in said.out
    assert "15 x 20, cube-cross" in said.out


def test_only_openexr_s_own_cube_says_so_in_its_header(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = path.with_name("out.exr")
    for to in ("latlong", "cube-strip", "cube-openexr"):
        run(monkeypatch, path, out, "--to", to)
        assert ImageRows(out).is_cube == (to == "cube-openexr")
        assert (b"envmap\0envmap\0" in out.read_bytes()) == (to == "cube-openexr")


def test_the_detected_projection_is_reported_and_can_be_overridden(
    path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    probe, out = path.with_name("probe.exr"), path.with_name("out.pfm")
    run(monkeypatch, path, probe, "--to", "mirror", "--size", 24)
    capsys.readouterr()
    run(monkeypatch, probe, out, "--to", "latlong")
    said = capsys.readouterr()
    assert "taken as angular (or mirror)" in said.err
    assert "24 x 24, angular" in said.out
    run(monkeypatch, probe, out, "--to", "latlong", "--projection", "mirror")
    assert not capsys.readouterr().err
    np.testing.assert_array_equal(read_image(out), convert(read_image(probe), "mirror", "latlong"))


@pytest.mark.parametrize("size", [None, 16])
def test_a_map_is_written_for_another_program(path: Path, size: int | None, monkeypatch: pytest.MonkeyPatch) -> None:
    out = path.with_name("out.pfm")
    turn = ("--convention", "skylibs", "--mirror", "--rotate", "45", "--to-convention", "mitsuba")
    run(monkeypatch, path, out, "--to", "latlong", *turn, *(["--size", size] if size else []))
    envmap = EnvironmentMap(MAP).to_convention("lightdome", from_="skylibs").mirrored().rotated(45)
    expected = envmap.to_convention("mitsuba").radiance
    np.testing.assert_allclose(
        read_image(out), expected, rtol=1e-5 if size else 0, atol=1e-5 * MAP.max() if size else 0
    )
    with pytest.raises(SystemExit):
        run(monkeypatch, path, out, "--to", "angular", "--to-convention", "pbrt")


@pytest.mark.parametrize(
    ("words", "more"),
    [
        ("2:1|1:1", ("--to", "latlong", "--projection", "angular")),
        ("3:4", ("--to", "latlong", "--projection", "cube-cross")),
        ("size of the cube-strip map", ("--to", "cube-strip", "--size", 100000)),
    ],
)
def test_an_impossible_conversion_is_refused_and_nothing_is_written(
    path: Path, words: str, more: tuple[object, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    out = path.with_name("out.exr")
    with pytest.raises(LightdomeError, match=words):
        run(monkeypatch, path, out, *more)
    assert not out.exists()


def test_a_file_that_cannot_be_written_is_refused_before_the_map_is_read(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path.unlink()
    with pytest.raises(LightdomeError, match=r"\.pfm or \.exr"):
        run(monkeypatch, path, path.with_name("out.hdr"), "--to", "latlong")
    with pytest.raises(LightdomeError, match="no folder"):
        run(monkeypatch, path, path.parent / "nowhere" / "out.pfm", "--to", "latlong")
    with pytest.raises(LightdomeError, match=r"only an \.exr file can say in its header"):
        run(monkeypatch, path, path.with_name("out.pfm"), "--to", "cube-openexr")


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (("--rotate", 90), ()),
        (("--rotate=90",), ()),
        (("--to", "latlong", "--rotate", -270.0, 0, "-0"), ()),
        ((), ("--rotate", 90)),
    ],
)
def test_a_map_may_follow_the_angles(
    path: Path, before: tuple[object, ...], after: tuple[object, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    out = path.with_name("out.pfm")
    run(monkeypatch, *before, path, out, "--to", "latlong", *after)
    np.testing.assert_array_equal(read_image(out), np.roll(MAP, -8, axis=1))


def test_a_bad_pixel_is_refused_or_replaced(
    path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    bad = MAP.copy()
    bad[3, 4] = np.nan
    write_image(path, bad)
    with pytest.raises(LightdomeError, match="1 NaN"):
        run(monkeypatch, path, path.with_name("out.pfm"), "--to", "octahedral")
    run(monkeypatch, path, path.with_name("out.pfm"), "--to", "octahedral", "--sanitize")
    assert "1 bad pixel was replaced" in capsys.readouterr().err
