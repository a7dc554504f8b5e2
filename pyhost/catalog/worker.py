"""What a worker does with a map. It opens its device once, and reads the next map while it computes this one.

A worker process has two threads: one computes, under a lock, while the other reads. A map that hangs, also in a library
that never returns to Python, ends the process: the C timer of :mod:`faulthandler` needs no cooperation.
"""

from __future__ import annotations

import faulthandler
import math
import os
import re
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from functools import cache
from pathlib import PurePosixPath

from .. import __version__, progress
from ..errors import LightdomeError, one_line, shown
from ..opencl.device import Device, open_device
from .row import Options, Row, digest, fill, local, read

THREADS = 2  # of a worker
# What OpenCL implementations for CPUs take as their number of threads.
THREAD_VARIABLES = ("POCL_MAX_PTHREAD_COUNT", "POCL_CPU_MAX_CU_COUNT", "CL_CONFIG_CPU_TBB_NUM_WORKERS")
SETTLE = 1.0  # seconds: Dask's nanny starts no other worker for one that dies while it starts
_computing, _starting = threading.Lock(), threading.Lock()


def opencl_threads(count: int) -> dict[str, str]:
    """The environment in which OpenCL on a CPU takes ``count`` threads."""
    return dict.fromkeys(THREAD_VARIABLES, str(count))


@cache  # under the lock
def _device(choice: str | None) -> Device:
    from distributed import get_worker

    for name, value in opencl_threads(get_worker().state.nthreads).items():
        os.environ.setdefault(name, value)  # what started the worker may know better
    return open_device(choice)


class _Watch:
    """Ends the process if something in it takes too long."""

    def __init__(self) -> None:
        self._ends: dict[int, float] = {}
        self._lock = threading.Lock()
        self._nowhere = open(os.devnull, "w")  # noqa: PTH123, SIM115 - as long as the process

    @contextmanager
    def at_most(self, seconds: float) -> Iterator[None]:
        me = threading.get_ident()
        self._set(me, time.monotonic() + seconds)
        try:
            yield
        finally:
            self._set(me, math.inf)

    def _set(self, thread: int, end: float) -> None:
        with self._lock:
            self._ends[thread] = end
            first = min(self._ends.values())
            if first < math.inf:
                left = max(0.01, first - time.monotonic())
                faulthandler.dump_traceback_later(left, exit=True, file=self._nowhere)
            else:
                faulthandler.cancel_dump_traceback_later()


@cache
def _started() -> _Watch:
    progress.LINE_PATIENCE = math.inf  # the client says how far the work is
    time.sleep(SETTLE)
    return _Watch()


def _watch() -> _Watch:
    with _starting:  # two threads begin at once
        return _started()


def work(source: str, options: Options, key: str, known: Iterable[str], seconds: float) -> Row:
    """The row of a map, with its files; of one whose SHA-256 is in ``known``, that alone.

    A map that cannot be read, or costs an error, has a row that says why. Reading it and computing its row may take
    ``seconds`` each.
    """
    row = Row({"path": source, "status": "failed", "error": None, "version": __version__})
    path = None
    try:
        if key != options.key:
            raise LightdomeError(f"the worker has another version of lightdome, {__version__}")
        with ExitStack() as held:
            with _watch().at_most(seconds):
                with row.timed("hash"):
                    path = held.enter_context(local(source))
                    row.values["sha256"], row.values["size_bytes"] = digest(path)
                if row.values["sha256"] in known:
                    return row
                with row.timed("read"):
                    found = read(path, options.memory)
            with _computing:
                device = _device(options.device)
                row.values["device"] = device.description
                with _watch().at_most(seconds):
                    fill(row, found, device, options, _name(source, row.values["sha256"]))
                device.profile.clear()
                device.decisions.take()
        row.values = {name: None if _is_no_number(value) else value for name, value in row.values.items()}
        row.values["status"] = "done"
    except Exception as error:  # one map must not cost the others their rows
        told = str(error) if isinstance(error, LightdomeError) else f"{type(error).__name__}: {one_line(error)}"
        row.values["error"] = shown(told.replace(str(path), source) if path else told)
        row.files.clear()
    return row


def _is_no_number(value: object) -> bool:
    return isinstance(value, float) and not math.isfinite(value)


def _name(source: str, sha256: str) -> str:
    """Of the files of a map: short, and another one for each content."""
    stem = re.sub(r"[^\w.-]", "_", PurePosixPath(source).stem)[:80]
    return f"{stem}-{sha256[:12]}"
