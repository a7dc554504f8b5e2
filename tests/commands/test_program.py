"""``python -m lightdome``, as the console program, runs a command without its script, from any folder."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from helpers import LONG, ROOT, fails_in_one_line
from lightdome.names import COMMANDS, ESTIMATORS

pytestmark = pytest.mark.slow


def run(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "lightdome", *arguments]
    wide = {**os.environ, "COLUMNS": "1000"}
    return subprocess.run(command, capture_output=True, text=True, timeout=LONG, cwd=folder, env=wide)


@pytest.mark.parametrize(
    ("arguments", "message"), [((), "required: COMMAND"), (("nope",), "'nope'"), (("settings",), "'settings'")]
)
def test_an_unknown_command_is_refused(tmp_path: Path, arguments: tuple[str, ...], message: str) -> None:
    result = run(tmp_path, *arguments)
    assert result.returncode == 2
    assert "Traceback" not in result.stderr
    assert message in result.stderr


def test_help_names_every_command(tmp_path: Path) -> None:
    result = run(tmp_path, "--help")
    assert result.returncode == 0
    for name, command in COMMANDS.items():
        assert f"{name:<10} {command.purpose}" in result.stdout


def test_the_default_map_is_that_of_the_clone(tmp_path: Path) -> None:
    """Wherever the program runs."""
    folder = tmp_path / "here"
    for other in (folder, tmp_path / "data"):
        other.mkdir()
    (tmp_path / "data" / "default.exr").touch()
    result = run(folder, "sample", "--help")
    (line,) = (line for line in result.stdout.splitlines() if line.lstrip().startswith("--map "))
    assert f"(default: {ROOT / 'data'}{os.sep}" in line


def test_a_mistake_is_reported_as_by_the_script(tmp_path: Path) -> None:
    result = run(tmp_path, "shade", "nothing.npz")
    fails_in_one_line(result, "nothing.npz")
    assert result.stderr.startswith("lightdome shade: ")


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("lightdome sa", {"sample"}),
        ("lightdome sample", {"sample"}),
        ("lightdome sample --out sample --sam", {"--samples-only"}),
        ("lightdome sample --seq", {"--sequence"}),
        ("lightdome sample --sequence s", {"stratified", "sobol"}),
        ("lightdome render --estimator ", set(ESTIMATORS)),
    ],
)
def test_a_shell_can_complete_a_command_line(tmp_path: Path, line: str, expected: set[str]) -> None:
    pytest.importorskip("argcomplete", reason="needs argcomplete, of the extra [completion]")
    answer = tmp_path / "answer"
    asked = {"COMP_LINE": line, "COMP_POINT": str(len(line)), "_ARGCOMPLETE": "1", "_ARGCOMPLETE_IFS": " "}
    environment = {**os.environ, **asked, "_ARGCOMPLETE_STDOUT_FILENAME": str(answer)}
    subprocess.run([sys.executable, "-m", "lightdome"], timeout=LONG, cwd=tmp_path, env=environment, check=True)
    assert set(answer.read_text().split()) == expected
