"""The columns of a catalog: names, types and units. Those of ``lightdome info`` come from its own dataclass."""

from __future__ import annotations

import re
import typing
from collections.abc import Iterator
from dataclasses import dataclass, fields, is_dataclass
from typing import Any, get_args, get_type_hints

from ..maps.analysis import Analysis

if typing.TYPE_CHECKING:
    from .row import Options

RADIANCE_SR = "map radiance x steradian"
# A column has the unit of the first pattern found in its name.
UNITS = {
    r"_radiance_sr": RADIANCE_SR,
    r"^harmonics_\d": "map radiance x steradian^(1/2)",
    r"^lights$": f"to_light_*: unit vector towards the light, +y is up; flux_*: {RADIANCE_SR}",
    r"_degrees": "degree; azimuth from +x towards +z, elevation from the horizon, +y is up",
    r"^seconds_": "second",
    r"_bytes$": "byte",
    r"range_stops": "stop: log2 of a ratio",
    r"^(luminance|mean_radiance|clipping_maximum)_": "map radiance",
    r"direction|share|rmse": "1",
    r"_pixels?(_|$)|pixels_at|pairs": "pixel",
}


@dataclass(frozen=True)
class Column:
    """One column: ``kind`` is str, int, float, bool or list (of lights)."""

    name: str
    kind: type

    @property
    def unit(self) -> str | None:
        """The unit of its numbers; None for text, and for counts without a unit."""
        if self.kind in (str, bool):
            return None
        return next((unit for pattern, unit in UNITS.items() if re.search(pattern, self.name)), None)


def columns(options: Options) -> list[Column]:
    """The columns of a table made with these options, in order."""
    result = [Column("path", str), Column("status", str), Column("error", str)]
    result += [Column("sha256", str), Column("size_bytes", int)]
    result += [Column(name, kind) for name, kind, _ in _flat(Analysis)]
    if options.lights:
        result += [Column("lights", list), Column("lights_relative_rmse", float)]
    if options.harmonics is not None:
        result += [Column(name, float) for name in harmonic_names(options.harmonics)]
        result += [Column("harmonics_relative_rmse", float)]
    for name in options.files:
        result.append(Column(f"{name}_file", str))
    result += [Column(f"seconds_{stage}", float) for stage in options.stages]
    return [*result, Column("device", str), Column("version", str)]


def harmonic_names(order: int) -> list[str]:
    """The columns of the coefficients L_lm, each in red, green and blue; the number is l^2 + l + m."""
    return [f"harmonics_{n}_{channel}" for n in range((order + 1) ** 2) for channel in ("red", "green", "blue")]


def of_analysis(analysis: Analysis) -> dict[str, Any]:
    """The values of an analysis by column name."""
    return {name: value for name, _, value in _flat(Analysis, analysis)}


def _flat(of: type, value: Any = None, prefix: str = "") -> Iterator[tuple[str, type, Any]]:
    """Name, type and value of each field of a dataclass; nested dataclasses and vectors are split up."""
    hints = get_type_hints(of)
    for field in fields(of):
        kinds = [kind for kind in (get_args(hints[field.name]) or ()) if kind is not type(None)]
        is_tuple = typing.get_origin(hints[field.name]) is tuple
        kind: Any = hints[field.name] if is_tuple or not kinds else kinds[0]
        own, name = getattr(value, field.name, None), f"{prefix}{field.name}"
        if is_dataclass(kind):
            yield from _flat(typing.cast(type, kind), own, f"{name}_")
        elif is_tuple and Ellipsis in get_args(kind):
            yield name, str, "; ".join(own) or None if own is not None else None
        elif is_tuple:
            letters = ("x", "y", "z") if "xyz" in name else ("red", "green", "blue")
            for n, letter in enumerate(letters):
                yield re.sub("xyz|rgb", letter, name), get_args(kind)[0], None if own is None else own[n]
        else:
            yield name, kind, own
