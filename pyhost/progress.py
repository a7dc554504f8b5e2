"""A progress line on the terminal for work that takes longer than two seconds."""

from __future__ import annotations

import sys
import time

PATIENCE = 2.0  # seconds that a person waits without wondering


class Progress:
    """Shows ``label``, a bar and the time left on standard error.

    Nothing is printed before two seconds have passed, nor where standard error is no terminal.
    Use as a context manager and call :meth:`update` with the fraction done, 0 to 1.
    """

    def __init__(self, label: str) -> None:
        self.label = label
        self._start = time.monotonic()
        self._shown = False
        self._terminal = sys.stderr.isatty()

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        if self._shown:
            sys.stderr.write("\r\x1b[K")
            sys.stderr.flush()

    def update(self, fraction: float) -> None:
        """Say that ``fraction`` of the work (0 to 1) is done."""
        elapsed = time.monotonic() - self._start
        if not self._terminal or elapsed < PATIENCE:
            return
        filled = int(30 * fraction)
        left = f"{elapsed / fraction - elapsed:.0f} s left" if fraction > 0 else ""
        sys.stderr.write(f"\r\x1b[K{self.label} [{'#' * filled}{'.' * (30 - filled)}] {left}")
        sys.stderr.flush()
        self._shown = True
