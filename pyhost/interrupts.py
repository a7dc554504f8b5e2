"""Ctrl-C and a polite kill (SIGINT, SIGTERM), heard by a script at every moment: exit status 130 or 143.

Python raises an exception, which three things stand in the way of: a long call into a library hears nothing until it
returns; a library in C++ that calls Python, as while it is loaded, aborts when that raises; and frames that are left
free memory to which kernels still write. So nothing is raised. The process clears up where it stands and ends, and
where the main thread does not hear within :data:`GRACE`, another thread does the same.
"""

from __future__ import annotations

import os
import signal
import sys

TYPE_CHECKING = False  # little is imported here: until this is, nothing hears
if TYPE_CHECKING:
    from collections.abc import Callable
    from types import FrameType

GRACE = 0.5  # seconds
SIGNALS = (signal.SIGINT, signal.SIGTERM)


def _end(number: int, clear_up: Callable[[], None] | None) -> None:
    try:
        if number == signal.SIGINT:
            name = os.path.basename(sys.argv[0]).removesuffix(".py")  # noqa: PTH119 - pathlib takes long to load
            os.write(2, f"\n{name}: interrupted\n".encode(errors="backslashreplace"))
        if clear_up:
            clear_up()
    finally:
        os._exit(128 + number)


def _listen(handler: Callable[[int, FrameType | None], None]) -> None:
    for number in SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:  # as a shell has it for what runs in its background
            signal.signal(number, handler)


def end_at_once() -> None:
    """From here on a signal ends the process on the spot: there is nothing to clear up."""
    _listen(lambda number, frame: _end(number, None))


def end_after(clear_up: Callable[[], None]) -> Callable[[], None]:
    """From here on a signal calls ``clear_up`` and ends the process; the function that is returned takes that back.

    ``clear_up`` is called between any two steps of the program, or in another thread beside a call into a library.
    """
    import select
    import threading

    process = os.getpid()
    before = {number: signal.getsignal(number) for number in SIGNALS}
    reading, writing = os.pipe()
    os.set_blocking(writing, False)

    def hear(number: int, frame: FrameType | None) -> None:
        for each in SIGNALS:  # clearing up is not to be interrupted
            signal.signal(each, signal.SIG_IGN)
        _end(number, clear_up if os.getpid() == process else None)  # a fork has nothing of its own

    def watch() -> None:
        heard = os.read(reading, 1)
        if heard and not select.select([reading], [], [], GRACE)[0]:  # it can be read when it has been closed
            clearing = threading.Thread(target=clear_up, daemon=True)
            clearing.start()
            clearing.join(GRACE)
            _end(heard[0], None)
        os.close(reading)

    wakeup = signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
    threading.Thread(target=watch, daemon=True).start()
    _listen(hear)

    def take_back() -> None:
        signal.set_wakeup_fd(wakeup)
        for number, handler in before.items():
            signal.signal(number, handler)
        os.close(writing)

    return take_back


class Unheard:
    """A ``with`` block: threads and processes that are started in it, and what those start, never hear a signal."""

    def __enter__(self) -> None:
        if hasattr(signal, "pthread_sigmask"):  # not on Windows
            self._before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)

    def __exit__(self, *_: object) -> None:
        if hasattr(signal, "pthread_sigmask"):
            signal.pthread_sigmask(signal.SIG_SETMASK, self._before)
