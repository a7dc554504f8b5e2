"""Open files with OpenImageIO, and report what it says went wrong."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import OpenImageIO as oiio

from ..errors import one_line
from ..files import utf8_name


def open_input(path: Path) -> oiio.ImageInput | None:
    """An open file, or None if OpenImageIO cannot open it. Raises :class:`LightdomeError` if its name is not UTF-8."""
    return oiio.ImageInput.open(utf8_name(path))


def reason(geterror: Callable[[], str]) -> str:
    """One line of OpenImageIO's message, which may quote arbitrary bytes of a damaged file."""
    try:
        return one_line(geterror())
    except UnicodeDecodeError as error:
        return one_line(error.object.decode("utf-8", "replace"))
