"""Opening files with OpenImageIO, and what it says went wrong."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import OpenImageIO as oiio

from ..errors import one_line
from ..files import utf8_name


def open_input(path: Path) -> oiio.ImageInput | None:
    """A file that is open, or None if OpenImageIO cannot. Raises :class:`LightdomeError` for a name in other bytes."""
    return oiio.ImageInput.open(utf8_name(path))


def reason(geterror: Callable[[], str]) -> str:
    """One line of what it says; it quotes damaged files as they are, in bytes that may be no text."""
    try:
        return one_line(geterror())
    except UnicodeDecodeError as error:
        return one_line(error.object.decode("utf-8", "replace"))
