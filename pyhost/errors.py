"""The one exception for what a user can put right, and helpers for the text of its messages."""

from __future__ import annotations


class LightdomeError(Exception):
    """A problem with the input or the machine, described in one line that says what to do.

    Scripts print it without a traceback and exit with status 1. Any other exception is a defect of lightdome and keeps
    its traceback.
    """


def shown(text: object) -> str:
    """Text on one line: unprintable characters, and those that move the cursor, are escaped as in Python."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in str(text))


def exactly(value: float) -> str:
    """The shortest text that reads back as the same number."""
    return repr(float(value)).removesuffix(".0")


def quoted(text: str) -> str:
    """Text from a user or a file, in quotes, printable and not too long."""
    return shown(repr(text[:200]))[:202]


def one_line(message: object) -> str:
    """The first line of another library's message, printable and not too long, for a :class:`LightdomeError`."""
    lines = str(message).strip().splitlines() or ["no reason given"]
    return shown(lines[0][:200])[:200]
