"""The set-up that the commands share (scripts/setup.sh), with stand-ins for Python, pip and apt-get."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest
from helpers import LONG, ROOT

pytestmark = pytest.mark.slow

# The system programs that set-up and the stand-ins may find, and no others.
# fmt: off
TOOLS = (
    "bash", "cat", "chmod", "cksum", "cp", "dirname", "env", "grep", "mkdir", "rm", "sed", "tail", "touch", "true",
)
# fmt: on

# Plays Python, and what set-up runs with it. Files in the folder $STATE say what works: `device` (a device works),
# `wheel`, `system` and `intel` (installing it makes a device work), `slow` (the wheel's device is slow), `ensurepip`,
# `pip says` (pip fails with this message), `no pip` (until the environment is recreated).
PYTHON = """#!/bin/bash
echo "$*" >>"$STATE/calls"
case "$*" in
'-c import ensurepip') [ -e "$STATE/ensurepip" ] ;;
'-c '*version_info*) echo 3.12.1 ;;
'-m venv '*) mkdir -p "$3/bin" && cp "$0" "$3/bin/python" && rm -f "$STATE/no pip" ;;
'-m pip --version') [ ! -e "$STATE/no pip" ] ;;
*'pip --quiet install --editable'*)
    [ ! -e "$STATE/pip says" ] || { cat "$STATE/pip says"; exit 1; } ;;
*'install pocl-binary-distribution') [ ! -e "$STATE/wheel" ] || touch "$STATE/device" ;;
*'install intel-opencl-rt'*) [ ! -e "$STATE/intel" ] || touch "$STATE/device" ;;
*'import pathlib, pyopencl'*) echo "$STATE" ;;
'-m lightdome devices')
    [ -e "$STATE/device" ] || exit 1
    printf 'Some device\nused (*): the only one\n'
    [ ! -e "$STATE/slow" ] || echo 'note: it is slow' ;;
esac
"""

APT_GET = """#!/bin/bash
echo "apt-get $*" >>"$STATE/calls"
case "$*" in
*'install pocl-opencl-icd') [ ! -e "$STATE/system" ] || { touch "$STATE/device"; rm -f "$STATE/slow"; } ;;
*'install python3.12-venv') touch "$STATE/ensurepip" ;;
esac
"""


class Machine:
    """A clone in a folder with a space in its name, on a machine with its own PATH."""

    def __init__(self, folder: Path) -> None:
        self.clone = folder / "a clone"
        (self.clone / "scripts").mkdir(parents=True)
        (self.clone / "pyhost").mkdir()
        for name in ("setup.cfg", "setup.py", "pyproject.toml", "scripts/setup.sh", "pyhost/__init__.py"):
            shutil.copy(ROOT / name, self.clone / name)
        self.state = folder / "state"
        # Stand-ins and links are kept apart, since writing a stand-in over a link would write to the system.
        self.bin = self.state / "bin"
        self.tools = self.state / "tools"
        self.bin.mkdir(parents=True)
        self.tools.mkdir()
        for tool in TOOLS:
            if found := shutil.which(tool):
                (self.tools / tool).symlink_to(found)
        self.program("id", "#!/bin/bash\necho 0\n")
        self.program("python3", PYTHON)
        self.has("ensurepip")

    def program(self, name: str, text: str) -> None:
        """Put a stand-in on PATH, before the system program of that name."""
        path = self.bin / name
        assert not path.is_symlink()
        path.write_text(text)
        path.chmod(0o755)

    def has(self, *things: str) -> None:
        """Set what works on this machine."""
        for thing in things:
            (self.state / thing).touch()

    def set_up(self, **environment: str) -> subprocess.CompletedProcess[str]:
        """Run set-up from another folder; ``calls`` then holds only what this run called."""
        (self.state / "calls").write_text("")
        path = f"{self.bin}:{self.tools}"
        home = os.environ.get("HOME", "/")
        script = 'set -euo pipefail; . "$1/scripts/setup.sh"; set_up'
        return subprocess.run(
            [self.tools / "bash", "-c", script, "_", self.clone],
            cwd="/",
            env={"PATH": path, "STATE": str(self.state), "HOME": home, **environment},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=LONG,
        )

    @property
    def calls(self) -> str:
        """The calls, one per line."""
        return (self.state / "calls").read_text()


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return Machine(tmp_path)


def test_a_device_that_works_is_all_that_is_needed(machine: Machine) -> None:
    machine.has("device")
    result = machine.set_up()
    assert result.returncode == 0, result.stderr
    assert "OpenCL device: Some device" in result.stdout
    assert "pocl" not in machine.calls


def test_the_second_run_only_checks(machine: Machine) -> None:
    machine.has("device")
    machine.set_up()
    result = machine.set_up()
    assert result.returncode == 0, result.stderr
    assert "-m lightdome devices" in machine.calls
    assert "install" not in machine.calls
    assert "-m venv" not in machine.calls


def test_the_package_is_installed_again_when_its_metadata_changed(machine: Machine) -> None:
    machine.has("device")
    machine.set_up()
    with (machine.clone / "setup.cfg").open("a") as file:
        file.write("# changed\n")
    machine.set_up()
    assert "install --editable" in machine.calls
    assert "-m venv" not in machine.calls


@pytest.mark.parametrize("what", ["moved", "no pip"])
def test_a_broken_environment_is_recreated(machine: Machine, what: str) -> None:
    machine.has("device")
    machine.set_up()
    if what == "moved":
        machine.clone = machine.clone.rename(machine.clone.with_name("another place"))
    else:
        machine.has("no pip")
    result = machine.set_up()
    assert result.returncode == 0, result.stderr
    assert "-m venv" in machine.calls
    assert "install --editable" in machine.calls


def test_a_users_own_environment_is_kept(machine: Machine) -> None:
    machine.has("device")
    machine.set_up()
    (machine.clone / ".venv" / ".finished").unlink()
    assert machine.set_up().returncode == 0
    assert "install --editable" in machine.calls
    assert "-m venv" not in machine.calls


def test_pocl_comes_from_its_wheel_where_that_works(machine: Machine) -> None:
    machine.has("wheel")
    machine.program("apt-get", APT_GET)
    result = machine.set_up()
    assert result.returncode == 0, result.stderr
    assert "pip --quiet install pocl-binary-distribution" in machine.calls
    assert "uninstall" not in machine.calls
    assert "apt-get" not in machine.calls


def test_a_wheel_that_does_not_work_is_removed_and_the_system_package_taken(machine: Machine) -> None:
    machine.has("system")
    machine.program("apt-get", APT_GET)
    result = machine.set_up()
    assert result.returncode == 0, result.stderr
    assert "pip --quiet uninstall --yes pocl-binary-distribution" in machine.calls
    assert "install pocl-opencl-icd" in machine.calls


@pytest.mark.parametrize("has_system", [True, False])
def test_a_wheel_that_is_slow_stays_and_the_system_package_is_tried(machine: Machine, has_system: bool) -> None:
    machine.has("wheel", "slow", *(["system"] if has_system else []))
    machine.program("apt-get", APT_GET)
    result = machine.set_up()
    assert result.returncode == 0, result.stderr
    assert "install pocl-opencl-icd" in machine.calls
    assert "uninstall" not in machine.calls
    assert "intel" not in machine.calls
    assert ("it is slow" in result.stdout) != has_system


def test_where_nothing_else_works_intels_runtime_is_taken(machine: Machine) -> None:
    machine.has("intel")
    machine.program("id", "#!/bin/bash\necho 1000\n")
    result = machine.set_up()
    assert result.returncode == 0, result.stderr
    assert (machine.state / "intel.icd").read_text() == f"{machine.clone}/.venv/lib/libintelocl.so\n"
    assert "Intel's own licence" in result.stdout


def test_without_root_or_sudo_one_line_names_the_command(machine: Machine) -> None:
    machine.program("apt-get", APT_GET)
    machine.program("id", "#!/bin/bash\necho 1000\n")
    machine.program("sudo", "#!/bin/bash\nexit 1\n")
    result = machine.set_up()
    assert result.returncode == 1
    assert result.stderr.count("\n") == 1
    assert "sudo apt-get install pocl-opencl-icd" in result.stderr
    assert "apt-get" not in machine.calls


def test_sudo_without_a_password_is_used(machine: Machine) -> None:
    machine.has("system")
    machine.program("apt-get", APT_GET)
    machine.program("id", "#!/bin/bash\necho 1000\n")
    machine.program("sudo", '#!/bin/bash\n[ "$1" = -n ] && shift && exec "$@"\n')
    assert machine.set_up().returncode == 0


def test_a_python_without_ensurepip_gets_it_from_its_package(machine: Machine) -> None:
    machine.has("device")
    (machine.state / "ensurepip").unlink()
    assert "python3.12-venv" in machine.set_up().stderr
    machine.program("apt-get", APT_GET)
    result = machine.set_up()
    assert result.returncode == 0, result.stderr
    assert "install python3.12-venv" in machine.calls


@pytest.mark.parametrize("broken", ["exit 127", "exit 1"])
def test_no_python_that_runs_gives_one_line(machine: Machine, broken: str) -> None:
    machine.program("python3", f"#!/bin/bash\n{broken}\n")
    result = machine.set_up()
    assert result.returncode == 1
    assert result.stderr == (
        "set-up: found no Python 3.10 or newer; install one, or name it: PYTHON=/path/to/python3\n"
    )
    assert not (machine.clone / ".venv").exists()


def test_a_named_python_that_does_not_run_gives_one_line(machine: Machine) -> None:
    result = machine.set_up(PYTHON="/nonexistent/python")
    assert result.returncode == 1
    assert result.stderr == "set-up: PYTHON=/nonexistent/python is not a working Python 3.10 or newer\n"


def test_whatever_pip_fails_at_is_one_line_with_its_reason(machine: Machine) -> None:
    reason = "Could not install packages due to an OSError: [Errno 28] No space left on device"
    (machine.state / "pip says").write_text(f"Collecting lightdome\n  noise\nERROR: {reason}\n\n")
    result = machine.set_up()
    assert result.returncode == 1
    assert result.stderr.count("\n") == 1
    assert reason in result.stderr
    assert str(machine.clone / ".venv" / "setup.log") in result.stderr
    (machine.state / "pip says").unlink()
    machine.has("device")
    assert machine.set_up().returncode == 0


def test_the_package_is_installed_again_when_its_version_changed(machine: Machine) -> None:
    machine.has("device")
    machine.set_up()
    path = machine.clone / "pyhost" / "__init__.py"
    path.write_text(path.read_text().replace('__version__ = "', '__version__ = "9.'))
    machine.set_up()
    assert "install --editable" in machine.calls


def test_a_device_that_the_caller_chose_in_vain_installs_nothing(machine: Machine) -> None:
    result = machine.set_up(PYOPENCL_CTX="9")
    assert result.returncode == 1
    assert "PYOPENCL_CTX=9" in result.stderr
    assert "pocl" not in machine.calls
