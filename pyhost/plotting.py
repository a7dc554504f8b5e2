"""Matplotlib for plots in files, whatever backend and settings the environment asks for, and the plots' colours.

Import it before matplotlib.
"""

from __future__ import annotations

import contextlib
import logging
import os
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from .errors import LightdomeError, one_line, shown
from .files import replacing

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Okabe and Ito's colours, told apart by colour-blind readers; markers tell them apart in grey.
BLACK, BLUE, VERMILLION = "#000000", "#0072B2", "#D55E00"
COLOURS = [BLUE, VERMILLION, "#009E73", "#CC79A7", "#E69F00", "#56B4E9", BLACK, "#999933"]
MARKERS = ["o", "s", "^", "D", "v", "P", "X", "*", "<", ">", "h", "p"]
SVG = {"svg.hashsalt": "lightdome"}  # without a fixed salt the file would differ from run to run
UNDATED = {".png": {"Software": None}, ".svg": {"Date": None}}


def _import() -> None:
    """Import matplotlib, even if ``MPLBACKEND`` names a backend that is not installed, as Jupyter leaves behind."""
    backend = os.environ.pop("MPLBACKEND", None)
    log = logging.getLogger("matplotlib")
    level = log.level
    # It would warn about settings that are not used here, and about a folder that it can do without.
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
            matplotlib.rcParams["backend"] = backend  # as matplotlib itself would have done


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


def save_figure(figure: Figure, path: Path, dpi: int = 150, **settings: object) -> None:
    """Write ``figure`` as the suffix of ``path`` says, drawn with ``settings``; the same figure gives the same bytes.

    Raises :class:`LightdomeError` if the file cannot be written.
    """
    with replacing(path) as temporary, plain(**SVG, **settings):
        figure.savefig(temporary, dpi=dpi, metadata=UNDATED.get(path.suffix))
