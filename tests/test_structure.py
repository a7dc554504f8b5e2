"""The folders are the path of the data: imports run one way, and every folder is shipped."""

from __future__ import annotations

import ast
import configparser
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from helpers import ROOT
from lightdome.names import COMMANDS

HOST = ROOT / "pyhost"
SUPPORT = "support"  # the host's own files
BASE = {SUPPORT, "opencl", "maps"}
MAY_IMPORT = {
    SUPPORT: {SUPPORT},
    "opencl": {SUPPORT, "opencl"},
    "maps": {SUPPORT, "maps"},
    "fresnel": {SUPPORT, "maps", "fresnel"},
    "pbrt": {SUPPORT, "maps", "pbrt"},
    "sampling": BASE | {"sampling"},
    "lighting": BASE | {"sampling", "lighting"},
    "rendering": BASE | {"sampling", "lighting", "rendering"},
    "evaluation": BASE | {"fresnel", "pbrt", "sampling", "lighting", "rendering", "evaluation"},
}
MAY_IMPORT["checking"] = MAY_IMPORT["evaluation"] | {"checking"}
MAY_IMPORT["viewer"] = MAY_IMPORT["checking"] | {"viewer"}
MAY_IMPORT["catalog"] = MAY_IMPORT["evaluation"] | {"catalog"}
MAY_IMPORT["commands"] = MAY_IMPORT["viewer"] | {"catalog", "commands"}
FOLDERS = {path.parent.name for path in HOST.glob("*/__init__.py")}
# `python -m lightdome` and `python -m lightdome.probe` are commands; the package's names are for users.
OUTSIDE = {HOST / "__init__.py", HOST / "__main__.py", HOST / "probe.py"}
MODULES = sorted(set(HOST.rglob("*.py")) - OUTSIDE)


def imports(path: Path) -> Iterator[str]:
    """The modules that a file imports, as absolute names; for our own, with the names imported from them."""
    package = ["lightdome", *path.relative_to(HOST).parts[:-1]]
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) + 1 - node.level] if node.level else []
            module = ".".join([*base, *([node.module] if node.module else [])])
            yield from (f"{module}.{alias.name}" for alias in node.names)


def folder_of(name: str) -> str:
    """The folder of one of our modules, by its absolute name."""
    second = name.split(".")[1]
    return second if second in FOLDERS else SUPPORT


def test_every_folder_has_its_rule() -> None:
    assert {SUPPORT} | FOLDERS == set(MAY_IMPORT)


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(HOST)))
def test_imports_run_one_way(path: Path) -> None:
    own = path.parent.name if path.parent != HOST else SUPPORT
    for name in imports(path):
        if name.startswith("lightdome."):
            assert folder_of(name) in MAY_IMPORT[own], name
            assert own == "evaluation" or name.split(".")[1] != "reference", "the product needs no reference"
        assert not name.startswith("pyopencl") or own == "opencl", name


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(HOST)))
def test_only_opencl_sees_buffers_and_queues(path: Path) -> None:
    if path.parent.name != "opencl":
        tree = ast.parse(path.read_text(encoding="utf-8"))
        seen = {node.attr for node in ast.walk(tree) if isinstance(node, ast.Attribute)}
        assert not seen & {"buffer", "queue", "record"}


def test_the_package_list_is_that_of_the_folders() -> None:
    config = configparser.ConfigParser()
    config.read(ROOT / "setup.cfg")
    packages = config["options"]["packages"].split()
    assert sorted(packages) == sorted(
        ["lightdome", "lightdome.clkernels", "lightdome.data", *(f"lightdome.{name}" for name in FOLDERS)]
    )


def calls(path: Path) -> list[str]:
    """The calls in a file that take one string: ``function('string')``."""
    nodes = (node for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(node, ast.Call))
    return [ast.unparse(node) for node in nodes if [type(arg) for arg in node.args] == [ast.Constant]]


def test_every_module_of_a_command_is_listed_and_scripts_run_them() -> None:
    trees = {path.stem: ast.parse(path.read_text(encoding="utf-8")) for path in (HOST / "commands").glob("[!_]*.py")}
    with_main = {name for name, tree in trees.items() if "main" in {getattr(node, "name", "") for node in tree.body}}
    modules = {command.module for command in COMMANDS.values()}
    assert with_main - {"program"} == modules
    scripts = {path.stem: path for path in (ROOT / "scripts").glob("[!_]*.py")}
    run_by = {name: [call for call in calls(path) if "command(" in call] for name, path in scripts.items()}
    run_by = {name: run for name, run in run_by.items() if run}
    assert run_by == {name: [f"_start.command('{name}')"] for name in run_by}
    assert set(run_by) <= modules
    assert len(run_by) >= 8


def test_the_folders_of_the_tests_are_those_of_the_host() -> None:
    assert {path.parent.name for path in (ROOT / "tests").glob("*/*.py")} == FOLDERS | {"tools"}


def test_no_file_of_tests_needs_another() -> None:
    """Each runs alone; what several need is in a module next to the folders."""
    paths = sorted((ROOT / "tests").rglob("test_*.py"))
    assert len(paths) > 40
    for path in paths:
        assert not re.search(r"^(from|import) test_", path.read_text(encoding="utf-8"), re.MULTILINE), path.name


def shown(path: Path) -> Iterator[str]:
    """The strings of a module that may be part of what it prints: all but docstrings."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    prose = {node.value for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    constants = (node for node in ast.walk(tree) if isinstance(node, ast.Constant) and node not in prose)
    yield from (node.value for node in constants if isinstance(node.value, str))


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(HOST)))
def test_no_message_names_what_an_installed_package_lacks(path: Path) -> None:
    own = {"scripts/"} if path.name == "cli.py" else set()  # how a script refers to itself
    for text in shown(path):
        assert text in own or not re.search(r"scripts/|\bparts? [1-4]\b|README|CONTRIBUTING|\bdocs/", text), text
        assert not re.search(r"\b(bench|stability|report|roofline|get_\w+)\.py\b", text), text
