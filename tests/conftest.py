"""What the tests share: a device, small maps, Grace where it is, and a way to run the scripts."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import pytest
from lightdome.device import Device, open_device
from lightdome.envmap import EnvironmentMap
from lightdome.errors import LightdomeError
from lightdome.pbrt import Pbrt, find_pbrt
from lightdome.programs import Programs

ROOT = Path(__file__).resolve().parent.parent
sys.path.append(str(ROOT / "scripts"))  # for scripts that tests load as modules
LONG = 600.0  # seconds in which a child that does not hang has ended, however slow or shared the machine is
GRACE = Path(os.environ.get("LIGHTDOME_GRACE", ROOT / "data" / "grace_latlong.exr"))


def pytest_configure() -> None:
    """Let programs that tests start hear SIGINT, even if the suite itself runs as a shell's background job."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def device() -> Device:
    return open_device()


class SmallLaunches:
    """Of a device: launches have three work-items at most, or three samples per pixel. All work is long work."""

    def items_a_launch(self, work: int, work_an_item: int) -> int:
        return 3


@dataclass(frozen=True)
class GpuShaped(Device):
    """A device that says it is a GPU: kernels take that shape, and nothing stays in the host's memory."""

    shares_host_memory = False

    @property
    def is_gpu(self) -> bool:
        return True


def with_small_launches(device: Device) -> Device:
    """``device``, with its shape and its kernels, and with :class:`SmallLaunches`."""
    kind = type("SmallLaunchesOf", (SmallLaunches, type(device)), {})
    return kind(**{f.name: getattr(device, f.name) for f in fields(device)})


def in_gpu_shape(device: Device) -> Device:
    """``device`` as :class:`GpuShaped`; its kernels are compiled as for a GPU."""
    programs = Programs(device.context, FUSED=int(device.rates.is_fused))
    return GpuShaped(**{f.name: getattr(device, f.name) for f in fields(device)} | {"programs": programs})


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
    """A real PBRT: that of the environment variable LIGHTDOME_PBRT, else what part 4 finds."""
    try:
        return find_pbrt(os.environ.get("LIGHTDOME_PBRT"))
    except LightdomeError as error:
        if "LIGHTDOME_PBRT" in os.environ:
            raise
        pytest.skip(str(error))


def stiff_radiance(height: int, width: int, seed: int = 1) -> np.ndarray:
    """Log-normal noise of a large spread, with black pixels, a black row and coloured light."""
    rng = np.random.default_rng(seed)
    radiance = np.exp(rng.normal(0, 3, (height, width, 3))).astype(np.float32)
    radiance[rng.random((height, width)) < 0.2] = 0
    if height > 2:
        radiance[1] = 0
    return radiance


@pytest.fixture(scope="session")
def stiff() -> EnvironmentMap:
    """A small map that is hard: odd sizes, 10 orders of magnitude, holes."""
    return EnvironmentMap(stiff_radiance(21, 43))


# The first lines of a Python program that a test writes: a path with a space cannot follow #! itself.
PYTHON_PROGRAM = f"""#!/bin/sh
''':'
exec "{sys.executable}" "$0" "$@"
'''
"""

Script = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture(scope="session")
def script() -> Script:
    """Run ``scripts/NAME.py`` with arguments in a process of its own."""

    def run(name: str, *args: object, **environment: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, str(ROOT / "scripts" / f"{name}.py"), *map(str, args)]
        return subprocess.run(command, capture_output=True, text=True, timeout=LONG, env={**os.environ, **environment})

    return run


def fails_in_one_line(result: subprocess.CompletedProcess[str], *words: str) -> None:
    """Assert the manners of a user's mistake: exit status 1, one line that holds ``words``."""
    assert result.returncode == 1, result.stderr
    assert "Traceback" not in result.stderr
    assert len(result.stderr.strip().splitlines()) == 1, result.stderr
    for word in words:
        assert word in result.stderr
