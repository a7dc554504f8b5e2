"""The documentation is true: its commands and programs run, and its links and file names exist.

In a block tagged ``sh`` every line is a command, run from the clone's folder with ``.venv`` active and with the
arguments of ``CHEAP`` added. A line, or the first line for the whole block, may say ``# not run by the tests: `` and
why. A block tagged ``python`` is run as it is,
but for its resolution. All blocks of a page run in one folder, one after another. A command that needs nothing of those
before it, and on which none after it depends, runs once for all pages.

What the main README.md says runs in processes, as a reader runs it. Of other pages, lightdome's commands and the pages'
own programs run in this process, whose modules are loaded and whose device is open.
"""

from __future__ import annotations

import os
import re
import runpy
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from importlib.metadata import version
from pathlib import Path

import lightdome
import pytest
from helpers import LONG, ROOT, SCRIPTS, Script, module_of, open_once
from lightdome import console
from lightdome.commands.program import main as lightdome_program
from lightdome.maps.images import read_image, write_image
from lightdome.opencl import device

pytestmark = pytest.mark.slow

PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    ROOT / "data" / "README.md",
    *sorted((ROOT / "docs").rglob("*.md")),
]
PAGES += sorted(path for path in ROOT.glob("*.md") if path not in PAGES)
LANGUAGES = {"sh", "python", "math", "bibtex", "text"}
NOT_RUN = "# not run by the tests: "

# What makes a command cheap; the last of two equal options counts.
CHEAP = {
    "python tests/tools/check_table.py": "--maps 1",
    "python tests/tools/coverage_table.py": "--runs 1 --resolution 9",
    "python tests/tools/fuzz.py": "--count 5",
    "scripts/bench.py": "--methods sobol --resolution 31 --counts 16 --spp 2 --seeds 1 --repeats 1",
    "scripts/part3_shade.py": "--resolution 31",
    "scripts/part4_pbrt.py": "--spp 1 2 --resolution 31",
    "scripts/test": "--collect-only tests/sampling/test_sequences.py",
}

# test_notebooks.py runs the tutorial's programs, as notebooks.
ELSEWHERE = ".venv/bin/python docs/tutorial/"

# Commands that run only for the first page that has them: they need no files of that page.
BY_ITSELF = ("scripts/demo", "scripts/bench.py", "scripts/test", ".venv/bin/lightdome devices")

# What a page's commands need beyond the extra [test].
NEEDS = {"catalog.md": ("distributed", "pyarrow")}

# In place of scripts/setup.sh, since the machine is set up already.
SET_UP = f"""\
root=$(CDPATH='' cd -- "$(dirname -- "${{BASH_SOURCE[0]}}")/.." && pwd)
python={sys.executable!r}
set_up() {{ :; }}
"""


def blocks(text: str) -> list[tuple[str, str]]:
    """(language, content) of the fenced blocks."""
    return re.findall(r"^```(\w*)\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)


def prose(text: str) -> str:
    """The text without its fenced blocks."""
    return re.sub(r"^```.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL)


def commands(block: str) -> Iterator[str]:
    """The commands of a block that are to be run."""
    for line in block.splitlines():
        command, marked, reason = line.partition(NOT_RUN)
        assert not marked or len(reason.split()) > 1, f"no reason: {line}"
        if marked and not command:
            return
        command = command.partition("#")[0].strip()
        if command and not marked:
            yield command


@pytest.fixture
def clone(tmp_path: Path) -> Path:
    """A clone that is set up, with a small map, in which commands may write."""
    for path in ROOT.iterdir():
        if path.name not in (".git", ".venv", "out", "data", "docs", "scripts"):
            (tmp_path / path.name).symlink_to(path)
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs" / "teaching").symlink_to(ROOT / "docs" / "teaching")
    (tmp_path / ".venv").symlink_to(sys.prefix)
    (tmp_path / "data").mkdir()
    for path in (ROOT / "data").iterdir():
        if path.suffix != ".exr":
            (tmp_path / "data" / path.name).symlink_to(path)
    write_image(tmp_path / "data" / "default.exr", read_image(ROOT / "data" / "default.exr")[::8, ::8])
    shutil.copytree(ROOT / "scripts", tmp_path / "scripts")
    (tmp_path / "scripts" / "setup.sh").write_text(SET_UP)
    demo = tmp_path / "scripts" / "demo"
    demo.write_text(re.sub(r"(part[34]_\w+\.py)", r"\1 --resolution 31", demo.read_text(encoding="utf-8")))
    return tmp_path


def run_by(pages: Sequence[Path]) -> set[str]:
    """The commands that pages run."""
    texts = [path.read_text(encoding="utf-8") for path in pages]
    return {
        command for text in texts for language, block in blocks(text) if language == "sh" for command in commands(block)
    }


def has_run(command: str, page: Path) -> bool:
    """Whether an earlier page, or another test, runs a command."""
    if command.startswith(ELSEWHERE):
        return True
    return command.startswith(BY_ITSELF) and command in run_by(PAGES[: PAGES.index(page)])


def cheap(command: str) -> str:
    """A command with arguments that make it cheap."""
    return " ".join([command, *(more for name, more in CHEAP.items() if f"{command} ".startswith(f"{name} "))])


def run(clone: Path, command: str) -> None:
    """Run a command as a reader would, with cheap arguments."""
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    result = subprocess.run(
        ["bash", "-c", cheap(command)],
        cwd=clone,
        env={**os.environ, "PATH": path},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=LONG,
    )
    assert result.returncode == 0, f"{command}\n{result.stdout}{result.stderr}"


@pytest.fixture
def run_inside(clone: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[Path, str], None]:
    """Like :func:`run`; commands of lightdome's and the pages' own programs run in this process."""
    monkeypatch.chdir(clone)
    monkeypatch.setattr(device, "open_device", open_once)

    def run_inside(clone: Path, command: str) -> None:
        program, *arguments = shlex.split(re.sub(r"^(\.venv/bin/)?python (-m (?=lightdome ))?", "", cheap(command)))
        if "*" in command:  # which a shell expands
            run(clone, command)
            return
        if program in ("lightdome", ".venv/bin/lightdome"):
            main = lightdome_program
        elif program.startswith("scripts/") and program.endswith(".py"):
            main = partial(console.run, module_of(Path(program).stem).main)
        elif program == "block.py" or program.startswith("docs/"):
            main = partial(runpy.run_path, program, run_name="__main__")
        else:
            run(clone, command)
            return
        monkeypatch.setattr(sys, "argv", [program, *arguments])
        status = None
        try:
            main()
        except SystemExit as ended:
            status = ended.code
        assert not status, command

    return run_inside


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_commands_and_programs_run(page: Path, clone: Path, run_inside: Callable[[Path, str], None]) -> None:
    for needed in NEEDS.get(page.name, ()):
        pytest.importorskip(needed, reason="needs the extra [cluster]")
    run_it = run if page == ROOT / "README.md" else run_inside
    for language, block in blocks(page.read_text(encoding="utf-8")):
        assert language in LANGUAGES, f"a block tagged {language!r}"
        if language == "sh":
            for command in commands(block):
                if not has_run(command, page):
                    run_it(clone, command)
        elif language == "python":
            (clone / "block.py").write_text(re.sub(r"resolution=\d+", "resolution=51", block))
            run_it(clone, "python block.py")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_no_command_hides_outside_of_a_block(page: Path) -> None:
    program = r"(?:(?:scripts|tests|\.venv/bin)/[^\s`]+|python3?|pip|git|apt-get|pytest|ruff)"
    text = prose(page.read_text(encoding="utf-8"))
    assert not re.findall(rf"^ {{4,}}{program} .*", text, re.MULTILINE)
    assert not re.findall(rf"`{program} [^`]+`", text)


def anchors(page: Path) -> set[str]:
    """The anchors of a page's headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.*)$", prose(page.read_text(encoding="utf-8")), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_and_images_resolve(page: Path) -> None:
    for target in re.findall(r"\]\(([^)]+)\)", prose(page.read_text(encoding="utf-8"))):
        if re.match(r"https?:", target):
            continue
        name, _, anchor = target.partition("#")
        path = (page.parent / name).resolve() if name else page
        assert path.exists(), target
        assert not anchor or anchor in anchors(path), target


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_files_that_are_named_exist(page: Path) -> None:
    ours = {
        path.name
        for folder in ("clkernels", "pyhost", "scripts", "tests", "docs", "data")
        for path in (ROOT / folder).rglob("*")
    } | {"setup.py"}
    for name in re.findall(r"`(?:\w+/)*(\w+\.(?:py|cl|clh|sh))`", page.read_text(encoding="utf-8")):
        assert name in ours, name


def test_every_lesson_of_the_tutorial_is_run_and_listed() -> None:
    tutorial = ROOT / "docs" / "tutorial"
    text = (tutorial / "README.md").read_text(encoding="utf-8")
    lessons = sorted(path.name for path in tutorial.glob("*.py"))
    run_there = [command for language, block in blocks(text) if language == "sh" for command in commands(block)]
    assert run_there == [f".venv/bin/python docs/tutorial/{name}" for name in lessons]
    assert re.findall(r"^\d\. \[(.*?)\]", text, re.MULTILINE) == lessons


EXAMPLE = re.compile(r"^example: (.*)$", re.MULTILINE)


@pytest.mark.parametrize("name", SCRIPTS)
def test_help_says_the_defaults_and_has_an_example(
    name: str, run_here: Script, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "1000")
    result = run_here(name, "--help")
    assert result.returncode == 0, result.stderr
    text = re.sub(r"\n {10,}", "   ", result.stdout)  # the help of a long option is on the next line
    described = re.findall(r"^  (--\S+(?: \S+)*)(?: {2,}(.*))?$", text, re.MULTILINE)
    assert described
    for option, meaning in described:
        assert meaning, option
        assert " " not in option or "default: " in meaning, option
    (example,) = EXAMPLE.findall(result.stdout)
    assert example.startswith(f"scripts/{name}.py ")


def test_examples_in_the_help_run(
    clone: Path,
    run_inside: Callable[[Path, str], None],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv("COLUMNS", "1000")
    for name in ("part1_fresnel", "part2_sample", "part3_shade", "part4_pbrt", "bench"):  # others have their own tests
        capsys.readouterr()
        run_inside(clone, f"scripts/{name}.py --help")
        (example,) = EXAMPLE.findall(capsys.readouterr().out)
        if example not in run_by(PAGES):
            run_inside(clone, example)


def test_the_version_is_written_once() -> None:
    assert version("lightdome") == lightdome.__version__
    written = [*PAGES, *(ROOT / name for name in ("setup.cfg", "setup.py", "pyproject.toml", "CITATION.cff"))]
    written = [path for path in written if lightdome.__version__ in path.read_text(encoding="utf-8")]
    assert written == [ROOT / "CHANGELOG.md"]  # it lists the changes
    assert f"\n## {lightdome.__version__} - " in written[0].read_text(encoding="utf-8")
