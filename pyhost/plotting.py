"""Matplotlib for plots in files, whatever backend and settings the environment asks for. Import before matplotlib."""

from __future__ import annotations

import contextlib
import logging
import os
import warnings
from collections.abc import Iterator

from .errors import LightdomeError, one_line, shown


def _import() -> None:
    """Import matplotlib, even if ``MPLBACKEND`` names a backend that is not installed, as Jupyter leaves behind."""
    backend = os.environ.pop("MPLBACKEND", None)
    log = logging.getLogger("matplotlib")
    level = log.level
    # It would warn of settings that are not used here, and of a folder that it can do without.
    log.setLevel(logging.ERROR)
    try:
        import matplotlib
        import matplotlib.style
    except (OSError, ValueError) as error:
        raise LightdomeError(
            f"matplotlib does not start ({one_line(error)}); fix or remove the file matplotlibrc that it reads, or set"
            " MPLCONFIGDIR to a folder that can be written"
        ) from error
    finally:
        log.setLevel(level)
        if backend is not None:
            os.environ["MPLBACKEND"] = backend
    if backend:
        with contextlib.suppress(ValueError):
            matplotlib.rcParams["backend"] = backend  # as it had done itself


_import()
import matplotlib.style  # noqa: E402


@contextlib.contextmanager
def plain(**settings: object) -> Iterator[None]:
    """Matplotlib's own look and ``settings``, whatever the user's settings: for a block, or as a decorator."""
    with matplotlib.style.context(["default", settings]), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph")  # a name in characters that the font lacks
        yield


def text(label: str) -> str:
    """``label``, which may be a file's name, as matplotlib should draw it: no mathematics, no control characters."""
    return shown(label).replace("$", r"\$")
