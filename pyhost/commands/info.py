"""What is in a map: whether it is clipped, its sun, its range, where its light comes from."""

from __future__ import annotations

import json
import sys
from argparse import Namespace
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import LightdomeError, shown
from . import cli

if TYPE_CHECKING:
    from ..maps.analysis import Analysis
    from ..maps.sun import Sun

SIDES = {
    "up (+y)": "up",
    "down (-y)": "down",
    "+x": "plus_x",
    "-x": "minus_x",
    "+z": "plus_z",
    "-z": "minus_z",
}


def main() -> None:
    parser = cli.parser(
        "Say what is in a map: whether it is clipped, where its sun is, its range, and where its light comes from.\n\n"
        "Maps are read in bands and may be larger than memory. Bad pixels are counted, not refused. Radiance is in the"
        " map's own unit, flux and irradiance in that unit x steradian. Azimuth runs from +x towards +z; +y is up.",
        "data/default.exr --json",
    )
    parser.add_argument("maps", type=Path, nargs="+", metavar="MAP", help="environment maps: .exr, .hdr or .pfm")
    parser.add_argument("--layer", metavar="NAME", help="layer or part of an .exr file that is the map")
    parser.add_argument("--flip", action="store_true", help="reverse the rows, for a file that was written upside down")
    cli.projection_option(parser)
    cli.orientation_options(parser)
    parser.add_argument(
        "--json", action="store_true", help="print a JSON object, or a list of them for several maps, instead of text"
    )
    parser.add_argument(
        "--split-sun",
        type=Path,
        metavar="DIR",
        help="split each map into NAME_sun.exr and NAME_rest.exr in this folder; the two sum to the map",
    )
    args = parser.parse_args()
    if args.split_sun:
        if len({path.stem for path in args.maps}) < len(args.maps):
            raise LightdomeError("--split-sun needs maps of different names; split those of one name separately")
        cli.output_folder(args.split_sun, images=True)

    found, failed = [], False
    for path in args.maps:
        try:
            analysis = examine(args, path)
            found.append({"file": str(path), **analysis.to_dict()})
            if not args.json:
                print("\n".join(([""] if len(found) > 1 else []) + list(lines(path, analysis))))
            if args.split_sun:
                write_split(args, path)
        except LightdomeError as error:  # the other maps are still read
            print(f"{Path(sys.argv[0]).stem}: {shown(error)}", file=sys.stderr)
            failed = True
    if args.json and (found or len(args.maps) > 1):
        print(json.dumps(found[0] if len(args.maps) == 1 else found, indent=2, allow_nan=False))
    if failed:
        sys.exit(1)


def examine(args: Namespace, path: Path) -> Analysis:
    """The analysis of a file, in bands; if it is not a latlong, of the map that it is resampled to."""
    from ..maps.analysis import analyse, analyse_resampled
    from ..maps.conversion import convert
    from ..maps.envmap import EnvironmentMap, read_projected
    from ..maps.images import ImageRows

    image = ImageRows(path, layer=args.layer, flip=args.flip)
    notes: tuple[str, ...] = ()
    if args.projection != "latlong" and (args.projection or image.is_cube or image.width != 2 * image.height):
        read = read_projected(
            path,
            sanitize="clamp",
            layer=args.layer,
            flip=args.flip,
            projection=args.projection,
            convention=args.convention,
        )
        if read.projection != "latlong":
            return analyse_resampled(read, cli.turned(args, EnvironmentMap(convert(read.radiance, read.projection))))
        notes = read.notes
    image.reorder(cli.map_columns(args, image.width, f", or turn it first with {cli.program('convert')}"))
    analysis = analyse(image)
    return replace(analysis, notes=tuple(dict.fromkeys((*notes, *analysis.notes))))


def write_split(args: Namespace, path: Path) -> None:
    from ..maps.analysis import split_sun
    from ..maps.envmap import EnvironmentMap
    from ..maps.images import write_image

    try:
        envmap = EnvironmentMap.read(
            path, layer=args.layer, flip=args.flip, projection=args.projection, convention=args.convention
        )
        split = split_sun(cli.turned(args, envmap))
    except LightdomeError as error:
        raise LightdomeError(f"{path}: {error}" if str(path) not in str(error) else str(error)) from error
    for name, envmap in ("sun", split.sun_map), ("rest", split.rest):
        out = args.split_sun / f"{path.stem}_{name}.exr"
        write_image(out, envmap.radiance)
        if not args.json:
            print(f"wrote {out}")


def lines(path: Path, analysis: Analysis) -> Iterator[str]:
    """The analysis as text, verdicts first."""
    size = f"{analysis.width_pixels} x {analysis.height_pixels}"
    yield ", ".join(filter(None, (f"{path}: {size}", analysis.format, analysis.projection)))
    clipping = analysis.clipping
    yield _line("clipping", f"{clipping.verdict}: {clipping.reason}")
    yield _line("sun", _sun(analysis.sun) if analysis.sun else f"no sun: {analysis.no_sun_reason}")
    counts = {
        "NaN": analysis.nan_pixels,
        "infinite": analysis.infinite_pixels,
        "negative": analysis.negative_pixels,
    }
    yield _line("bad pixels", ", ".join(f"{n} {kind}" for kind, n in counts.items() if n) or "none")
    for note in analysis.notes:
        yield f"  {note}"

    yield "luminance"
    stops = "" if analysis.range_stops is None else f", {analysis.range_stops:.1f} stops"
    yield _line("range", f"{analysis.luminance_minimum:.4g} to {analysis.luminance_maximum:.4g}{stops}")
    yield _line("median", f"{analysis.luminance_median_by_solid_angle:.4g}, by solid angle, like the next two")
    yield _line("99 %", f"{analysis.luminance_99_percent_by_solid_angle:.4g}")
    yield _line("99.9 %", f"{analysis.luminance_99_9_percent_by_solid_angle:.4g}")
    if analysis.samples_for_1_percent_error is None:
        return

    yield f"light{'red':>18}{'green':>12}{'blue':>12}"
    yield _rgb("mean radiance", analysis.mean_radiance_rgb)
    yield _rgb("flux", analysis.flux_rgb_radiance_sr)
    yield "irradiance of a surface that faces"
    for label, side in SIDES.items():
        yield _rgb(label, getattr(analysis, f"irradiance_{side}_rgb_radiance_sr"))

    yield "concentration"
    azimuth, elevation = analysis.mean_direction_azimuth_degrees, analysis.mean_direction_elevation_degrees
    if azimuth is not None and elevation is not None:
        angles = _angles(azimuth, elevation)
        yield _line("mean towards", f"{angles}, length {analysis.mean_direction_length:.2f} of 1")
    shares = [analysis.flux_share_of_1_pixel, analysis.flux_share_of_10_pixels, analysis.flux_share_of_100_pixels]
    percent = ", ".join(f"{100 * share:.3g} %" for share in shares)
    yield _line("brightest", f"{percent} of the light in 1, 10, 100 pixels; {analysis.effective_pixels:.4g} effective")
    count = analysis.samples_for_1_percent_error
    yield _line("samples", f"{float(f'{count:.2g}'):,.0f} independent ones for 1 % error; other sequences need fewer")


def _line(label: str, text: str) -> str:
    return f"  {label:<13} {text}"


def _rgb(label: str, values: Sequence[float]) -> str:
    return f"  {label:<13} {values[0]:>7.4g}{values[1]:>12.4g}{values[2]:>12.4g}"


def _angles(azimuth: float, elevation: float) -> str:
    return f"azimuth {azimuth:.1f}, elevation {elevation:.1f} degrees"


def _sun(sun: Sun) -> str:
    share = f"radius {sun.angular_radius_degrees:.2f} degrees, {100 * sun.flux_share:.3g} % of the light"
    bound = ", at least: it is clipped" if sun.is_clipped else ""
    irradiance = " ".join(f"{value:.4g}" for value in sun.irradiance_rgb_radiance_sr)
    return f"{_angles(sun.azimuth_degrees, sun.elevation_degrees)}, {share}; irradiance {irradiance}{bound}"
