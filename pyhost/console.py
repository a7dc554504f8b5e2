"""How a program ends: a user's mistake gives one line and exit status 1; a signal ends it at once and cleanly."""

from __future__ import annotations

import atexit
import errno
import io
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

from . import interrupts
from .errors import LightdomeError, one_line, shown
from .files import abandon


def run(main: Callable[[], None]) -> NoReturn:
    """Run ``main`` and exit: with 0 on success, with 1 and one line of text on a user's mistake.

    A signal ends the process with 130 (Ctrl-C), 143 (SIGTERM) or 129 (SIGHUP).
    """
    for stream in ("stdout", "stderr"):
        if getattr(sys, stream) is None:  # closed by the parent process
            setattr(sys, stream, open(os.devnull, "w"))  # noqa: PTH123, SIM115 - until we exit
    # Flush every line, so that messages keep their order when both streams share a pipe. Escape characters that the
    # output cannot encode, such as those of a file name.
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(line_buffering=True, errors="backslashreplace")
    take_back = interrupts.end_after(_clear_up)
    try:
        sys.exit(_status(main))
    finally:
        take_back()


def _clear_up() -> None:
    """Remove unfinished files, child processes and temporary folders: the process ends without running ``finally``."""
    if processes := sys.modules.get("multiprocessing"):
        for process in processes.active_children():
            process.kill()
    abandon()
    atexit._run_exitfuncs()


def _status(main: Callable[[], None]) -> int:
    try:
        main()
        sys.stdout.flush()
    except BrokenPipeError:
        # Whatever read our output has closed (`| head`): stop quietly, at interpreter exit too.
        _flush_or_drop()
        return 1
    except Exception as error:
        message = str(error) if isinstance(error, LightdomeError) else _shortage(error)
        if message is None:
            raise
        print(f"{Path(sys.argv[0]).stem}: {shown(message)}", file=sys.stderr)
        _flush_or_drop()
        return 1
    return 0


def _shortage(error: Exception) -> str | None:
    """If ``error`` means that the machine ran out of something: what it was, and what to do."""
    if isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT):
        return f"cannot write {error.filename or 'the output'}: {error.strerror}; make room there"
    # A device may run out of memory only when a kernel runs. pyopencl is not imported for this.
    cl = sys.modules.get("pyopencl")
    codes = ("MEM_OBJECT_ALLOCATION_FAILURE", "OUT_OF_RESOURCES", "OUT_OF_HOST_MEMORY")
    on_device = cl and isinstance(error, cl.Error) and error.code in [getattr(cl.status_code, code) for code in codes]
    if on_device or isinstance(error, MemoryError):
        what = "memory on the device" if on_device else "memory"
        return f"not enough {what} ({one_line(error)}); use fewer samples, or a smaller map or image"
    return None


def _flush_or_drop() -> None:
    """Flush standard output; drop what cannot be written, lest the interpreter try again at exit."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
