"""The one exception for what a user can put right, and text for its messages."""

from __future__ import annotations


class LightdomeError(Exception):
    """A mistake in the input or the machine, told in one line that says what to do.

    Scripts print it without a traceback and exit with status 1. Everything else that is
    raised is a defect of lightdome and keeps its traceback.
    """


def shown(text: object) -> str:
    """Text that prints on one line: characters that do not print, or move the cursor, are escaped as in Python."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in str(text))


def exactly(value: float) -> str:
    """The shortest text that reads back as the same number."""
    return repr(float(value)).removesuffix(".0")


def quoted(text: str) -> str:
    """Text from a user or a file, in quotes, printable and not too long."""
    return shown(repr(text[:200]))[:202]


def one_line(message: object) -> str:
    """Another library's message for use in a :class:`LightdomeError`: its first line, printable and not too long."""
    lines = str(message).strip().splitlines() or ["no reason given"]
    return shown(lines[0][:200])[:200]
