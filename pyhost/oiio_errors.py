"""What OpenImageIO says went wrong."""

from __future__ import annotations

from collections.abc import Callable

from .errors import one_line


def reason(geterror: Callable[[], str]) -> str:
    """One line of it; OpenImageIO quotes damaged files as they are, in bytes that may be no text."""
    try:
        return one_line(geterror())
    except UnicodeDecodeError as error:
        return one_line(error.object.decode("utf-8", "replace"))
