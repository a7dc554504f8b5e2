"""Choose and open an OpenCL device.

A device counts only once it has compiled and run kernels in a child process (:mod:`lightdome.probe`), because a broken
implementation lists its devices just as a working one does. The same process measures the device
(:mod:`lightdome.opencl.rates`). The fastest device is used, out of those that ``--device`` or the environment variable
``PYOPENCL_CTX`` names, or else out of all.
"""

from __future__ import annotations

import contextlib
import importlib.metadata
import json
import os
import re
import subprocess
import sys
import time
import warnings
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

from ..cache import cache_folder, ensure_room, key_of
from ..checks import told
from ..decisions import Decisions
from ..errors import LightdomeError, one_line
from ..files import replacing
from ..interrupts import Unheard
from ..progress import Progress

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # pyopencl warns about optional packages that lightdome never uses
    import pyopencl as cl

from .launch import launch as launch_kernel
from .launch import launch_rows as launch_kernel_by_rows
from .profile import Profile
from .programs import Kernel, Programs, check_process
from .rates import Rates

PROBE_SECONDS = 60.0
FAILURE_SECONDS = 86400.0  # how long a failure is remembered, if another device works
WHEEL = "pocl-binary-distribution"  # what the extra [pocl] installs


@dataclass(frozen=True)
class Device:
    """An open OpenCL device: its context and queue, its kernels, and the time that its stages take.

    ``vector_width`` is the number of pixels that a work-item handles at once: 16 on a CPU, which needs explicit vectors
    to reach full speed, and 1 on a GPU.
    """

    handle: cl.Device
    context: cl.Context
    queue: cl.CommandQueue
    programs: Programs
    rates: Rates
    profile: Profile = field(default_factory=Profile)
    decisions: Decisions = field(default_factory=Decisions)

    def __repr__(self) -> str:
        return f"<Device: {self.description}, {1e-9 * self.rates.multiply_adds:.0f} G multiply-adds/s>"

    @property
    def description(self) -> str:
        """The names of the device and of its OpenCL implementation, for display."""
        return _description(self.handle)

    @property
    def hardware(self) -> str:
        """The processor's or graphics card's name, without the prefix that PoCL adds: its driver and LLVM's target."""
        return re.sub(r"^(?:cpu|pthread|basic)-(?:[a-z0-9_.]+-)*(?=[A-Z0-9])", "", self.handle.name.strip())

    @property
    def note(self) -> str | None:
        """A warning, with a remedy, if the device is slow for this machine; else None."""
        return _slow(self.rates)

    @property
    def is_gpu(self) -> bool:
        """Whether the device is a GPU."""
        return bool(self.handle.type & cl.device_type.GPU)

    @property
    def vector_width(self) -> int:
        """Pixels that a work-item handles at once."""
        return 1 if self.is_gpu else 16

    @cached_property
    def shares_host_memory(self) -> bool:
        """Whether kernels can work on the host's memory in place."""
        return bool(self.handle.type & cl.device_type.CPU)

    def items_per_launch(self, work: int, work_per_item: int) -> int:
        """Work-items per launch, at least one, for about ``work`` in each; longer work takes several launches."""
        return max(1, work // work_per_item)

    def kernel(self, name: str, **defines: int) -> Kernel:
        """The kernel ``name`` of the source file ``clkernels/name.cl``, built once per set of ``defines``."""
        return self.programs.kernel(name, **defines)

    launch = launch_kernel
    launch_rows = launch_kernel_by_rows

    def wait(self) -> None:
        """Wait until everything launched so far is done."""
        self.queue.finish()
        self.profile.settle()


def open_device(choice: str | None = None) -> Device:
    """Open the device that ``choice`` names, or the best one that works.

    ``choice`` is ``PLATFORM[:DEVICE]``. Each of the two is an index, or part of a name, vendor or version, in upper or
    lower case. Part of :attr:`Device.description` works too. With None, ``PYOPENCL_CTX`` in the environment decides, or
    else the best device is taken.

    Raises :class:`LightdomeError` if no device matches, if none of those that match works, and in a process forked from
    one that has already looked for devices.
    """
    if not (choice is None or isinstance(choice, str)):
        raise LightdomeError(f"a device must be a string such as '0:0' or 'pocl', got {told(choice)}")
    ensure_room()
    asked = choice or os.environ.get("PYOPENCL_CTX")
    candidates = _candidates()
    if asked:
        matching = [c for c in candidates if _matches(asked, c)]
        if not matching:
            known = "; ".join(map(_listed, candidates))
            raise LightdomeError(f"no OpenCL device matches {asked!r}; available: {known or 'none'}")
    else:
        matching = candidates
    trials = _tried(matching)
    best = _fastest(trials)
    if best:
        return _open(best)
    failures = "; ".join(f"{_listed(trial.candidate)}: {trial.failure}" for trial in trials)
    if asked:
        raise LightdomeError(
            f"the OpenCL device {asked!r} does not compile and run kernels ({failures}); choose another with --device"
        )
    raise LightdomeError(
        f"no OpenCL device works here{f' ({failures})' if failures else ''}; for one that does: {_install()}"
    )


@dataclass(frozen=True)
class Surveyed:
    """A device found by :func:`survey`: its indices, as for ``--device``, and its rates, or why it fails."""

    choice: str
    description: str
    is_taken: bool
    rates: Rates | None
    failure: str

    @property
    def note(self) -> str | None:
        """:attr:`Device.note`."""
        return _slow(self.rates) if self.rates else None

    def to_dict(self) -> dict[str, object]:
        """For JSON, with units in the names."""
        rates = self.rates and {
            "multiply_adds_per_second": self.rates.multiply_adds,
            "copied_bytes_per_second": self.rates.copies,
            "frame_seconds": self.rates.frame_seconds,
            "numpy_multiply_adds_per_second": self.rates.numpy,
        }
        return {
            "device": self.choice,
            "description": self.description,
            "is_taken": self.is_taken,
            "failure": self.failure or None,
            "rates": rates,
            "note": self.note,
        }


def survey() -> list[Surveyed]:
    """All devices; the one in use is marked.

    Devices that failed before are tried again. Raises :class:`LightdomeError` as :func:`open_device` does.
    """
    taken = open_device().handle
    result = []
    for trial in _tried(_candidates(), again=True):
        found = trial.candidate
        is_taken = found.handle == taken
        choice = f"{found.platform}:{found.index}"
        result.append(Surveyed(choice, _description(found.handle), is_taken, trial.rates, trial.failure))
    return result


@dataclass(frozen=True)
class _Candidate:
    platform: int
    index: int
    handle: cl.Device


# The process that first looked for devices. Only it has OpenCL's threads; a forked child would wait for them forever.
_first_process: list[int] = []


def _candidates() -> list[_Candidate]:
    check_process(*_first_process or [os.getpid()])
    _first_process[:] = [os.getpid()]
    result: list[_Candidate] = []
    with Unheard():  # PoCL starts threads here, and aborts if a linker that they run is interrupted
        try:
            platforms = cl.get_platforms()
        except cl.Error:  # how the loader reports that there are no platforms
            return []
        for p, platform in enumerate(platforms):
            with contextlib.suppress(cl.Error):
                for d, handle in enumerate(platform.get_devices()):
                    if all(handle != other.handle for other in result):  # else the loader found it twice
                        result.append(_Candidate(p, d, handle))
    return result


def _matches(asked: str, candidate: _Candidate) -> bool:
    """Whether ``asked`` is part of one of the device's names, or matches it as ``PLATFORM:DEVICE``."""
    device = candidate.handle
    platform = device.platform
    whole = _description(device)

    def one(part: str, index: int, *names: str) -> bool:
        if part.isascii() and part.isdecimal():
            return part.lstrip("0") == str(index).lstrip("0")
        return any(_plain(part) in _plain(name) for name in (*names, whole))

    of_platform = (platform.name, platform.vendor, platform.version)
    of_device = (device.name, device.vendor, device.version, device.driver_version)
    first, _, second = asked.partition(":")
    return (
        # A name may itself contain a colon.
        (not asked.isdecimal() and any(_plain(asked) in _plain(name) for name in (*of_platform, *of_device, whole)))
        or (" " in asked and _plain(_listed(candidate)).startswith(_plain(asked)))
        or (one(first, candidate.platform, *of_platform) and (not second or one(second, candidate.index, *of_device)))
    )


def _listed(candidate: _Candidate) -> str:
    """The device as shown in lists of devices."""
    return f"{candidate.platform}:{candidate.index} {_description(candidate.handle)}"


def _plain(name: str) -> str:
    return " ".join(name.casefold().split())


@dataclass(frozen=True)
class _Trial:
    """The result of trying a device: its rates, or why it fails."""

    candidate: _Candidate
    rates: Rates | None
    failure: str = ""
    is_remembered: bool = False


def _fastest(trials: list[_Trial]) -> _Trial | None:
    return min((t for t in trials if t.rates), key=lambda t: t.rates.frame_seconds, default=None)  # type: ignore[union-attr]


def _tried(candidates: list[_Candidate], again: bool = False) -> list[_Trial]:
    """Try every candidate, or reuse its result from an earlier run.

    Failures are remembered for a day. They are tried again if no device works, or if ``again`` is set.
    """
    trials = []
    with Progress("trying OpenCL devices") as progress:
        for done, candidate in enumerate(candidates):
            progress.update(done / len(candidates))
            trials.append(_remembered(candidate) or _probe(candidate))
        if again or not _fastest(trials):
            trials = [_probe(t.candidate) if t.is_remembered and not t.rates else t for t in trials]
    if _fastest(trials):
        for trial in trials:
            if not trial.is_remembered:
                _remember(trial)
    return trials


def _record(candidate: _Candidate) -> Path:
    handle = candidate.handle
    identity = [
        handle.platform.name,
        handle.platform.version,
        handle.name,
        handle.driver_version,
        cl.VERSION_TEXT,
    ]
    return cache_folder("devices") / f"{key_of(*identity)}.json"


def _remembered(candidate: _Candidate) -> _Trial | None:
    record = _record(candidate)
    with contextlib.suppress(OSError, ValueError, TypeError, KeyError):
        known = json.loads(record.read_text(encoding="utf-8"))
        if "failure" not in known:
            return _Trial(candidate, Rates.from_json(known["rates"]), is_remembered=True)
        if 0 <= time.time() - record.stat().st_mtime < FAILURE_SECONDS:
            return _Trial(candidate, None, one_line(known["failure"]), is_remembered=True)
    return None


def _remember(trial: _Trial) -> None:
    record = _record(trial.candidate)
    content = {"rates": trial.rates.to_json()} if trial.rates else {"failure": trial.failure}
    with contextlib.suppress(OSError, LightdomeError):  # the cache cannot be written: the next run probes again
        record.parent.mkdir(parents=True, exist_ok=True)
        with replacing(record) as temporary:
            temporary.write_text(json.dumps(content) + "\n", encoding="utf-8")


def _probe(candidate: _Candidate) -> _Trial:
    command = [sys.executable, "-m", "lightdome.probe", str(candidate.platform), str(candidate.index)]
    try:
        child = subprocess.run(command, capture_output=True, text=True, errors="replace", timeout=PROBE_SECONDS)
    except subprocess.TimeoutExpired:
        return _Trial(candidate, None, f"no answer in {PROBE_SECONDS:.0f} s")
    with contextlib.suppress(ValueError, TypeError, IndexError):
        if child.returncode == 0:
            return _Trial(candidate, Rates.from_json(json.loads(child.stdout.splitlines()[-1])))
    said = child.stderr.strip().splitlines() or [f"the process ended with {child.returncode}"]
    return _Trial(candidate, None, one_line(said[-1].removeprefix("probe: ").removeprefix("the device fails: ")))


def _install() -> str:
    """How to get another OpenCL device; if PoCL's wheel is there, it may be what is broken."""
    is_there = any(True for _ in importlib.metadata.distributions(name=WHEEL))
    pip = f"pip install --force-reinstall {WHEEL}" if is_there else "pip install 'lightdome[pocl]'"
    return f"apt-get install pocl-opencl-icd, {pip}, or your GPU's driver"


def _slow(rates: Rates) -> str | None:
    if not rates.is_slow:
        return None
    return (
        f"note: this OpenCL device does {1e-9 * rates.multiply_adds:.0f} G multiply-adds per second, less than a third"
        f" of numpy's {1e-9 * rates.numpy:.0f} G; for a faster one: {_install()}"
    )


def _description(handle: cl.Device) -> str:
    version = handle.platform.version.removeprefix("OpenCL ").strip()
    return f"{handle.name.strip()}, {handle.platform.name.strip()} ({' '.join(version.split()[1:3]) or version})"


def _open(trial: _Trial) -> Device:
    handle, rates = trial.candidate.handle, trial.rates
    assert rates is not None
    with Unheard():  # as above, for implementations that start their threads here
        context = cl.Context([handle])
        queue = cl.CommandQueue(context, properties=cl.command_queue_properties.PROFILING_ENABLE)
    is_cpu = bool(handle.type & cl.device_type.CPU)
    return Device(handle, context, queue, Programs(context, FUSED=int(rates.is_fused), CPU=int(is_cpu)), rates)
