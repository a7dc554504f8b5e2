"""``lightdome check`` for samples, densities, lights and curves, and for a folder of all of them."""

from __future__ import annotations

import csv
import html.parser
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from helpers import stiff_radiance
from lightdome import console
from lightdome.commands import check as command
from lightdome.lighting.light_files import write_csv
from lightdome.lighting.median_cut import median_cut
from lightdome.lighting.shade import shade_samples
from lightdome.maps.envmap import EnvironmentMap
from lightdome.maps.images import write_image
from lightdome.opencl.device import Device
from lightdome.sampling.distribution import build_distribution
from student_fresnel import curves

Run = Callable[..., subprocess.CompletedProcess[str]]
STRANGE = "a <b>&'\" file"


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """``lightdome check`` with arguments, in this process."""

    def run(*arguments: object) -> subprocess.CompletedProcess[str]:
        words = ["lightdome check", *map(str, arguments)]
        monkeypatch.setattr(sys, "argv", words)
        capsys.readouterr()
        with pytest.raises(SystemExit) as ended:
            console.run(command.main)
        return subprocess.CompletedProcess(words, ended.value.code, *capsys.readouterr())

    return run


@pytest.fixture(scope="module")
def folder(device: Device, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A map, and a folder of a class's hand-ins, among them some files that cannot be checked."""
    made = tmp_path_factory.mktemp("check")
    radiance = np.minimum(stiff_radiance(16, 32), 20)
    write_image(made / "map.pfm", radiance)
    distribution = build_distribution(device, EnvironmentMap(radiance))
    hand_ins = made / "class"
    (hand_ins / STRANGE).mkdir(parents=True)
    samples = distribution.sample(1024, 1)
    samples.save(hand_ins / STRANGE / "samples.npz")
    image = shade_samples(device, samples, resolution=63)
    write_image(hand_ins / STRANGE / "sphere_1024.pfm", image)
    write_image(hand_ins / "turned_1024.pfm", image[::-1])
    write_csv(hand_ins / "lights.csv", median_cut(distribution, 64))
    np.savez(hand_ins / "pdf.npz", pdf=distribution.probability_image())
    degrees = np.arange(91)
    of_curve = curves(degrees, 1.5, False, "p and s swapped")
    table = np.stack([degrees, of_curve["p"], of_curve["s"]], axis=1)
    np.savetxt(hand_ins / "curve.csv", table, delimiter=",", header="angle_degrees,p,s", comments="")
    (hand_ins / "broken.exr").write_bytes(b"nothing")
    write_image(hand_ins / "tiny_4.pfm", image[:8, :8])
    (hand_ins / ".cache").mkdir()
    (hand_ins / ".cache" / "copy.csv").write_text("hidden")
    (hand_ins / "notes.txt").write_text("not a hand-in")
    return made


@pytest.mark.parametrize(
    ("kind", "name", "options", "status", "verdict"),
    [
        ("samples", f"{STRANGE}/samples.npz", (), 0, "agrees: radiance, probability, pixel of all 1024 samples"),
        ("samples", f"{STRANGE}/samples.npz", ("--mirror",), 1, "does not agree; mirrored"),
        ("pdf", "pdf.npz", (), 0, "agrees: probabilities of pixels"),
        ("pdf", "pdf.npz", ("--per", "steradian"), 1, "does not agree; solid angle missing"),
        ("lights", "lights.csv", (), 0, "agrees: "),
        ("lights", "lights.csv", ("--flip",), 1, "does not agree; upside down"),
        ("fresnel", "curve.csv", ("--eta", 1.5), 1, "does not agree; p and s swapped"),
        ("fresnel", "curve.csv", ("--eta", 1.5, "--leaving"), 1, "does not agree"),
        ("samples", "broken.exr", (), 2, ""),
        ("lights", "curve.csv", (), 2, ""),
    ],
)
def test_each_kind(
    run: Run, folder: Path, kind: str, name: str, options: tuple[object, ...], status: int, verdict: str
) -> None:
    of_map = [] if kind == "fresnel" else ["--map", folder / "map.pfm"]
    result = run(kind, folder / "class" / name, *of_map, *options)
    assert result.returncode == status, result.stdout + result.stderr
    assert result.stdout.startswith(verdict)
    if status == 2:
        assert len(result.stderr.splitlines()) == 1


class Page(html.parser.HTMLParser):
    """The tags and the text of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.text += data


@pytest.mark.slow
def test_a_folder_becomes_a_table_and_a_page(run: Run, folder: Path, tmp_path: Path) -> None:
    result = run("folder", folder / "class", "--map", folder / "map.pfm", "--eta", 1.5, "--out", tmp_path, "--json")
    assert result.returncode == 1
    with (tmp_path / "class_check.csv").open(newline="", encoding="utf-8") as file:
        rows = {row["file"]: row for row in csv.DictReader(file)}
    assert {name: (row["kind"], row["agrees"]) for name, row in rows.items()} == {
        f"{STRANGE}/samples.npz": ("samples", "yes"),
        f"{STRANGE}/sphere_1024.pfm": ("image", "yes"),
        "turned_1024.pfm": ("image", "no"),
        "lights.csv": ("lights", "yes"),
        "pdf.npz": ("densities", "yes"),
        "curve.csv": ("reflectances", "no"),
        "broken.exr": ("unreadable", "cannot tell"),
        "tiny_4.pfm": ("unreadable", "cannot tell"),
    }
    assert rows["turned_1024.pfm"]["orientation"].startswith("upside down")
    assert rows["curve.csv"]["cause"] == "p and s swapped"
    assert len(json.loads(result.stdout)["files"]) == 8

    page = Page((tmp_path / "class_check.html").read_text(encoding="utf-8"))
    for name in rows:
        assert name in page.text
    assert {tag for tag, _ in page.tags}.isdisjoint({"script", "link", "b", "iframe"})
    pictures = [attributes["src"] or "" for tag, attributes in page.tags if tag == "img"]
    assert len(pictures) == 2 * 3 + 4
    assert all(source.startswith(("data:image/png;base64,", "data:image/svg+xml;base64,")) for source in pictures)
    assert "http" not in page.text


def test_a_folder_needs_files_and_an_output_folder(run: Run, folder: Path, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    for arguments, words in (
        ((folder / "class",), "give --out"),
        ((tmp_path / "empty", "--out", tmp_path), "no file that can be checked"),
        ((tmp_path / "none", "--out", tmp_path), "no such folder"),
    ):
        result = run("folder", *arguments, "--map", folder / "map.pfm")
        assert result.returncode == 2
        assert words in result.stderr
