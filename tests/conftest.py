"""What the tests share: a device, small maps, Grace if it is there, and ways to run scripts."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from typing import TYPE_CHECKING

# Before numpy is loaded: there is a test process for each core, and OpenBLAS's threads would wait for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import pytest
from helpers import GRACE, LONG, Script, command_line, in_gpu_shape, module_of, stiff_radiance
from lightdome import console
from lightdome.errors import LightdomeError
from lightdome.maps.envmap import EnvironmentMap
from lightdome.opencl.device import Device, open_device
from lightdome.pbrt.run import Pbrt, find_pbrt

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def pytest_configure() -> None:
    """Let programs started by tests receive signals, even if a shell or nohup made the suite ignore them."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) is signal.SIG_IGN:
        signal.signal(signal.SIGHUP, signal.SIG_DFL)


@pytest.hookimpl(tryfirst=True)  # before pytest selects by marks
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark tests that run commands or other programs as slow."""
    for item in items:
        if {"script", "run_here"} & set(getattr(item, "fixturenames", ())) or item.get_closest_marker("peer"):
            item.add_marker(pytest.mark.slow)


@pytest.fixture(scope="session")
def device() -> Device:
    return open_device()


@pytest.fixture(scope="session")
def gpu_shaped(device: Device) -> Device:
    return in_gpu_shape(device)


@pytest.fixture(scope="session")
def grace() -> EnvironmentMap:
    if not GRACE.exists():
        pytest.skip("needs the Grace map: run scripts/get_grace.py")
    return EnvironmentMap.read(GRACE)


@pytest.fixture(scope="session")
def program() -> Pbrt:
    """A real PBRT: the one that the environment variable LIGHTDOME_PBRT names, else the one that part 4 finds."""
    try:
        return find_pbrt(os.environ.get("LIGHTDOME_PBRT"))
    except LightdomeError as error:
        if "LIGHTDOME_PBRT" in os.environ:
            raise
        pytest.skip(str(error))


@pytest.fixture(scope="session")
def stiff() -> EnvironmentMap:
    """A small map that is hard to sample: odd sizes, 10 orders of magnitude, black pixels."""
    return EnvironmentMap(stiff_radiance(21, 43))


@pytest.fixture(scope="session")
def script() -> Script:
    """Run ``scripts/NAME.py`` with arguments in its own process."""

    def run(name: str, *args: object, **environment: str) -> subprocess.CompletedProcess[str]:
        command = command_line(name, *args)
        return subprocess.run(command, capture_output=True, text=True, timeout=LONG, env={**os.environ, **environment})

    return run


@pytest.fixture
def run_here(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Script:
    """Run a command as ``script`` does, but in this process, where modules are loaded already."""

    def run(name: str, *args: object) -> subprocess.CompletedProcess[str]:
        words = [f"{name}.py", *map(str, args)]
        monkeypatch.setattr(sys, "argv", words)
        capsys.readouterr()
        with pytest.raises(SystemExit) as ended:
            console.run(module_of(name).main)
        return subprocess.CompletedProcess(words, ended.value.code, *capsys.readouterr())

    return run


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> dict[str, Figure]:
    """Collects figures to be saved, by the stems of their files; the files stay empty, because drawing is slow."""
    import lightdome.plotting  # noqa: F401 (it loads matplotlib whatever backend is asked for)
    from matplotlib.figure import Figure

    found: dict[str, Figure] = {}
    monkeypatch.setattr(Figure, "savefig", lambda figure, path, **_: found.update({path.name.split(".")[1]: figure}))
    return found
