"""Part 4: the same sphere by Monte Carlo, with fresh samples for every pixel, by PBRT or on an OpenCL device."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import LightdomeError, exactly
from ..names import ESTIMATORS, PIXEL_SEQUENCES, SEED, WITHIN
from . import cli
from . import render_to_error as to_error

if TYPE_CHECKING:
    import numpy as np

    from ..maps.envmap import EnvironmentMap
    from ..opencl.device import Device

    Images = Iterator[tuple[int, np.ndarray]]

SPP = [8, 16, 32, 64]


def _share(text: str) -> float:
    """Argument type: a part of a whole."""
    value = cli.positive_float(text)
    if value >= 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number above 0 and below 1")
    return value


def parse_arguments() -> argparse.Namespace:
    """The command line."""
    parser = cli.parser(
        "Render a diffuse sphere under an environment map with fresh samples for every pixel.\n\n"
        "Writes sphere_Nspp.pfm (linear radiance), sphere_Nspp.ppm and sphere_Nspp.png, or the formats of --format, for"
        " N samples per pixel, and the scenes for PBRT-v3 and PBRT-v4 into the folder pbrt. settings.json records how"
        " the images were made.\n\n"
        "With --error, writes sphere.pfm, .ppm and .png of as many samples as the error needs, error.pfm (the standard"
        " error of each pixel, radiance) and error.png (the same in false colour). settings.json records what was"
        " reached. PBRT is not used.",
        example="--spp 16 64 --seed 1",
        out="out/part4",
    )
    cli.map_options(parser)
    parser.add_argument(
        "--spp",
        type=cli.positive_int,
        nargs="+",
        metavar="N",
        help=f"samples per pixel (default: {' '.join(map(str, SPP))})",
    )
    to_error.options(parser)
    parser.add_argument(
        "--renderer",
        choices=["auto", "pbrt", "opencl"],
        default="auto",
        help="auto: pbrt if it is found, otherwise opencl; opencl too if --estimator, --sequence or --within is given",
    )
    parser.add_argument(
        "--estimator",
        choices=ESTIMATORS,
        help="how a pixel uses its samples (default: light; with --error product)",
    )
    parser.add_argument(
        "--sequence",
        choices=PIXEL_SEQUENCES,
        help="the points that samples are made from (default: independent; with --error lattice)",
    )
    parser.add_argument(
        "--within",
        choices=WITHIN,
        help="where directions lie in a pixel of the map: at its centre, or anywhere in it, uniform over its solid"
        " angle (default: centre; always pixel for bsdf and mis)",
    )
    parser.add_argument(
        "--light-share",
        type=_share,
        metavar="SHARE",
        help="with --estimator mis, the share of a pixel's directions drawn by the light, above 0 and below 1"
        " (default: by the map)",
    )
    parser.add_argument(
        "--pbrt",
        type=Path,
        metavar="PATH",
        help="the program pbrt, pbrt-r4 or pbrt-r3, or its folder (default: from PATH, else a pbrt-r4 in"
        " lightdome's cache)",
    )
    parser.add_argument(
        "--seed", type=cli.seed, default=SEED, help="seed of the samples, a whole number; PBRT-v3 and pbrt-r3 have none"
    )
    cli.sphere_options(parser)
    cli.image_options(parser)
    cli.display_option(parser)
    cli.device_option(parser)
    cli.explain_option(parser)
    args = parser.parse_args()
    to_error.check(parser, args)
    if args.renderer == "opencl" and args.pbrt:
        parser.error("--pbrt is for --renderer pbrt or auto")
    if args.renderer == "pbrt" and args.device:
        parser.error("--device is for --renderer opencl or auto")
    for name in ("estimator", "sequence", "within"):
        if getattr(args, name):
            if args.renderer == "pbrt" or args.pbrt:
                parser.error(f"--{name} is for --renderer opencl")
            args.renderer = "opencl"
    if not args.error:
        args.spp = args.spp or SPP
        args.estimator, args.sequence = args.estimator or "light", args.sequence or "independent"
    if args.within == "centre" and args.estimator and ESTIMATORS[args.estimator].pixels == "areas":
        parser.error(f"--estimator {args.estimator} needs --within pixel")
    if args.light_share and args.estimator != "mis":
        parser.error("--light-share is for --estimator mis")
    if args.albedo > 1 and (args.renderer == "pbrt" or args.pbrt):
        parser.error(f"PBRT's albedo must be from 0 to 1, got {exactly(args.albedo)}; use --renderer opencl")
    return args


def with_opencl(args: argparse.Namespace, envmap: EnvironmentMap, device: Device) -> Images:
    """The images from our own renderer."""
    from ..rendering.per_pixel import render
    from ..sampling.distribution import build_distribution

    distribution = build_distribution(device, envmap)
    cli.explain(args, "the map", device.decisions.take())
    yield from render(
        distribution,
        args.spp,
        args.resolution,
        args.albedo,
        args.seed,
        args.estimator,
        args.sequence,
        within=args.within,
        light_share=args.light_share,
    )
    # An image with more samples continues the one with fewer, so the decisions are those for all.
    cli.explain(args, f"{', '.join(map(str, sorted(set(args.spp))))} spp", device.decisions.take())
    cli.explain_kernels(args, device)


def main() -> None:
    """Write the scenes and the images, and list what was written."""
    args = parse_arguments()
    out = cli.output_folder(args.out, images=True)
    envmap = cli.load_map(args)
    if args.error:
        to_error.run(args, out, envmap)
        return

    from .. import pbrt
    from ..maps.images import tone_map
    from ..maps.sphere import sphere_exposure
    from ..pbrt.check import deviation
    from . import settings

    print(f"map: {args.map}, {envmap.width} x {envmap.height}")
    program, reason, scenes = None, "", []
    for_pbrt = args.albedo <= 1
    if for_pbrt:
        folder = cli.output_folder(out / "pbrt")
        scenes = pbrt.write_scenes(folder, envmap, args.spp, args.resolution, args.albedo, args.seed)
        print(f"wrote {folder}: scenes for PBRT-v3 and PBRT-v4, and their maps")
    else:
        reason = ", because PBRT's albedo is at most 1" if args.renderer == "auto" else ""
        print(f"note: no scene for PBRT was written: its albedo must be from 0 to 1, got {exactly(args.albedo)}")
    if args.renderer != "opencl" and for_pbrt:
        try:
            program = pbrt.find_pbrt(args.pbrt)
        except LightdomeError as error:
            # A program that the user asked for is not silently replaced.
            if args.renderer == "pbrt" or args.pbrt:
                raise
            reason = f", because: {str(error).partition(';')[0]}"
    print(f"renderer: {program or 'opencl'}{reason}")
    if program and not program.has_seed and args.seed != SEED:
        print(f"note: {program.name} has no seed; --seed does nothing")

    device = None
    if program:
        images = pbrt.render(program, scenes)
    else:
        device = cli.open_device(args)
        images = with_opencl(args, envmap, device)
    done, names = {}, []
    for spp, image in images:
        names += cli.write_images(args, out / f"sphere_{spp}spp", image)
        done[spp] = image
        if program and (where := deviation(image, envmap, args.albedo)):
            print(
                f"note: {program.name}'s image of {spp} spp differs from the sphere under this map: {where}",
                file=sys.stderr,
            )
    exposure = args.exposure or sphere_exposure(envmap, args.albedo)
    for spp, image in done.items():
        names += cli.write_images(args, out / f"sphere_{spp}spp", tone_map(image, exposure, args.gamma))
        print(f"wrote {out}/sphere_{spp}spp{cli.formats(args)}")
    if program:
        for scene in scenes:
            if scene.version == program.version:
                cli.explain(args, f"{scene.spp} spp", pbrt.decisions(program, scene))
    made_with = settings.settings(device, envmap, vars(args)) | {"pbrt": program and program.name}
    settings.write(out, made_with, names)
    print(cli.tone(args, exposure))
