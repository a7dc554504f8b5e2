"""The install is found from everywhere, by scripts too, and works in the bare environment of cron or systemd."""

from __future__ import annotations

import ast
import os
import pwd
import runpy
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import lightdome
import pytest
from helpers import LONG, ROOT, SCRIPTS, fails_in_one_line, script_path
from lightdome import cache
from lightdome.errors import LightdomeError
from lightdome.opencl.device import Device

pytestmark = pytest.mark.slow

LESSONS = sorted((ROOT / "docs" / "tutorial").glob("*.py"))
OPENCL = ("OCL_ICD_VENDORS", "LD_LIBRARY_PATH", "PYOPENCL_CTX")  # selects the implementation and its libraries


def run(*command: object, **options: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*map(str, command)], capture_output=True, text=True, timeout=LONG, **options)


@pytest.mark.parametrize(
    ("command", "elsewhere"),
    [
        (("my_program.py",), False),
        (("{parent}/my_program.py",), True),
        (("-m", "my_program"), False),
        (("-c", "import my_program"), False),
    ],
)
def test_the_install_wins_over_a_folder_of_its_name(tmp_path: Path, command: tuple[str, ...], elsewhere: bool) -> None:
    """Such as a clone's folder, which Python takes for a package even without an __init__.py."""
    (tmp_path / "lightdome").symlink_to(ROOT)
    (tmp_path / "my_program.py").write_text("import lightdome\nprint(lightdome.LightdomeError, lightdome.__file__)\n")
    words = [word.format(parent=tmp_path) for word in command]
    result = run(sys.executable, *words, cwd="/" if elsewhere else tmp_path)
    assert result.stdout == f"{LightdomeError} {lightdome.__file__}\n", result.stderr


@pytest.fixture
def clone(tmp_path: Path) -> Path:
    """The scripts in a folder with a space in its name, without `.venv`."""
    shutil.copytree(ROOT / "scripts", tmp_path / "a clone" / "scripts")
    return tmp_path / "a clone"


def has_venv(clone: Path) -> None:
    """Give the clone a `.venv` whose Python prints its arguments."""
    (clone / ".venv" / "bin").mkdir(parents=True)
    python = clone / ".venv" / "bin" / "python"
    python.write_text('#!/bin/sh\nprintf "%s\\n" "of .venv" "$@"\n')
    python.chmod(0o755)


WITHOUT_PACKAGES = (sys.executable, "-S")  # like a Python in which lightdome is not installed


@pytest.mark.parametrize("name", [name for name in SCRIPTS if name != "get_grace"])
def test_a_script_goes_on_in_venv(clone: Path, name: str) -> None:
    link = clone.parent / "link.py"
    link.symlink_to(clone / "scripts" / f"{name}.py")
    fails_in_one_line(run(*WITHOUT_PACKAGES, link), f"'{clone}/scripts/demo'")
    has_venv(clone)
    result = run(*WITHOUT_PACKAGES, "link.py", "--map", "a b", cwd=clone.parent)
    assert result.stdout.splitlines() == ["of .venv", "-S", "link.py", "--map", "a b"], result.stderr


@pytest.mark.parametrize("name", SCRIPTS)
def test_a_script_finds_its_start_with_a_safe_path(name: str, tmp_path: Path) -> None:
    """With PYTHONSAFEPATH, Python leaves out the script's folder, and so the files next to it."""
    result = run(sys.executable, "-I", script_path(name), "--help", cwd=tmp_path)
    assert (result.returncode, result.stderr) == (0, "")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_is_kept_while_the_python_of_venv_starts(clone: Path, number: signal.Signals) -> None:
    (clone / ".venv" / "bin").mkdir(parents=True)
    python = clone / ".venv" / "bin" / "python"
    python.write_text(f'#!/bin/sh\nkill -{number.value} $$\nexec {sys.executable} "$@"\n')
    python.chmod(0o755)
    before = signal.signal(number, signal.SIG_DFL)  # the process that started the tests may have ignored it
    try:
        result = run(*WITHOUT_PACKAGES, clone / "scripts" / "part1_fresnel.py")
    finally:
        signal.signal(number, before)
    assert (result.returncode, result.stderr) == (128 + number, "")


def test_a_wrapper_in_venv_round_a_python_without_lightdome_is_started_once(clone: Path) -> None:
    python = clone / ".venv" / "bin" / "python"
    python.parent.mkdir(parents=True)
    ran = clone / "ran"
    python.write_text(f'#!/bin/sh\n[ ! -e "{ran}" ] || exit 9\n: >"{ran}"\nexec {sys.executable} "$@"\n')
    python.chmod(0o755)
    fails_in_one_line(run(*WITHOUT_PACKAGES, clone / "scripts" / "part2_sample.py"), "scripts/demo")


def test_a_venv_without_lightdome_gives_one_line(clone: Path) -> None:
    has_venv(clone)
    (clone / ".venv" / "bin" / "python").unlink()
    (clone / ".venv" / "bin" / "python").symlink_to(sys.executable)
    fails_in_one_line(run(*WITHOUT_PACKAGES, clone / "scripts" / "part2_sample.py"), "scripts/demo")


@pytest.mark.parametrize("name", [name for name in SCRIPTS if name != "get_grace"])
def test_a_python_that_is_too_old_goes_on_in_venv(clone: Path, name: str) -> None:
    has_venv(clone)
    text = script_path(name).read_text(encoding="utf-8")
    program = (
        "import runpy, sys\n"
        "sys.version_info = (3, 6, 15, 'final', 0)\n"
        f"sys.path[0] = {str(clone / 'scripts')!r}\n"
        f"runpy.run_path({str(clone / 'scripts' / f'{name}.py')!r}, run_name='__main__')\n"
    )
    assert run(sys.executable, "-c", program).stdout.startswith("of .venv\n")
    ast.parse(text, feature_version=(3, 6))
    assert "from __future__ import annotations" not in text  # from 3.7


@pytest.mark.parametrize("path", LESSONS, ids=lambda path: path.name)
def test_a_lesson_says_where_lightdome_is(path: Path) -> None:
    fails_in_one_line(run(*WITHOUT_PACKAGES, path), "scripts/demo", ".venv/bin/python")
    ast.parse(path.read_text(encoding="utf-8"), feature_version=(3, 6))


@pytest.mark.parametrize("path", LESSONS, ids=lambda path: path.name)
def test_a_lesson_finds_the_default_map_from_any_folder(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[Path] = []

    def read(path: Path) -> None:
        asked.append(path)
        raise EOFError  # test_docs.py runs the rest

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [str(path)])
    monkeypatch.setattr(lightdome.EnvironmentMap, "read", read)
    with pytest.raises(EOFError):
        runpy.run_path(str(path))
    assert asked == [ROOT / "data" / "default.exr"]


@pytest.mark.parametrize("given", [{}, {"HOME": "/dev/null"}, {"XDG_CACHE_HOME": "/dev/null", "POCL_CACHE_DIR": ""}])
def test_a_kernel_runs_in_a_bare_environment(device: Device, tmp_path: Path, given: dict[str, str]) -> None:
    """Without PATH, and with folders that cannot be used; PoCL by itself aborts on some."""
    environment = {name: os.environ[name] for name in OPENCL if name in os.environ}
    result = run(
        *(sys.executable, "-m", "lightdome", "devices"),
        cwd=tmp_path,
        env={**environment, "TMPDIR": "/nonexistent", **given},
    )
    assert (result.stdout.partition("\n")[0], result.stderr) == (device.description, "")
    assert not list(tmp_path.iterdir())


Set = Callable[..., None]


@pytest.fixture
def environment(monkeypatch: pytest.MonkeyPatch) -> Set:
    """Set HOME and the other variables that ``ensure_room`` reads; unset those not given."""

    def set_environment(**given: object) -> None:
        for name in ("HOME", "XDG_CACHE_HOME", "POCL_CACHE_DIR", "PATH"):
            monkeypatch.setenv(name, str(given.get(name, "")))
            if name not in given:
                monkeypatch.delenv(name)

    return set_environment


def test_without_a_home_caches_are_in_that_of_the_user(
    environment: Set, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    user = pwd.struct_passwd(("user", "", 1, 1, "", str(tmp_path), ""))
    monkeypatch.setattr(pwd, "getpwuid", lambda number: user)
    for given in ({}, {"HOME": ""}, {"HOME": "relative"}, {"XDG_CACHE_HOME": "relative"}, {"XDG_CACHE_HOME": ""}):
        environment(**given)
        cache.ensure_room()
        assert os.environ["XDG_CACHE_HOME"] == str(tmp_path / ".cache"), given
        assert cache.cache_folder("exact") == tmp_path / ".cache" / "lightdome" / "exact"


def test_a_user_without_an_entry_has_a_temporary_cache(environment: Set, monkeypatch: pytest.MonkeyPatch) -> None:
    def nobody(number: int) -> None:
        raise KeyError(number)

    monkeypatch.setattr(pwd, "getpwuid", nobody)
    environment()
    assert not cache.cache_folder("exact").exists()
    cache.ensure_room()
    assert Path(os.environ["XDG_CACHE_HOME"]).parent == Path(tempfile.gettempdir())


def test_a_disk_mounted_noexec_holds_no_kernels(
    environment: Set, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def disk(path: str | Path) -> SimpleNamespace:
        flag = os.ST_NOEXEC if Path(path) == tmp_path else 0
        return SimpleNamespace(f_flag=flag, f_frsize=1, f_blocks=2**30, f_bfree=2**30, f_bavail=2**30)

    monkeypatch.setattr(os, "statvfs", disk)
    environment(HOME=tmp_path)
    cache.ensure_room()
    assert Path(os.environ["XDG_CACHE_HOME"]).parent == Path(tempfile.gettempdir())


def test_a_sound_environment_is_left_alone(environment: Set, tmp_path: Path) -> None:
    given = {"HOME": tmp_path, "POCL_CACHE_DIR": tmp_path / "pocl", "PATH": os.defpath}
    for more in ({}, {"XDG_CACHE_HOME": tmp_path / "caches"}):
        environment(**given, **more)
        before = dict(os.environ)
        cache.ensure_room()
        assert dict(os.environ) == before


def test_no_place_for_temporary_files_gives_one_line(environment: Set, monkeypatch: pytest.MonkeyPatch) -> None:
    def none() -> str:
        raise FileNotFoundError("No usable temporary directory found")

    environment(XDG_CACHE_HOME="/dev/null")
    monkeypatch.setattr(tempfile, "gettempdir", none)
    with pytest.raises(LightdomeError, match="XDG_CACHE_HOME"):
        cache.ensure_room()
