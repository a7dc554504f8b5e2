"""Choose and open an OpenCL device.

A device counts only once it has compiled and run a trivial kernel in a child process
(:mod:`lightdome.probe`), because a broken implementation lists its devices like a sound one.
The choice, first match wins: the caller's ``--device``, the environment variable
``PYOPENCL_CTX``, a GPU, the newest PoCL, any other device.
"""

from __future__ import annotations

import contextlib
import os
import re
import subprocess
import sys
import warnings
from dataclasses import dataclass, field
from functools import cached_property

from .cache import cache_folder, ensure_room, key_of
from .checks import told
from .decisions import Decisions
from .errors import LightdomeError
from .interrupts import Unheard
from .profile import Profile
from .programs import Kernel, Programs, check_process

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # pyopencl tells of optional packages that lightdome never uses
    import pyopencl as cl

PROBE_SECONDS = 60.0
NO_DEVICE = "no OpenCL device works here; run scripts/demo, which sets one up, or: apt-get install pocl-opencl-icd"


@dataclass(frozen=True)
class Device:
    """An open OpenCL device: its context and queue, its kernels, and what its stages cost.

    ``vector_width`` is the number of pixels that a work-item handles at once: 16 on a CPU, where
    explicit vectors are what fills the machine, 1 on a GPU.
    """

    handle: cl.Device
    context: cl.Context
    queue: cl.CommandQueue
    programs: Programs
    profile: Profile = field(default_factory=Profile)
    decisions: Decisions = field(default_factory=Decisions)

    @property
    def description(self) -> str:
        """The device's and its implementation's name, for people."""
        return _description(self.handle)

    @property
    def is_gpu(self) -> bool:
        """Whether the device is a GPU."""
        return bool(self.handle.type & cl.device_type.GPU)

    @property
    def vector_width(self) -> int:
        """Pixels a work-item handles at once."""
        return 1 if self.is_gpu else 16

    @cached_property
    def shares_host_memory(self) -> bool:
        """Whether kernels can work on the host's memory in place."""
        return bool(self.handle.type & cl.device_type.CPU)

    def one_by_one(self, dimensions: int = 1) -> tuple[int, ...] | None:
        """The local size for work-items that have much to do: one a group on a CPU, a GPU's driver chooses.

        Left to choose, PoCL takes another local size for nearly every global one, and compiles the kernel for each.
        """
        return None if self.is_gpu else (1,) * dimensions

    def kernel(self, name: str, **defines: int) -> Kernel:
        """The kernel ``name`` of the source file ``clkernels/name.cl``, built once per set of ``defines``."""
        return self.programs.kernel(name, **defines)


def open_device(choice: str | None = None) -> Device:
    """Open the device that ``choice`` names, or the best one that works.

    ``choice`` is ``PLATFORM[:DEVICE]``, each an index or a part of a name in any case, or a part of what
    :attr:`Device.description` shows; names are those of the platform, the device, their vendors and versions. None
    takes ``PYOPENCL_CTX`` from the environment, else the best device.

    Raises :class:`LightdomeError` if nothing matches or what matches does not work, and in a process that was
    forked from one that had looked for devices.
    """
    if not (choice is None or isinstance(choice, str)):
        raise LightdomeError(f"a device must be a text such as '0:0' or 'pocl', got {told(choice)}")
    ensure_room()
    asked = choice or os.environ.get("PYOPENCL_CTX")
    candidates = _candidates()
    if asked:
        matching = [c for c in candidates if _matches(asked, c)]
        if not matching:
            known = "; ".join(map(_listed, candidates))
            raise LightdomeError(f"no OpenCL device matches {asked!r}; there is {known or 'none at all'}")
    else:
        matching = candidates
    for candidate in sorted(matching, key=_preference):
        if _works(candidate):
            return _open(candidate.handle)
    if asked:
        raise LightdomeError(
            f"the OpenCL device {asked!r} does not compile and run a trivial kernel; choose another with --device"
        )
    raise LightdomeError(NO_DEVICE)


@dataclass(frozen=True)
class _Candidate:
    platform: int
    index: int
    handle: cl.Device


# The process that first looked for devices: it alone has OpenCL's threads, and a forked copy would wait for them.
_first_process: list[int] = []


def _candidates() -> list[_Candidate]:
    check_process(*_first_process or [os.getpid()])
    _first_process[:] = [os.getpid()]
    result = []
    with Unheard():  # PoCL starts threads here; a linker that they start must not be interrupted, or PoCL aborts
        try:
            platforms = cl.get_platforms()
        except cl.Error:  # the loader's way to say that there are none
            return []
        for p, platform in enumerate(platforms):
            with contextlib.suppress(cl.Error):
                result += [_Candidate(p, d, handle) for d, handle in enumerate(platform.get_devices())]
    return result


def _matches(asked: str, candidate: _Candidate) -> bool:
    """Whether ``asked`` is part of a name that is shown of a device, or matches as ``PLATFORM:DEVICE``."""
    device = candidate.handle
    platform = device.platform
    whole = _description(device)

    def one(part: str, index: int, *names: str) -> bool:
        if part.isascii() and part.isdecimal():
            return part.lstrip("0") == str(index).lstrip("0")
        return any(_plain(part) in _plain(name) for name in (*names, whole))

    of_platform = (platform.name, platform.vendor, platform.version)
    of_device = (device.name, device.vendor, device.version, device.driver_version)
    first, colon, second = asked.partition(":")
    if colon and any(
        _plain(asked) in _plain(name) for name in (*of_platform, *of_device, whole)
    ):  # a name with a colon
        return True
    if " " in asked and _plain(_listed(candidate)).startswith(_plain(asked)):
        return True
    if not colon:
        return one(asked, candidate.platform, *of_platform) or (
            not asked.isdecimal() and one(asked, candidate.index, *of_device)
        )
    return one(first, candidate.platform, *of_platform) and one(second, candidate.index, *of_device)


def _listed(candidate: _Candidate) -> str:
    """The device in a list of devices."""
    return f"{candidate.platform}:{candidate.index} {_description(candidate.handle)}"


def _plain(name: str) -> str:
    return " ".join(name.casefold().split())


def _preference(candidate: _Candidate) -> tuple[int, int, float]:
    """Sort key: GPUs, then CPUs, then the rest; among them PoCL first, the newest first."""
    kind = candidate.handle.type
    rank = 0 if kind & cl.device_type.GPU else 1 if kind & cl.device_type.CPU else 2
    pocl = re.search(r"PoCL (\d+)\.(\d+)", candidate.handle.platform.version)
    version = int(pocl[1]) + int(pocl[2]) / 100 if pocl else 0.0
    return rank, not pocl, -version


def _works(candidate: _Candidate) -> bool:
    """Whether the device passed the probe, now or once before: a pass is remembered, a failure is not."""
    handle = candidate.handle
    identity = [
        handle.platform.name,
        handle.platform.version,
        handle.name,
        handle.driver_version,
        cl.VERSION_TEXT,
    ]
    passed = cache_folder("devices") / key_of(*identity)
    if passed.exists():
        return True
    if not _passes_probe(candidate):
        return False
    with contextlib.suppress(OSError):  # no place to remember it: the next run probes again
        passed.parent.mkdir(parents=True, exist_ok=True)
        passed.touch()
    return True


def _passes_probe(candidate: _Candidate) -> bool:
    command = [sys.executable, "-m", "lightdome.probe", str(candidate.platform), str(candidate.index)]
    try:
        return subprocess.run(command, capture_output=True, timeout=PROBE_SECONDS).returncode == 0
    except subprocess.TimeoutExpired:
        return False


def _description(handle: cl.Device) -> str:
    version = handle.platform.version.removeprefix("OpenCL ").strip()
    return f"{handle.name.strip()}, {handle.platform.name.strip()} ({' '.join(version.split()[1:3]) or version})"


def _open(handle: cl.Device) -> Device:
    with Unheard():  # as above, for implementations that start their threads here
        context = cl.Context([handle])
        queue = cl.CommandQueue(context, properties=cl.command_queue_properties.PROFILING_ENABLE)
    return Device(handle, context, queue, Programs(context))
