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
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property

from .cache import cache_folder, ensure_room, key_of
from .checks import told
from .errors import LightdomeError
from .profile import Profile
from .programs import Programs

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
    omitted: dict[str, str] = field(default_factory=dict)

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

    def omit(self, what: str, why: str) -> None:
        """Note that something was left out because this scene does not need it; ``--explain`` prints the notes."""
        self.omitted[what] = why

    def kernel(self, name: str, **defines: int) -> cl.Kernel:
        """The kernel ``name`` of the source file ``clkernels/name.cl``, built once per set of ``defines``."""
        return self.programs.kernel(name, **defines)


def open_device(choice: str | None = None) -> Device:
    """Open the device that ``choice`` names, or the best one that works.

    ``choice`` is ``PLATFORM[:DEVICE]``, each an index or a part of the name in any case, or a part
    of a device's name; None takes ``PYOPENCL_CTX`` from the environment, else the best device.

    Raises :class:`LightdomeError` if nothing matches or what matches does not work.
    """
    if not (choice is None or isinstance(choice, str)):
        raise LightdomeError(f"a device is named by a text as '0:0' or 'pocl', not by {told(choice)}")
    ensure_room()
    asked = choice or os.environ.get("PYOPENCL_CTX")
    candidates = list(_candidates())
    if asked:
        matching = [c for c in candidates if _matches(asked, c)]
        if not matching:
            known = "; ".join(f"{c.platform}:{c.index} {_description(c.handle)}" for c in candidates)
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


def _candidates() -> Iterator[_Candidate]:
    try:
        platforms = cl.get_platforms()
    except cl.Error:  # the loader's way to say that there are none
        return
    for p, platform in enumerate(platforms):
        try:
            devices = platform.get_devices()
        except cl.Error:
            continue
        for d, handle in enumerate(devices):
            yield _Candidate(p, d, handle)


def _matches(asked: str, candidate: _Candidate) -> bool:
    def one(part: str, index: int, name: str) -> bool:
        return len(part) < 10 and int(part) == index if part.isdecimal() else part.strip().lower() in name.lower()

    platform, colon, device = asked.partition(":")
    on_platform = one(platform, candidate.platform, candidate.handle.platform.name)
    if colon:
        return on_platform and one(device, candidate.index, candidate.handle.name)
    return on_platform or (not asked.isdecimal() and one(asked, candidate.index, candidate.handle.name))


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
    context = cl.Context([handle])
    queue = cl.CommandQueue(context, properties=cl.command_queue_properties.PROFILING_ENABLE)
    return Device(handle, context, queue, Programs(context))
