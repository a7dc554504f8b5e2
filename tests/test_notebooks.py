"""The notebooks are the tutorial's programs, with their output; they run from any folder."""

from __future__ import annotations

import json
import re
import runpy
from base64 import b64decode
from pathlib import Path

import pytest
from helpers import ROOT

pytestmark = pytest.mark.slow

LESSONS = sorted(path.stem for path in (ROOT / "docs" / "tutorial").glob("*.py"))


def kept(name: str) -> list[dict]:
    """The cells of the notebook in docs/."""
    return json.loads((ROOT / "docs" / "notebooks" / f"{name}.ipynb").read_text(encoding="utf-8"))["cells"]


@pytest.mark.parametrize("name", LESSONS)
def test_a_notebook_is_its_program_and_runs(name: str, tmp_path: Path) -> None:
    for module in ("nbformat", "nbclient", "ipykernel"):
        pytest.importorskip(module, reason="needs the extra [test]")
    tools = runpy.run_path(str(ROOT / "docs" / "notebooks.py"))
    made = tools["notebook"](ROOT / "docs" / "tutorial" / f"{name}.py")
    assert [cell.source for cell in made.cells] == ["".join(cell["source"]) for cell in kept(name)]
    for cell in made.cells:
        cell.source = re.sub("^SIZE = .*", "SIZE = 31", cell.source, flags=re.MULTILINE)
    tools["run"](made, tmp_path)
    assert any((tmp_path / "out" / "tutorial").glob("*.png"))


@pytest.mark.parametrize("name", LESSONS)
def test_a_notebook_keeps_its_output_small_and_without_paths(name: str) -> None:
    outputs = [output for cell in kept(name) for output in cell.get("outputs", ())]
    assert {output["output_type"] for output in outputs} == {"stream", "execute_result"}
    assert {output["name"] for output in outputs if output["output_type"] == "stream"} == {"stdout"}
    assert not re.findall(r"/(?:home|root|tmp|work|Users)/", json.dumps(outputs))
    pictures = [output["data"]["image/png"] for output in outputs if "data" in output]
    assert pictures
    assert all(len(b64decode(picture)) < 100_000 for picture in pictures)
