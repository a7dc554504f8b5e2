"""Write a map in another projection, or for another program."""

from __future__ import annotations

import sys
from pathlib import Path

from ..names import CONVENTIONS, PROJECTIONS
from . import cli


def main() -> None:
    parser = cli.parser(
        "Write an environment map in another projection, or for another program.\n\n"
        "Each pixel of the result is the mean of the map over its area. This keeps the flux, and the place and energy"
        " of lights smaller than a pixel. The documentation shows which way each projection looks.",
        "map.exr probe.exr --to angular",
    )
    cli.map_options(parser, positional=True)
    parser.add_argument("out", type=Path, metavar="OUT", help="file to write: .exr or .pfm, in single precision")
    parser.add_argument(
        "--to",
        choices=PROJECTIONS,
        required=True,
        metavar="NAME",
        help="projection of the result, out of the names of --projection",
    )
    parser.add_argument(
        "--size",
        type=cli.positive_int,
        metavar="N",
        help="side of a square or cube face, or rows of a latlong (default: about as many pixels as the map has)",
    )
    parser.add_argument(
        "--to-convention",
        choices=CONVENTIONS,
        default=CONVENTIONS[0],
        metavar="NAME",
        help=f"program that will read a latlong result: {', '.join(CONVENTIONS)}",
    )
    args = parser.parse_args()
    if args.to_convention != CONVENTIONS[0] and args.to != "latlong":
        parser.error("--to-convention works only with --to latlong")

    import numpy as np

    from ..errors import LightdomeError
    from ..maps.conventions import yaw_between
    from ..maps.conversion import convert
    from ..maps.envmap import EnvironmentMap, read_projected, shape_note
    from ..maps.images import LINEAR, write_image
    from ..maps.rotation import rotation_matrix

    if args.out.suffix.lower() not in LINEAR:
        raise LightdomeError(f"cannot write {args.out}: choose a name that ends in {' or '.join(LINEAR)}")
    if args.to == "cube-openexr" and args.out.suffix.lower() != ".exr":
        raise LightdomeError(
            f"cannot write {args.out}: only an .exr file can say in its header that it is cube-openexr;"
            " choose that suffix, or write a cube-strip"
        )
    cli.output_file(args.out)
    read = read_projected(
        args.map,
        sanitize=args.sanitize,
        layer=args.layer,
        flip=args.flip,
        projection=args.projection,
        convention=args.convention,
    )
    stretched = read.projection == "latlong" and shape_note(*read.radiance.shape[:2])
    for note in (*read.notes, stretched, read.replaced and read.replaced.note):
        if note:
            print(note, file=sys.stderr)
    if read.projection == args.to == "latlong" and args.size is None:
        # A turn by whole columns leaves its pixels as they are.
        envmap = EnvironmentMap(read.radiance).to_convention(CONVENTIONS[0], from_=args.convention)
        image = cli.turned(args, envmap).to_convention(args.to_convention).radiance
    else:
        turns = [
            rotation_matrix(yaw_between(CONVENTIONS[0], args.to_convention)),
            rotation_matrix(*args.rotate or [0.0]),
            np.diag([1, 1, -1 if args.mirror else 1]),
            rotation_matrix(yaw_between(args.convention, CONVENTIONS[0])),
        ]
        image = convert(read.radiance, read.projection, args.to, args.size, np.linalg.multi_dot(turns))
    write_image(args.out, image, is_cube=args.to == "cube-openexr")
    height, width = read.radiance.shape[:2]
    print(f"map: {args.map}, {width} x {height}, {read.projection}")
    print(f"wrote {args.out}, {image.shape[1]} x {image.shape[0]}, {args.to}")
