"""Writes the page for browsing a catalog offline: a plot, and a table to sort and filter."""

from __future__ import annotations

import json
from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path
from typing import Any

from ..files import replacing
from .row import Options
from .table import Rows

# For each column: its key on the page, the catalog's column, heading, width, number of decimals and tooltip. A column
# without a width is hidden; decimals below 0 mean a whole number.
NUMBERS = (
    ("width", "width_pixels", "width", "4.5rem", -1, "columns of pixels"),
    ("range", "range_stops", "stops", "5rem", 1, "log2 of largest over smallest luminance, ignoring the darkest 1 %"),
    ("concentration", "mean_direction_length", "concen-tration", "5.5rem", 2,
     "0: light from all directions, 1: from a single one"),
    ("elevation", "sun_elevation_degrees", "sun at", "5rem", 1, "elevation of the sun in degrees"),
    ("share", "sun_flux_share", "sun's share", "5rem", 3, "the sun's share of the light"),
    ("lights", "lights_relative_rmse", "lights' error", "5.5rem", 4, "relative RMSE of a sphere lit by the lights"),
    ("harmonics", "harmonics_relative_rmse", "harmonics' error", "7rem", 4,
     "relative RMSE of a sphere lit by the harmonics"),
    ("samples", "samples_for_1_percent_error", "samples for 1 %", "6rem", -1, "independent samples for 1 % error"),
)  # fmt: skip


def write_page(path: Path, options: Options, rows: Rows) -> None:
    """Write the page, one row at a time."""
    shown = list(_columns(options))
    names = [name for _, name in shown]
    before, _, rest = files(__package__).joinpath("page.html").read_text(encoding="utf-8").partition("COLUMNS")
    between, _, after = rest.partition("ROWS")
    with replacing(path) as temporary, temporary.open("w", encoding="utf-8") as file:
        file.write(before + _json([column for column, _ in shown]) + between + "[")
        for n, row in enumerate(rows()):
            file.write((",\n" if n else "") + _json([row.get(name) for name in names]))
        file.write("]" + after)


def _columns(options: Options) -> Iterator[tuple[dict[str, Any], str]]:
    """Each column of the page, with the name of the catalog's column."""
    width = "var(--pictures)" if options.thumbnails else None
    yield {"key": "thumbnail", "label": "picture", "width": width}, "thumbnail_file"
    yield {"key": "sphere"}, "sphere_file"
    yield {"key": "error"}, "error"
    yield {"key": "path", "label": "map", "width": "minmax(12rem, 1fr)"}, "path"
    yield {"key": "status", "label": "status", "width": "5.5rem"}, "status"
    yield {"key": "format", "label": "format", "width": "6.5rem"}, "format"
    yield {"key": "clipping", "label": "clipping", "width": "8.2rem"}, "clipping_verdict"
    for key, name, label, width, digits, about in NUMBERS:
        column = {"key": key, "label": label, "kind": "number", "width": width, "digits": digits, "about": about}
        asked = {"lights": options.lights, "harmonics": options.harmonics is not None}.get(key, True)
        yield {**column, **({} if asked else {"width": None})}, name


def _json(value: object) -> str:
    """JSON that cannot end a script element."""
    return json.dumps(value, separators=(",", ":"), ensure_ascii=False).replace("<", "\\u003c")
