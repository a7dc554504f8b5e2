"""Ctrl-C and a polite kill (SIGINT, SIGTERM), heard by a script at every moment: exit status 130 or 143.

Three things stand in the way of Python's own handling. A long call into a library hears nothing until it returns;
an exception raised in a finaliser is dropped; and leaving Python frees memory that kernels still write to. So the
signal raises :class:`Interrupted`, which clears up on its way out as any exception does; where that takes longer than
:data:`GRACE`, a thread that waits for signals ends the process; and no way out runs the interpreter's own end.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import select
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from types import FrameType

GRACE = 1.0  # seconds to clear up
SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Interrupted(KeyboardInterrupt):
    """A signal of :data:`SIGNALS`: its ``number``."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


def _say(number: int) -> None:
    if number == signal.SIGINT:
        with contextlib.suppress(OSError):
            os.write(2, f"\n{os.path.splitext(os.path.basename(sys.argv[0]))[0]}: interrupted\n".encode())  # noqa: PTH119, PTH122


def _replace(handler: Callable[[int, FrameType | None], None]) -> dict[signal.Signals, object]:
    """Set the handler of every signal that is not ignored, as a shell has it for what runs in its background."""
    before = {number: signal.getsignal(number) for number in SIGNALS}
    for number, old in before.items():
        if old is not signal.SIG_IGN:
            signal.signal(number, handler)
    return before


def end_at_once() -> None:
    """From here on a signal ends the process on the spot: for when there is nothing to clear up."""

    def end(number: int, frame: FrameType | None) -> None:
        _say(number)
        os._exit(128 + number)

    _replace(end)


@contextlib.contextmanager
def raised(clear_up: Callable[[], None]) -> Iterator[None]:
    """In this block the first signal raises :class:`Interrupted` in the main thread.

    Where the process is still there :data:`GRACE` seconds later, ``clear_up`` is called in another thread, and the
    process ended. To be used in the main thread.
    """
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    threading.Thread(target=_watch, args=(reading, clear_up), daemon=True).start()

    heard: list[int] = []

    def stop(number: int, frame: FrameType | None) -> None:
        heard.append(number)
        for each in SIGNALS:  # clearing up is not to be interrupted
            signal.signal(each, signal.SIG_IGN)
        raise Interrupted(number)

    wakeup = signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
    before = _replace(stop)
    try:
        yield
    except BaseException as error:
        if heard:  # the thread goes on waiting for the end
            raise Interrupted(heard[0]) from error
        _restore(before, wakeup, writing)
        raise
    if heard:  # in a finaliser, where exceptions are dropped
        raise Interrupted(heard[0])
    _restore(before, wakeup, writing)


def _restore(before: dict[signal.Signals, object], wakeup: int, writing: int) -> None:
    signal.set_wakeup_fd(wakeup)
    for number, old in before.items():
        signal.signal(number, old)
    os.close(writing)


def _watch(reading: int, clear_up: Callable[[], None]) -> None:
    """End the process :data:`GRACE` seconds after a signal, whatever the main thread does."""
    with contextlib.suppress(OSError):
        heard = os.read(reading, 1)
        if heard and not select.select([reading], [], [], GRACE)[0]:  # it can be read when it has been closed
            clear_up()
            _say(heard[0])
            os._exit(128 + heard[0])
    os.close(reading)


def leave(stopped: Interrupted) -> None:
    """End the process that ``stopped`` has unwound. What its frames hold stays as it is: kernels may still write."""
    _say(stopped.number)
    with contextlib.suppress(Exception):
        sys.stdout.flush()
    with contextlib.suppress(Exception):
        atexit._run_exitfuncs()  # temporary folders
    os._exit(128 + stopped.number)


@contextlib.contextmanager
def unheard() -> Iterator[None]:
    """Threads that are started in this block, and processes that those start, never hear :data:`SIGNALS`."""
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
