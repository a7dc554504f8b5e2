"""The default map is Grace if it was fetched, else the one that comes with lightdome, for every script."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from helpers import LONG, ROOT


@pytest.mark.slow
@pytest.mark.parametrize("name", ["part2_sample", "part4_pbrt", "bench", "report"])
def test_the_default_map_is_grace_if_it_was_fetched(name: str, tmp_path: Path) -> None:
    data, scripts = tmp_path / "data", tmp_path / "scripts"
    shutil.copytree(ROOT / "scripts", scripts, ignore=shutil.ignore_patterns("__pycache__"))
    data.mkdir()
    for map_name in ("default.exr", "grace_latlong.exr"):
        (data / map_name).touch()
        command = [sys.executable, str(scripts / f"{name}.py"), "--help"]
        wide = {**os.environ, "COLUMNS": "1000"}
        result = subprocess.run(command, capture_output=True, text=True, timeout=LONG, env=wide, check=True)
        (line,) = (line for line in result.stdout.splitlines() if line.lstrip().startswith("--map "))
        assert line.endswith(f"(default: {data / map_name})")
