"""Check another program's results against exact ones, and name the mistake if they are wrong."""

from __future__ import annotations

import contextlib
import json
import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import LightdomeError, shown
from ..files import replacing
from . import cli

if TYPE_CHECKING:
    from ..checking.causes import Finding
    from ..checking.image import ImageCheck
    from ..checking.tables import TableCheck


@dataclass(frozen=True)
class Found:
    """What a check found: whether the file agrees, None if that cannot be told; lines of text, verdict first; JSON."""

    agrees: bool | None
    lines: list[str]
    values: dict[str, object]


def image_arguments(parser: ArgumentParser) -> None:
    cli.map_options(parser)
    number = parser.add_mutually_exclusive_group()
    number.add_argument(
        "--samples", type=cli.positive_int, metavar="N", help="number of samples, if all pixels share them"
    )
    number.add_argument(
        "--spp", type=cli.positive_int, metavar="N", help="number of samples per pixel, if each has fresh ones"
    )
    parser.add_argument(
        "--albedo",
        type=cli.non_negative_float,
        default=1.0,
        metavar="RHO",
        help="share of light that the sphere reflects",
    )
    parser.add_argument(
        "--gamma", type=cli.positive_float, default=2.2, help="gamma with which a .png or .ppm file was encoded"
    )
    cli.device_option(parser)


def image(args: Namespace) -> Found:
    from ..checking.files import read_rendered
    from ..checking.image import check_image

    pixels, linear = read_rendered(args.file, args.gamma)
    envmap = cli.load_map(args)
    device = cli.open_device(args)
    check = check_image(device, pixels, envmap, samples=args.samples, spp=args.spp, albedo=args.albedo, linear=linear)
    if args.out:
        from ..checking.plot import error_map
        from ..plotting import save_figure

        save_figure(error_map(check, args.file.name), args.out / f"{args.file.stem}_check.png")
    return Found(check.agrees, list(image_lines(check)), check.to_dict())


def image_lines(check: ImageCheck) -> Iterator[str]:
    """The result as text, verdict first."""
    yield check.verdict
    for label, text in _explanations(check):
        yield _line(label, text)
    yield _line("relative RMSE", f"{check.relative_rmse:.2%}")
    if check.expected:
        e = check.expected
        per = "samples per pixel" if e.per_pixel else "samples"
        yield _line(
            "expected", f"{e.mean:.2%}; from {e.low:.2%} to {e.high:.2%} in nine of ten images of {e.count} {per}"
        )
    yield _line("off by", f"{check.deviations:.1f} standard deviations")
    yield _line("by channel", "red {:+.2%}, green {:+.2%}, blue {:+.2%}".format(*check.bias))
    yield _line("factors", "red {:.4g}, green {:.4g}, blue {:.4g}".format(*check.factor))
    if check.orientation:
        yield _line("orientation", check.orientation)
    height, width = check.file_shape
    x, y, radius = check.disc
    if (x, y, radius) != (width / 2, height / 2, min(height, width) / 2):
        yield _line("sphere", f"centre {x:.1f}, {y:.1f}, radius {radius:.1f} pixels of {width} x {height}")
    x, y = check.largest_at
    yield _line("largest error", f"{check.largest_error:.4g} (radiance) at pixel x = {x}, y = {y} of the sphere")


def _explanations(check: Finding) -> Iterator[tuple[str, str]]:
    """How each of the causes is seen, and where in the code to look for it."""
    for cause in check.causes:
        of = f"{cause.name}: " if len(check.causes) > 1 else ""
        yield "seen", of + cause.seen
        yield "look", of + cause.where


def _line(label: str, text: str) -> str:
    return f"  {label:<14} {text}"


def samples(args: Namespace) -> Found:
    from ..checking.samples import check_samples, read_samples

    return _of_table(check_samples(cli.load_map(args), *read_samples(args.file)))


def pdf_arguments(parser: ArgumentParser) -> None:
    cli.map_options(parser)
    parser.add_argument(
        "--per",
        choices=["either", "steradian", "pixel"],
        default="either",
        help="what an image must hold: densities per steradian, probabilities of pixels, or either",
    )


def pdf(args: Namespace) -> Found:
    from ..checking.pdf import check_pdf, read_pdf

    values, direction = read_pdf(args.file)
    return _of_table(check_pdf(cli.load_map(args), values, direction, args.per))


def lights_arguments(parser: ArgumentParser) -> None:
    cli.map_options(parser)
    cli.device_option(parser)


def lights(args: Namespace) -> Found:
    from ..checking.lights import check_lights, read_lights

    direction, flux = read_lights(args.file)
    envmap = cli.load_map(args)
    return _of_table(check_lights(cli.open_device(args), envmap, direction, flux))


def fresnel_arguments(parser: ArgumentParser) -> None:
    parser.add_argument(
        "--eta",
        type=cli.positive_float,
        default=1.4,
        metavar="N",
        help="refractive index of the material, which is surrounded by air",
    )
    parser.add_argument("--leaving", action="store_true", help="the light leaves the material instead of entering it")


def fresnel(args: Namespace) -> Found:
    from ..checking.fresnel import check_fresnel, read_curves

    theta, curves = read_curves(args.file)
    return _of_table(check_fresnel(theta, *curves, eta=args.eta, leaving=args.leaving))


def folder_arguments(parser: ArgumentParser) -> None:
    cli.map_options(parser)
    fresnel_arguments(parser)
    cli.device_option(parser)


def folder(args: Namespace) -> Found:
    from ..checking.folder import COLUMNS, FolderCheck, page
    from ..files import write_table

    if args.out is None:
        raise LightdomeError("the table and the page need a folder: give --out DIR")
    envmap = cli.load_map(args)
    rows = FolderCheck(cli.open_device(args), envmap, args.eta, args.leaving).rows(args.file)
    name = args.file.resolve().name
    write_table(args.out / f"{name}_check.csv", COLUMNS, (row.values for row in rows))
    with replacing(args.out / f"{name}_check.html") as path:
        path.write_text(page(rows, f"{name}: {len(rows)} files"), encoding="utf-8", errors="backslashreplace")
    agrees = [row.agrees for row in rows]
    found = False if False in agrees else None if None in agrees else True
    width = max(len(row.file) for row in rows)
    lines = [f"{agrees.count(True)} of {len(rows)} files agree", *(f"  {r.file:<{width}}  {r.verdict}" for r in rows)]
    return Found(found, lines, {"agrees": found, "files": [dict(zip(COLUMNS, r.values, strict=True)) for r in rows]})


def _of_table(check: TableCheck) -> Found:
    rows = list(_explanations(check))
    rows += [("orientation", check.orientation)] if check.orientation else []
    rows += [(name.replace("_", " "), _shown(value)) for name, value in check.details.items()]
    width = max(len(name) for name, _ in rows)
    return Found(check.agrees, [check.verdict, *(f"  {n:<{width}}  {v}" for n, v in rows)], check.to_dict())


def _shown(value: object) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{name} {_shown(item)}" for name, item in value.items()) or "-"
    if isinstance(value, float):
        return f"{value:.4g}"
    return " ".join(map(_shown, value)) if hasattr(value, "__iter__") and not isinstance(value, str) else str(value)


@dataclass(frozen=True)
class Kind:
    """A kind of file: what it is, the arguments of an example, its options, and its check."""

    purpose: str
    example: str
    arguments: Callable[[ArgumentParser], None]
    check: Callable[[Namespace], Found]


KINDS = {
    "image": Kind(
        "an image of the diffuse sphere lit by a map",
        "image sphere.pfm --map map.exr --samples 1024",
        image_arguments,
        image,
    ),
    "samples": Kind(
        "samples of a map, as .npz or .csv: directions, radiance, probabilities and pixels",
        "samples samples_1024.npz --map map.exr",
        cli.map_options,
        samples,
    ),
    "pdf": Kind(
        "probabilities or densities of a map's pixels, as an image, or densities by direction, as .npz or .csv",
        "pdf pdf.pfm --map map.exr",
        pdf_arguments,
        pdf,
    ),
    "lights": Kind(
        "directional lights that stand for a map, as .csv or .npz",
        "lights lights.csv --map map.exr",
        lights_arguments,
        lights,
    ),
    "fresnel": Kind(
        "reflectances of a dielectric by angle, as .csv or .npz",
        "fresnel curve.csv --eta 1.4 --leaving",
        fresnel_arguments,
        fresnel,
    ),
    "folder": Kind(
        "a folder of such files, such as a class's hand-ins; writes a table and a page with pictures",
        "folder hand-ins --map map.exr --out out",
        folder_arguments,
        folder,
    ),
}


def main() -> None:
    parser = cli.parser(
        "Say whether another program's result agrees with the exact one, and if not, what went wrong.\n\n"
        "The exit status is 0 if it agrees, 1 if it does not, and 2 if that cannot be told.",
        KINDS["image"].example,
    )
    kinds = parser.add_subparsers(dest="kind", metavar="KIND", required=True, help="what is in the file:")
    for name, kind in KINDS.items():
        of_kind = kinds.add_parser(
            name,
            help=kind.purpose,
            description=f"Check {kind.purpose}.",
            epilog=f"example: {cli.program()} {kind.example}",
            formatter_class=parser.formatter_class,
        )
        metavar = "DIR" if name == "folder" else "FILE"
        of_kind.add_argument("file", type=Path, metavar=metavar, help=kind.purpose)
        kind.arguments(of_kind)
        of_kind.add_argument(
            "--out", type=Path, metavar="DIR", help="folder for NAME_check.json, and for a picture of an image"
        )
        of_kind.add_argument("--json", action="store_true", help="print a JSON object instead of text")
    args = parser.parse_args()
    try:
        with contextlib.redirect_stdout(sys.stderr):  # keep standard output for the result
            if args.out:
                cli.output_folder(args.out, images=True)
            found = KINDS[args.kind].check(args)
    except LightdomeError as error:
        print(f"{Path(sys.argv[0]).stem}: {shown(error)}", file=sys.stderr)
        sys.exit(2)
    text = json.dumps({"file": str(args.file), **found.values}, indent=2, allow_nan=False)
    if args.out:
        with replacing(args.out / f"{args.file.resolve().stem}_check.json") as path:
            path.write_text(text + "\n", encoding="utf-8")
    print(text if args.json else "\n".join(found.lines))
    sys.exit({True: 0, False: 1, None: 2}[found.agrees])
