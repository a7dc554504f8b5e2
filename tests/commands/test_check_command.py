"""``lightdome check image``: exit status, text, JSON and pictures, and the files that it reads."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest
from helpers import stiff_radiance
from lightdome import console
from lightdome.checking.files import read_rendered
from lightdome.commands import check as command
from lightdome.errors import LightdomeError
from lightdome.maps.images import tone_map, write_image
from student import render

Run = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """``lightdome check image`` with arguments, in this process."""

    def run(*arguments: object) -> subprocess.CompletedProcess[str]:
        words = ["lightdome check", "image", *map(str, arguments)]
        monkeypatch.setattr(sys, "argv", words)
        capsys.readouterr()
        with pytest.raises(SystemExit) as ended:
            console.run(command.main)
        return subprocess.CompletedProcess(words, ended.value.code, *capsys.readouterr())

    return run


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A map, correct images of it in all formats, and one upside down."""
    made = tmp_path_factory.mktemp("check")
    radiance = np.minimum(stiff_radiance(16, 32), 20)
    write_image(made / "map.pfm", radiance)
    image = render(radiance, 1024, 33)
    for suffix in ("pfm", "exr"):
        write_image(made / f"right.{suffix}", image)
    for suffix in ("png", "ppm"):
        write_image(made / f"right.{suffix}", tone_map(image, 0.2))
    np.savez(made / "right.npz", image=image)
    write_image(made / "wrong.pfm", image[::-1])
    return made


@pytest.mark.slow
def test_the_exit_status_is_the_verdict(run: Run, folder: Path) -> None:
    for name in ("right.pfm", "right.exr", "right.png", "right.ppm", "right.npz"):
        result = run(folder / name, "--map", folder / "map.pfm", "--samples", 1024)
        assert result.returncode == 0, result.stdout + result.stderr
        assert result.stdout.startswith("agrees: ")
    result = run(folder / "wrong.pfm", "--map", folder / "map.pfm", "--samples", 1024)
    assert result.returncode == 1
    assert result.stdout.startswith("does not agree; upside down\n")
    result = run(folder / "right.pfm", "--map", folder / "map.pfm")
    assert result.returncode == 2
    assert result.stdout.startswith("cannot tell: ")


@pytest.mark.slow
def test_json_and_a_picture_are_written(run: Run, folder: Path, tmp_path: Path) -> None:
    arguments = ["--map", folder / "map.pfm", "--samples", 1024, "--json", "--out", tmp_path]
    result = run(folder / "wrong.pfm", *arguments)
    told = json.loads(result.stdout)
    assert told["orientation"] == "upside down"
    assert told["agrees"] is False
    assert json.loads((tmp_path / "wrong_check.json").read_text()) == told
    assert oiio.ImageInput.open(str(tmp_path / "wrong_check.png")).spec().width > 1000


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.jpg", b"", "not an image that can be checked"),
        ("no.pfm", None, "No such file"),
        ("no.png", None, "no such file"),
        ("a.png", b"P6\n1 1\n255\nabc", "does not start like a .png file"),
        ("a.png", b"\x89PNG\r\n\x1a\nnothing", "damaged"),
        ("a.ppm", b"P6\n99999 99999\n255\n", "too many|damaged"),
        ("a.npz", b"PK nothing", "damaged or not an .npz file"),
        ("a.pfm", b"PF\n2 2\n-1\n", "PF|damaged|bytes|short|holds"),
    ],
)
def test_a_file_that_cannot_be_read_is_one_line(
    run: Run, folder: Path, tmp_path: Path, name: str, content: bytes | None, words: str
) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(LightdomeError, match=words) as refused:
        read_rendered(tmp_path / name)
    assert "\n" not in str(refused.value)
    result = run(tmp_path / name, "--map", folder / "map.pfm")
    assert result.returncode == 2
    assert len(result.stderr.splitlines()) == 1


@pytest.mark.parametrize(
    "arrays", [{"picture": np.ones((4, 4, 3))}, {"image": np.ones((4, 4))}, {"image": np.array([["text"]])}]
)
def test_an_npz_file_must_hold_an_image(tmp_path: Path, arrays: dict[str, np.ndarray]) -> None:
    np.savez(tmp_path / "a.npz", **arrays)
    with pytest.raises(LightdomeError, match="image"):
        read_rendered(tmp_path / "a.npz")


def test_pictures_are_decoded_with_the_given_gamma(tmp_path: Path) -> None:
    values = np.random.default_rng(0).integers(0, 256, (5, 7, 3), np.uint8)
    write_image(tmp_path / "a.png", values)
    for gamma in (1.0, 2.4):
        pixels, linear = read_rendered(tmp_path / "a.png", gamma)
        np.testing.assert_allclose(pixels, (values / 255.0) ** gamma, atol=1e-6)
        assert not linear
