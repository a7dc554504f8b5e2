"""Progress of long work: a bar on a terminal, an occasional line elsewhere."""

from __future__ import annotations

import sys
import time
from typing import ClassVar

PATIENCE = 2.0  # seconds before the bar appears on a terminal
LINE_PATIENCE = 5.0  # seconds before the first line in a pipe, a log or a notebook
LINE_PAUSE = 30.0  # seconds between two such lines, at least


class Progress:
    """Shows ``label``, the progress and the time left on standard error.

    On a terminal this is a bar, which appears after two seconds. Elsewhere it is a line of text, the first after five
    seconds and then at most one every 30 seconds, however deeply the work is nested. Use it as a context manager and
    call :meth:`update` with the fraction done, 0 to 1.
    """

    _active: ClassVar[list[Progress]] = []  # the outermost first
    _last_line: ClassVar[float] = float("-inf")

    def __init__(self, label: str) -> None:
        self.label = label
        self._start = time.monotonic()
        self._shown = False
        self._terminal = sys.stderr.isatty()
        self._fraction = 0.0

    def __enter__(self) -> Progress:
        self._active.append(self)
        return self

    def __exit__(self, *_: object) -> None:
        self._active.remove(self)
        if self._shown:
            sys.stderr.write("\r\x1b[K")
            sys.stderr.flush()

    def update(self, fraction: float) -> None:
        """Say that ``fraction`` of the work (0 to 1) is done."""
        self._fraction = fraction
        now = time.monotonic()
        if not self._terminal:
            self._write_line(now)
        elif now - self._start >= PATIENCE:
            filled = int(30 * fraction)
            bar = "#" * filled + "." * (30 - filled)
            sys.stderr.write(f"\r\x1b[K{self.label} [{bar}] {self._left(now)}")
            sys.stderr.flush()
            self._shown = True

    def _write_line(self, now: float) -> None:
        outermost = self._active[0] if self._active else self
        if now - outermost._start < LINE_PATIENCE or now - Progress._last_line < LINE_PAUSE:
            return
        Progress._last_line = now
        print("; ".join(p._state(now) for p in self._active or [self]), file=sys.stderr, flush=True)

    def _state(self, now: float) -> str:
        if self._fraction > 0:
            return f"{self.label}: {100 * self._fraction:.0f} %, {self._left(now)}"
        return f"{self.label}: {now - self._start:.0f} s so far"

    def _left(self, now: float) -> str:
        elapsed = now - self._start
        return f"{elapsed / self._fraction - elapsed:.0f} s left" if self._fraction > 0 else ""
