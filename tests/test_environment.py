"""Unusual environments: matplotlib backends and settings, and file names that no encoding covers."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from helpers import LONG, Script, fails_in_one_line, stiff_radiance
from lightdome.errors import exactly, shown
from lightdome.maps.images import write_image

pytestmark = pytest.mark.slow

JUPYTER = "module://matplotlib_inline.backend_inline"
ODD = os.fsdecode(b"od\xff d\xc3\xa9j\xc3\xa0")  # not UTF-8, like a folder from an old system


def python(program: str, folder: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        cwd=folder,
        timeout=LONG,
        env={**os.environ, **environment},
    )


def test_plots_do_not_depend_on_a_backend(script: Script, tmp_path: Path) -> None:
    result = script("part1_fresnel", "--out", tmp_path, MPLBACKEND="nonsense")
    assert result.returncode == 0, result.stderr
    assert result.stderr == ""


def test_modules_that_plot_load_without_the_backend_that_is_asked_for(tmp_path: Path) -> None:
    names = ("stability_plot", "roofline_plot", "report_figures", "benchmark_plot")
    modules = ("lightdome.fresnel.plot", *(f"lightdome.evaluation.{name}" for name in names))
    program = f"import importlib, os\nfor m in {modules}: importlib.import_module(m)\nprint(os.environ['MPLBACKEND'])"
    result = python(program, tmp_path, MPLBACKEND=JUPYTER)
    assert result.returncode == 0, result.stderr
    assert result.stdout.strip() == JUPYTER  # kept for those who have that backend


def test_a_user_s_matplotlib_keeps_the_backend_that_he_asks_for(tmp_path: Path) -> None:
    program = "import lightdome.fresnel.plot, matplotlib; print(matplotlib.get_backend())"
    assert python(program, tmp_path, MPLBACKEND="svg").stdout.strip() == "svg"


def test_a_user_s_settings_of_matplotlib_do_not_change_a_plot(tmp_path: Path) -> None:
    program = (
        "from lightdome.evaluation.benchmark import MethodMeasurement\n"
        "from lightdome.evaluation.benchmark_plot import error_against_time\n"
        "from lightdome.plotting import save_figure\n"
        "from pathlib import Path\n"
        "points = [MethodMeasurement('sobol', 'shared', n, 1, 1 / n, 0, 0, 0, n / 1e3, 0, 0) for n in (4, 16)]\n"
        "save_figure(error_against_time(points, 'a $name$ with \\\\frac, 日, \\udcff'), Path('plot.png'))\n"
    )
    pictures = []
    for settings in (
        "",
        "text.usetex: True\nsavefig.format: none\nfont.size: 30\nno such key: 1\nlines.linewidth: x\n",
    ):
        (tmp_path / "matplotlibrc").write_text(settings)
        result = python(program, tmp_path)
        assert result.returncode == 0, result.stderr
        assert result.stderr == ""
        pictures.append((tmp_path / "plot.png").read_bytes())
    assert pictures[0] == pictures[1]


def test_settings_of_matplotlib_that_cannot_be_read_give_one_line(script: Script, tmp_path: Path) -> None:
    (tmp_path / "matplotlibrc").write_bytes(b"font.size: \xff\xfe\n")
    result = script("part1_fresnel", "--out", tmp_path / "out", MATPLOTLIBRC=str(tmp_path / "matplotlibrc"))
    fails_in_one_line(result, "matplotlibrc")


def test_a_folder_for_matplotlib_that_cannot_be_made_does_not_matter(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    result = python("import lightdome.plotting", tmp_path, MPLCONFIGDIR=str(tmp_path / "file" / "below"))
    assert result.returncode == 0, result.stderr
    assert result.stderr == ""


def test_names_that_standard_output_cannot_encode_are_escaped(script: Script, tmp_path: Path) -> None:
    folder = tmp_path / "日本 é"
    folder.mkdir()
    write_image(folder / "map.pfm", stiff_radiance(8, 16))
    options = ("--map", folder / "map.pfm", "--counts", 4, "--out", folder / "out")
    result = script("part2_sample", *options, PYTHONIOENCODING="ascii")
    assert result.returncode == 0, result.stderr
    assert r"\u65e5\u672c \xe9" in result.stdout
    assert (folder / "out" / "em_4.png").exists()


def test_a_locale_without_utf_8_opens_names_in_utf_8(script: Script, tmp_path: Path) -> None:
    folder = tmp_path / "é"
    folder.mkdir()
    write_image(folder / "map.exr", stiff_radiance(8, 16))
    c_locale = {"LC_ALL": "C", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0"}
    options = ("--map", folder / "map.exr", "--counts", 4, "--out", folder / "out")
    assert script("part2_sample", *options, **c_locale).returncode == 0
    options = (folder / "out" / "samples_4.npz", "--resolution", 9, "--out", folder / "three")
    assert script("part3_shade", *options, **c_locale).returncode == 0


def test_a_map_whose_name_the_library_cannot_open_gives_one_line(script: Script, tmp_path: Path) -> None:
    path = tmp_path / f"{ODD}.exr"
    write_image(tmp_path / "map.exr", stiff_radiance(8, 16))
    (tmp_path / "map.exr").rename(path)
    for name in ("part2_sample", "part4_pbrt"):
        result = script(name, "--map", path, "--out", tmp_path / "out")
        fails_in_one_line(result, "UTF-8", r"od\udcff")
        assert not [file for file in (tmp_path / "out").rglob("*") if file.is_file()]


def test_a_folder_in_which_the_library_cannot_write_is_refused_before_anything_is_written(
    script: Script, tmp_path: Path
) -> None:
    write_image(tmp_path / "map.pfm", stiff_radiance(8, 16))
    on_map = ("--map", tmp_path / "map.pfm")
    assert script("part2_sample", *on_map, "--counts", 4, "--samples-only", "--out", tmp_path / ODD).returncode == 0
    samples = tmp_path / ODD / "samples_4.npz"
    out = tmp_path / f"other {ODD}"
    for arguments in (
        ("part2_sample", *on_map),
        ("part3_shade", samples),
        ("part4_pbrt", *on_map),
        ("report", *on_map),
    ):
        fails_in_one_line(script(*arguments, "--out", out), "UTF-8", r"od\udcff")
        assert not out.exists()
    fails_in_one_line(script("make_default_map", "--out", tmp_path / f"{ODD}.exr"), "UTF-8", r"od\udcff")


def test_names_that_are_no_utf_8_serve_where_no_image_is_written(script: Script, tmp_path: Path) -> None:
    result = script("part1_fresnel", "--out", tmp_path / ODD)
    assert result.returncode == 0, result.stderr
    assert r"od\udcff" in result.stdout
    assert json.loads((tmp_path / ODD / "settings.json").read_text())["options"]["out"] == str(tmp_path / ODD)
    write_image(tmp_path / "map.pfm", stiff_radiance(8, 16))
    options = ("--map", tmp_path / "map.pfm", "--counts", 4, "--samples-only")
    assert script("part2_sample", *options, "--out", tmp_path / ODD).returncode == 0
    samples = tmp_path / ODD / "samples_4.npz"
    assert script("part3_shade", samples, "--resolution", 9, "--out", tmp_path / "three").returncode == 0


def test_what_is_no_character_is_escaped() -> None:
    assert shown("a b/é\n\x1b[2J\udcff") == r"a b/é\n\x1b[2J\udcff"


@pytest.mark.parametrize(("value", "text"), [(1.4, "1.4"), (2.0, "2"), (1e308, "1e+308"), (1 + 1e-10, "1.0000000001")])
def test_a_given_number_hides_no_digit(value: float, text: str) -> None:
    assert exactly(value) == text
    assert float(exactly(value)) == value
