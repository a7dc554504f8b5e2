"""What a worker does with a map. It opens its device once, and reads the next map while it computes the current one.

A worker process has two threads: one computes, under a lock, while the other reads. A map that hangs ends the process,
even inside a library that never returns to Python: the C timer of :mod:`faulthandler` needs no cooperation.
"""

from __future__ import annotations

import faulthandler
import math
import os
import re
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import cache
from pathlib import Path, PurePosixPath

from .. import __version__, progress
from ..errors import LightdomeError, one_line, shown
from ..opencl.device import Device, open_device
from .remote import Remote, is_url, name_of, without_secrets
from .row import Options, Row, digest, fill, read

THREADS = 2  # per worker
# Variables from which OpenCL implementations for CPUs take their number of threads.
THREAD_VARIABLES = ("POCL_MAX_PTHREAD_COUNT", "POCL_CPU_MAX_CU_COUNT", "CL_CONFIG_CPU_TBB_NUM_WORKERS")
SETTLE = 1.0  # seconds; Dask's nanny does not replace a worker that dies while starting
_computing, _starting = threading.Lock(), threading.Lock()


def opencl_threads(count: int) -> dict[str, str]:
    """Environment variables that make OpenCL on a CPU use ``count`` threads."""
    return dict.fromkeys(THREAD_VARIABLES, str(count))


@cache  # called only under the lock
def _device(choice: str | None) -> Device:
    from distributed import get_worker

    for name, value in opencl_threads(get_worker().state.nthreads).items():
        os.environ.setdefault(name, value)  # values set when the worker was started take precedence
    return open_device(choice)


class _Watch:
    """Ends the process if any of its threads exceeds its time limit."""

    def __init__(self) -> None:
        self._ends: dict[int, float] = {}
        self._lock = threading.Lock()
        self._nowhere = open(os.devnull, "w")  # noqa: PTH123, SIM115 - open as long as the process runs

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
    progress.LINE_PATIENCE = math.inf  # the client reports the progress
    time.sleep(SETTLE)
    return _Watch()


def _watch() -> _Watch:
    with _starting:  # two threads start at the same time
        return _started()


def work(source: str, options: Options, key: str, known: Sequence[str], version: str | None, seconds: float) -> Row:
    """The row of a map, with its files. If its SHA-256 is in ``known``, the row holds little more than that hash.

    A URL whose server still says ``version`` is not read; its content is the first of ``known``. If the map cannot be
    read or raises an error, its row says why. Reading the map and computing its row may take ``seconds`` each.
    """
    name = name_of(source)
    row = Row({"path": name, "status": "failed", "error": None, "version": __version__})
    path = None
    try:
        if key != options.key:
            raise LightdomeError(f"the worker has a different version of lightdome, {__version__}")
        with ExitStack() as held:
            with _watch().at_most(seconds):
                with row.timed("hash"):
                    if is_url(source):
                        remote = Remote(source, seconds)
                        row.version = remote.version
                        if version is not None and version == row.version:
                            row.values["sha256"] = known[0]
                            return row
                        path = held.enter_context(remote.copied(options.memory))
                    else:
                        path = Path(source)
                    row.values["sha256"], row.values["size_bytes"] = digest(path)
                if row.values["sha256"] in known:
                    return row
                with row.timed("read"):
                    found = read(path, options.memory)
            with _computing:
                device = _device(options.device)
                row.values["device"] = device.description
                with _watch().at_most(seconds):
                    fill(row, found, device, options, _name(name, row.values["sha256"]))
                device.profile.clear()
                device.decisions.take()
        row.values = {name: None if _is_no_number(value) else value for name, value in row.values.items()}
        row.values["status"] = "done"
    except Exception as error:  # one map must not stop the others
        told = str(error) if isinstance(error, LightdomeError) else f"{type(error).__name__}: {one_line(error)}"
        told = told.replace(str(path), name) if path else told
        row.values["error"] = shown(without_secrets(told) if is_url(source) else told)
        row.files.clear()
    return row


def _is_no_number(value: object) -> bool:
    return isinstance(value, float) and not math.isfinite(value)


def _name(path: str, sha256: str) -> str:
    """A short name for the files of a map, different for each content."""
    stem = re.sub(r"[^\w.-]", "_", PurePosixPath(path.partition("?")[0] if is_url(path) else path).stem)[:80]
    return f"{stem}-{sha256[:12]}"
