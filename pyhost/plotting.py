"""Matplotlib for plots in files, independent of the user's backend and settings; the plots' colours.

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

# Okabe and Ito's colours, which colour-blind readers can tell apart; in grey, the markers differ.
BLACK, BLUE, VERMILLION = "#000000", "#0072B2", "#D55E00"
COLOURS = [BLUE, VERMILLION, "#009E73", "#CC79A7", "#E69F00", "#56B4E9", BLACK, "#999933"]
MARKERS = ["o", "s", "^", "D", "v", "P", "X", "*", "<", ">", "h", "p"]
SVG = {"svg.hashsalt": "lightdome"}  # without a fixed salt the file would differ from run to run
UNDATED = {".png": {"Software": None}, ".svg": {"Date": None}}


def _import() -> None:
    """Import matplotlib even if ``MPLBACKEND``, which Jupyter sets, names a backend that is not installed."""
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
            f"matplotlib does not start ({one_line(error)}); fix or remove its matplotlibrc file, or set"
            " MPLCONFIGDIR to a writable folder"
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
    """Use matplotlib's defaults and ``settings``, not the user's: as a ``with`` block or a decorator."""
    with matplotlib.style.context(["default", settings]), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph")  # a file's name may have characters that the font lacks
        yield


def text(label: str) -> str:
    """``label``, perhaps a file's name, for matplotlib to draw as it is: no mathematics, no control characters."""
    return shown(label).replace("$", r"\$")


def save_figure(figure: Figure, path: Path, dpi: int = 150, **settings: object) -> None:
    """Write ``figure`` in the format of ``path``'s suffix; the same figure always gives the same bytes.

    Raises :class:`LightdomeError` if the file cannot be written.
    """
    with replacing(path) as temporary, plain(**SVG, **settings):
        figure.savefig(temporary, dpi=dpi, metadata=UNDATED.get(path.suffix))
