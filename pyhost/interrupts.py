"""Ends a script on Ctrl-C (SIGINT), SIGTERM or a closed terminal (SIGHUP) at any moment: exit status 130, 143 or 129.

Python would raise an exception instead, which is wrong here for three reasons: during a long call into a library,
nothing is raised until the call returns; a C++ library that calls Python, as some do while they load, aborts when an
exception comes back; and unwinding frees memory that kernels still write to. So nothing is raised: the process cleans
up and ends on the spot. If the main thread does not react within :data:`GRACE`, another thread does it.
"""

from __future__ import annotations

import os
import signal
import sys

TYPE_CHECKING = False  # typing is slow to import, and nothing cleans up until this module is loaded
if TYPE_CHECKING:
    from collections.abc import Callable
    from types import FrameType

GRACE = 0.5  # seconds
SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))


def _end(number: int, clear_up: Callable[[], None] | None) -> None:
    try:
        if number == signal.SIGINT:
            name = os.path.basename(sys.argv[0]).removesuffix(".py")  # noqa: PTH119 - pathlib takes long to load
            os.write(2, f"\n{name}: interrupted\n".encode(errors="backslashreplace"))
        if clear_up:
            clear_up()
    finally:
        os._exit(128 + number)


def end_after(clear_up: Callable[[], None]) -> Callable[[], None]:
    """Make a signal call ``clear_up`` and end the process, until the returned function is called.

    ``clear_up`` runs between any two steps of the program; during a call into a library, it runs in another thread.
    """
    import select
    import threading

    process = os.getpid()
    before = {number: signal.getsignal(number) for number in SIGNALS}
    reading, writing = os.pipe()
    os.set_blocking(writing, False)

    def hear(number: int, frame: FrameType | None) -> None:
        for each in SIGNALS:  # cleaning up must not be interrupted
            signal.signal(each, signal.SIG_IGN)
        _end(number, clear_up if os.getpid() == process else None)  # a forked child has nothing of its own to clean up

    def watch() -> None:
        heard = os.read(reading, 1)
        if heard and not select.select([reading], [], [], GRACE)[0]:  # readable once `take_back` closes the other end
            clearing = threading.Thread(target=clear_up, daemon=True)
            clearing.start()
            clearing.join(GRACE)
            _end(heard[0], None)
        os.close(reading)

    wakeup = signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
    threading.Thread(target=watch, daemon=True).start()
    for number in SIGNALS:
        if before[number] is not signal.SIG_IGN:  # as a shell does for background jobs
            signal.signal(number, hear)

    def take_back() -> None:
        signal.set_wakeup_fd(wakeup)
        for number, handler in before.items():
            signal.signal(number, handler)
        os.close(writing)

    return take_back


class Unheard:
    """A ``with`` block: threads and processes started in it, and their own children, never receive a signal."""

    def __enter__(self) -> None:
        if hasattr(signal, "pthread_sigmask"):  # not on Windows
            self._before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)

    def __exit__(self, *_: object) -> None:
        if hasattr(signal, "pthread_sigmask"):
            signal.pthread_sigmask(signal.SIG_SETMASK, self._before)
