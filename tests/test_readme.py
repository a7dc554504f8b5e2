"""What the README shows works as it is written there."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

from conftest import ROOT

README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_the_python_example_runs(tmp_path: Path) -> None:
    (code,) = re.findall(r"```python\n(.*?)```", README, re.DOTALL)
    (tmp_path / "data").symlink_to(ROOT / "data")
    assert code.count("resolution=511") == 2  # the example is as right at a tenth of the size
    code = code.replace("resolution=511", "resolution=51")
    result = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    assert float(result.stdout.split()[0]) < 0.2
    assert (tmp_path / "sphere.pfm").stat().st_size > 51 * 51 * 12


def test_files_and_folders_that_it_names_are_there() -> None:
    names = re.findall(r"`(?:\.venv/bin/python )?(scripts/[\w.]+)", README) + re.findall(
        r"\]\((?!http)([^)]+)\)", README
    )
    assert len(names) > 6
    for name in names:
        assert (ROOT / name).exists(), name
