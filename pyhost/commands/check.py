"""Whether another program's results agree with what is known exactly, and if not, what went wrong."""

from __future__ import annotations

import contextlib
import json
import math
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
    from ..evaluation.check_image import ImageCheck


@dataclass(frozen=True)
class Found:
    """What a check found: whether the file ``agrees``, None for cannot tell; as text, verdict first; and for JSON."""

    agrees: bool | None
    lines: list[str]
    values: dict[str, object]


def image_arguments(parser: ArgumentParser) -> None:
    cli.map_options(parser)
    number = parser.add_mutually_exclusive_group()
    number.add_argument(
        "--samples", type=cli.positive_int, metavar="N", help="number of samples that all pixels share, if any do"
    )
    number.add_argument("--spp", type=cli.positive_int, metavar="N", help="number of fresh samples of each pixel")
    parser.add_argument(
        "--albedo", type=cli.non_negative_float, default=1.0, metavar="RHO", help="share of light that is reflected"
    )
    parser.add_argument(
        "--gamma", type=cli.positive_float, default=2.2, help="gamma that a .png or .ppm was written with"
    )
    cli.device_option(parser)


def image(args: Namespace) -> Found:
    from ..evaluation.check_files import read_rendered
    from ..evaluation.check_image import check_image

    pixels, linear = read_rendered(args.file, args.gamma)
    envmap = cli.load_map(args)
    device = cli.open_device(args)
    check = check_image(device, pixels, envmap, samples=args.samples, spp=args.spp, albedo=args.albedo, linear=linear)
    if args.out:
        from ..evaluation.check_plot import error_map
        from ..plotting import save_figure

        save_figure(error_map(check, args.file.name), args.out / f"{args.file.stem}_check.png")
    return Found(check.agrees, list(image_lines(check)), check.to_dict())


def image_lines(check: ImageCheck) -> Iterator[str]:
    """The check for people, verdict first."""
    yield check.verdict
    if check.cause:
        yield _line("seen", check.cause.seen)
        yield _line("where", check.cause.where)
    yield from check.notes
    yield _line("relative RMSE", f"{check.relative_rmse:.2%}")
    if check.expected:
        e = check.expected
        per = "samples per pixel" if e.per_pixel else "samples"
        yield _line("expected", f"{e.mean:.2%}, nine of ten images of {e.count} {per} from {e.low:.2%} to {e.high:.2%}")
    if not math.isnan(check.deviations):
        yield _line("bias", f"{check.deviations:.1f} standard deviations")
    yield _line("by channel", "red {:+.2%}, green {:+.2%}, blue {:+.2%}".format(*check.bias))
    yield _line("factors", "red {:.4g}, green {:.4g}, blue {:.4g}".format(*check.factor))
    if check.orientation:
        yield _line("orientation", check.orientation)
    height, width = check.file_shape
    x, y, radius = check.disc
    if (x, y, radius) != (width / 2, height / 2, min(height, width) / 2):
        yield _line("sphere", f"centre {x:.1f}, {y:.1f}, radius {radius:.1f} pixels of {width} x {height}")
    x, y = check.largest_at
    yield _line("largest error", f"{check.largest_error:.4g}, radiance, in pixel x = {x}, y = {y} of the sphere")


def _line(label: str, text: str) -> str:
    return f"  {label:<14} {text}"


@dataclass(frozen=True)
class Kind:
    """A kind of file: its purpose in a line, the arguments of an example, its options, and the check itself."""

    purpose: str
    example: str
    arguments: Callable[[ArgumentParser], None]
    check: Callable[[Namespace], Found]


KINDS = {
    "image": Kind(
        "an image of the diffuse sphere under a map",
        "image sphere.pfm --map map.exr --samples 1024",
        image_arguments,
        image,
    ),
}


def main() -> None:
    parser = cli.parser(
        "Say whether another program's result agrees with what is known exactly, and if not, what went wrong.\n\n"
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
        of_kind.add_argument("file", type=Path, metavar="FILE", help=kind.purpose)
        kind.arguments(of_kind)
        of_kind.add_argument(
            "--out", type=Path, metavar="DIR", help="folder to write NAME_check.json, and a picture if there is one"
        )
        of_kind.add_argument("--json", action="store_true", help="print a JSON object, and no text")
    args = parser.parse_args()
    try:
        with contextlib.redirect_stdout(sys.stderr):  # standard output has the verdict first
            if args.out:
                cli.output_folder(args.out, images=True)
            found = KINDS[args.kind].check(args)
    except LightdomeError as error:
        print(f"{Path(sys.argv[0]).stem}: {shown(error)}", file=sys.stderr)
        sys.exit(2)
    text = json.dumps({"file": str(args.file), **found.values}, indent=2, allow_nan=False)
    if args.out:
        with replacing(args.out / f"{args.file.stem}_check.json") as path:
            path.write_text(text + "\n", encoding="utf-8")
    print(text if args.json else "\n".join(found.lines))
    sys.exit({True: 0, False: 1, None: 2}[found.agrees])
