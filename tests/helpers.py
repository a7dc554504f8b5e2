"""What tests share: paths, small maps, devices of other shapes, and ways to run commands and scripts."""

from __future__ import annotations

import functools
import importlib.util
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, fields
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import OpenImageIO as oiio
import pyopencl as cl
from lightdome.opencl.device import Device, open_device
from lightdome.opencl.programs import Programs

ROOT = Path(__file__).resolve().parent.parent
LONG = 600.0  # seconds in which a child that does not hang ends, however slow or busy the machine
GRACE = Path(os.environ.get("LIGHTDOME_GRACE", ROOT / "data" / "grace_latlong.exr"))
CHROMA_IS_HIDDEN = oiio.VERSION < 30200  # by OpenImageIO before 3.2, which reports R, G, B and then fails

# For commands that run in this process: to open the device for each, with its kernels, would take half of the time.
open_once = functools.cache(open_device)


class SmallLaunches:
    """Part of a device whose launches have at most three work-items or samples per pixel: all work is long."""

    def items_per_launch(self, work: int, work_per_item: int) -> int:
        return 3


@dataclass(frozen=True)
class GpuShaped(Device):
    """A device that claims to be a GPU: kernels take that shape, and arrays are copied to device memory."""

    shares_host_memory = False

    @property
    def is_gpu(self) -> bool:
        return True


class SingleItems(Programs):
    """Kernels that run in groups of one work-item where a GPU's driver chooses: PoCL would compile each size anew."""

    def kernel(self, name: str, **defines: int) -> Callable[..., cl.Event]:
        kernel = super().kernel(name, **defines)

        def run(
            queue: cl.CommandQueue, size: tuple[int, ...], local: tuple[int, ...] | None, /, **arguments: Any
        ) -> cl.Event:
            return kernel(queue, size, local or (1,) * len(size), **arguments)

        return run


def with_small_launches(device: Device) -> Device:
    """A copy of ``device`` with :class:`SmallLaunches`."""
    kind = type("SmallLaunchesOf", (SmallLaunches, type(device)), {})
    return kind(**{f.name: getattr(device, f.name) for f in fields(device)})


def in_gpu_shape(device: Device) -> Device:
    """A copy of ``device`` that is :class:`GpuShaped`, with kernels compiled as for a GPU."""
    programs = SingleItems(device.context, FUSED=int(device.rates.is_fused))
    return GpuShaped(**{f.name: getattr(device, f.name) for f in fields(device)} | {"programs": programs})


def stiff_radiance(height: int, width: int, seed: int = 1) -> np.ndarray:
    """Log-normal noise with a large spread, black pixels, a black row and coloured light."""
    rng = np.random.default_rng(seed)
    radiance = np.exp(rng.normal(0, 3, (height, width, 3))).astype(np.float32)
    radiance[rng.random((height, width)) < 0.2] = 0
    if height > 2:
        radiance[1] = 0
    return radiance


# The first lines of a Python program written by a test: a path with a space cannot follow #! itself.
PYTHON_PROGRAM = f"""#!/bin/sh
''':'
exec "{sys.executable}" "$0" "$@"
'''
"""

Script = Callable[..., subprocess.CompletedProcess[str]]


def fails_in_one_line(result: subprocess.CompletedProcess[str], *words: str) -> None:
    """Assert how a user's mistake is reported: exit status 1, one line that contains ``words``."""
    assert result.returncode == 1, result.stderr
    assert "Traceback" not in result.stderr
    assert len(result.stderr.strip().splitlines()) == 1, result.stderr
    for word in words:
        assert word in result.stderr


SCRIPTS = sorted(path.stem for path in (ROOT / "scripts").glob("[!_]*.py"))


def script_path(name: str) -> Path:
    """The file of a script, in scripts/ or next to the map that it makes."""
    (path,) = (path for path in (ROOT / "scripts" / f"{name}.py", ROOT / "data" / f"{name}.py") if path.exists())
    return path


def command_line(name: str, *arguments: object) -> list[str]:
    """The command line that runs a script in its own process."""
    return [sys.executable, *map(str, (script_path(name), *arguments))]


def module_of(name: str) -> ModuleType:
    """The module of a command, or of a program that is only a script (get_grace, get_pbrt, make_default_map)."""
    if (ROOT / "pyhost" / "commands" / f"{name}.py").exists():
        return import_module(f"lightdome.commands.{name}")
    path = script_path(name)
    if str(path.parent) not in sys.path:
        sys.path.append(str(path.parent))
    spec = importlib.util.spec_from_file_location(f"script_{name}", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look up their module
    spec.loader.exec_module(module)
    return module
