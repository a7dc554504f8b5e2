"""Mitsuba 3 in a separate process: an object lives there, and its methods are called from here.

The process is separate because the LLVM that Dr.Jit loads may abort: on some processors, LLVM 15 and 16 lack what
Dr.Jit's code needs.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import weakref
from collections.abc import Callable
from importlib.util import find_spec
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Protocol

from ..errors import LightdomeError
from ..interrupts import Unheard

MIN_LLVM = 17
START_TIMEOUT = 120.0  # seconds
INSTALL = "pip install 'lightdome[peers]'"


def installed() -> bool:
    """Whether the package ``mitsuba`` is installed, without importing it."""
    return find_spec("mitsuba") is not None


class Worker(Protocol):
    """The object in the process; ``about`` describes what runs there, in JSON types only."""

    about: dict[str, object]


class MitsubaProcess:
    """A process that holds ``make(*arguments)``, a :class:`Worker`, whose ``about`` this has too.

    Raises :class:`LightdomeError` if the worker cannot be made or the process ends. The process ends with this object,
    or by ``stop()``.
    """

    def __init__(self, make: Callable[..., Worker], *arguments: object, start_timeout: float = START_TIMEOUT) -> None:
        # Not forked, since a copy of OpenCL's threads and locks would be broken.
        context = multiprocessing.get_context("spawn")
        self._connection, theirs = context.Pipe()
        self._process = context.Process(target=_work, args=(theirs,), daemon=True)
        with Unheard():  # Ctrl-C goes to the whole process group
            self._process.start()
        theirs.close()
        self.stop = weakref.finalize(self, _stop, self._process, self._connection)
        self.about: dict[str, object] = self.call(make, *arguments, timeout=start_timeout)

    def call(self, method: str | Callable[..., Worker], *arguments: object, timeout: float) -> Any:
        """The result of the worker's ``method`` for ``arguments``; for a function that makes the worker, its ``about``.

        Raises :class:`LightdomeError`, in one line, if the worker raises anything, the process ends, or it does not
        answer within ``timeout`` seconds. After a timeout it does not answer again.
        """
        if not self.stop.alive:
            raise LightdomeError("Mitsuba's process has ended")
        with contextlib.suppress(OSError):  # if the process has just ended, the reason is found below
            self._connection.send((method, arguments))
        try:
            if self._connection.poll(timeout):
                answer, error = self._connection.recv()
            else:
                answer, error = None, f"Mitsuba did not answer in {timeout:.0f} s"
                self.stop()
        except (EOFError, OSError):
            self._process.join(10)
            code = self._process.exitcode
            how = f"crashed (signal {-code})" if code is not None and code < 0 else f"ended with exit status {code}"
            answer, error = None, f"Mitsuba's process {how}; its LLVM may not fit this machine"
            self.stop()
        if error:
            raise LightdomeError(error)
        return answer


def _stop(process: multiprocessing.process.BaseProcess, connection: Connection) -> None:
    connection.close()
    process.kill()
    process.join(10)


# ---- in the process ----


def _work(connection: Connection) -> None:
    """Make the worker and describe it, then serve calls; each answer is (result, error)."""
    # Silence Dr.Jit and LLVM, which complain over many lines where one line says what is wrong.
    with Path(os.devnull).open("wb") as nowhere:
        os.dup2(nowhere.fileno(), 1)
        os.dup2(nowhere.fileno(), 2)
    try:
        make, arguments = connection.recv()
        try:
            worker = make(*arguments)
        except Exception as error:
            connection.send((None, _line(error)))
            return
        connection.send((worker.about, ""))
        while True:
            method, arguments = connection.recv()
            try:
                answer = getattr(worker, method)(*arguments), ""
            except Exception as error:
                answer = None, _line(error)
            connection.send(answer)
    except (EOFError, OSError):
        return  # the other side has ended


def _line(error: Exception) -> str:
    return (str(error) if isinstance(error, LightdomeError) else f"{type(error).__name__}: {error}").splitlines()[0]


def use_variant(variant: str) -> dict[str, object]:
    """Set Mitsuba's ``variant``, quietly; returns the version of Mitsuba and, if the variant needs it, of LLVM.

    Raises :class:`LightdomeError` if the variant needs LLVM 17 or newer, and there is none.
    """
    import drjit
    import mitsuba

    about: dict[str, object] = {"mitsuba": mitsuba.__version__}
    if variant.startswith("llvm"):
        advice = "set DRJIT_LIBLLVM_PATH to its libLLVM.so"
        if not drjit.has_backend(drjit.JitBackend.LLVM):
            raise LightdomeError(f"needs LLVM {MIN_LLVM} or newer; {advice}")
        found = drjit.detail.llvm_version()
        about["llvm"] = ".".join(map(str, found))
        if found[0] < MIN_LLVM:
            raise LightdomeError(f"needs LLVM {MIN_LLVM} or newer, found {about['llvm']}; {advice}")
    mitsuba.set_variant(variant)
    mitsuba.set_log_level(mitsuba.LogLevel.Error)
    return about
