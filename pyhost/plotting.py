"""Matplotlib for files: the same whatever the environment and its settings ask for. Import it before matplotlib."""

from __future__ import annotations

import contextlib
import logging
import os
import warnings
from collections.abc import Iterator

from .errors import LightdomeError, one_line, shown


def _import() -> None:
    """Import matplotlib, also where ``MPLBACKEND`` is a backend that is not there: Jupyter leaves one behind."""
    backend = os.environ.pop("MPLBACKEND", None)
    log = logging.getLogger("matplotlib")
    level = log.level
    log.setLevel(
        logging.ERROR
    )  # it would tell of settings that are not used here, and of a folder that it can do without
    try:
        import matplotlib
        import matplotlib.style
    except (OSError, ValueError) as error:
        raise LightdomeError(
            f"matplotlib does not start ({one_line(error)}); mend or remove the file matplotlibrc that it reads, or set"
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
    """Matplotlib's own look and ``settings``, whatever the user's are: for a block, or as a decorator."""
    with matplotlib.style.context(["default", settings]), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph")  # a name in a script that the font has not
        yield


def text(label: str) -> str:
    """``label``, which may be a file's name, as matplotlib draws it: no mathematics, no control characters."""
    return shown(label).replace("$", r"\$")
