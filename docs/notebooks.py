#!/usr/bin/env python3
"""Build the tutorial's programs as notebooks, run them and keep their output: docs/notebooks.py [FOLDER].

The default is docs/notebooks. Each paragraph of a program becomes a cell, and its comment the text above. Pictures that
the program writes are shown.
"""

from __future__ import annotations

import re
import sys
import tempfile
import textwrap
from pathlib import Path

import nbformat
from nbclient import NotebookClient

HERE = Path(__file__).parent
LESSONS = sorted((HERE / "tutorial").glob("*.py"))


def notebook(lesson: Path) -> nbformat.NotebookNode:
    """The notebook of a program, before it has run."""
    title, body = re.fullmatch(r'#!.*?\n"""(.*?) Usage: .*?"""\n+(.*)', lesson.read_text("utf-8"), re.DOTALL).groups()
    body = re.sub(r"import sys\n", "", body)
    body = re.sub(
        r"try:\n(.*?)except ImportError:\n.*?\n", lambda found: textwrap.dedent(found[1]), body, flags=re.DOTALL
    )
    body = re.sub(r"path = .*", "path = lightdome.default_map()  # or your own file", body)
    body = re.sub(
        r'(lightdome\.write_image\(out / "\w+\.png", picture\)(?:\n\w.*)*)', r"\1\nlightdome.show(picture)", body
    )
    cells = [nbformat.v4.new_markdown_cell(f"# {title}")]
    for paragraph in re.split(r"\n{2,}(?=\S)(?!import|SIZE|path)", body.strip()):
        comment, code = re.fullmatch(r"((?:# [^\n]*\n)*)(.*)", paragraph, re.DOTALL).groups()
        if comment:
            cells.append(nbformat.v4.new_markdown_cell(re.sub(r"(?m)^# ", "", comment).strip()))
        cells.append(nbformat.v4.new_code_cell(code))
    for number, cell in enumerate(cells):
        cell["id"] = f"cell-{number}"
    kernel = {"name": "python3", "display_name": "Python 3", "language": "python"}
    return nbformat.v4.new_notebook(cells=cells, metadata={"kernelspec": kernel})


def run(made: nbformat.NotebookNode, folder: Path) -> None:
    """Run a notebook in a folder, and keep its output in the notebook."""
    metadata = made.metadata
    NotebookClient(
        made,
        timeout=600,
        record_timing=False,
        coalesce_streams=True,
        resources={"metadata": {"path": str(folder)}},
    ).execute()
    for cell in made.cells:
        if cell.cell_type == "code":  # without progress messages
            cell.outputs = [output for output in cell.outputs if output.get("name") != "stderr"]
    made.metadata = {"kernelspec": metadata["kernelspec"]}  # without the version of Python


if __name__ == "__main__":
    target = Path(sys.argv[1]) if len(sys.argv) > 1 else HERE / "notebooks"
    target.mkdir(parents=True, exist_ok=True)
    for lesson in LESSONS:
        made = notebook(lesson)
        with tempfile.TemporaryDirectory() as folder:
            run(made, Path(folder))
        nbformat.write(made, target / f"{lesson.stem}.ipynb")
        print(f"wrote {target / lesson.stem}.ipynb")
