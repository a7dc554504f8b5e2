"""The one exception that means: the user can mend this."""

from __future__ import annotations


class LightdomeError(Exception):
    """A mistake in the input or the machine, told in one line that says what to do.

    Scripts print it without a traceback and exit with status 1. Everything else that is
    raised is a defect of lightdome and keeps its traceback.
    """


def one_line(message: object) -> str:
    """What another library says, fit for a :class:`LightdomeError`: its first line, printable and not too long."""
    lines = str(message).strip().splitlines() or ["no reason given"]
    return "".join(c if c.isprintable() else "?" for c in lines[0][:200])
