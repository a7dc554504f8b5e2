#!/usr/bin/env python3
"""Part 4: the same sphere by Monte Carlo, with fresh samples for every pixel, by PBRT or on an OpenCL device."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))
import _venv  # noqa: F401 - goes on in .venv if lightdome is not here

# isort: split
import argparse
from collections.abc import Iterator
from typing import TYPE_CHECKING

from lightdome import cli
from lightdome.errors import LightdomeError

if TYPE_CHECKING:
    import numpy as np
    from lightdome.device import Device
    from lightdome.envmap import EnvironmentMap

    Images = Iterator[tuple[int, np.ndarray]]


def parse_arguments() -> argparse.Namespace:
    """The command line."""
    parser = cli.parser(
        "Render a diffuse sphere under an environment map with fresh samples for every pixel.\n\n"
        "Writes sphere_Nspp.pfm (linear radiance), sphere_Nspp.ppm and sphere_Nspp.png for N samples a pixel, and the"
        " scenes for PBRT-v3 and PBRT-v4 into the folder pbrt. settings.json says what made the images.",
        example="scripts/part4_pbrt.py --spp 16 64 --seed 1",
        out="out/part4",
    )
    cli.map_options(parser)
    parser.add_argument(
        "--spp", type=cli.positive_int, nargs="+", default=[8, 16, 32, 64], metavar="N", help="samples a pixel"
    )
    parser.add_argument(
        "--renderer",
        choices=["auto", "pbrt", "opencl"],
        default="auto",
        help="auto: pbrt if there is one, else opencl",
    )
    parser.add_argument("--pbrt", type=Path, metavar="PATH", help="the program pbrt or its folder (default: from PATH)")
    parser.add_argument(
        "--seed", type=cli.seed, default=0, help="seed of the samples, a whole number; PBRT-v3 has none"
    )
    cli.sphere_options(parser)
    cli.tone_options(parser)
    cli.device_option(parser)
    cli.explain_option(parser)
    args = parser.parse_args()
    if args.renderer == "opencl" and args.pbrt:
        parser.error("--pbrt is for --renderer pbrt or auto")
    return args


def with_opencl(args: argparse.Namespace, envmap: "EnvironmentMap", device: "Device") -> "Images":
    """The images from our own renderer."""
    from lightdome.distribution import build_distribution
    from lightdome.render import render

    yield from render(build_distribution(device, envmap), args.spp, args.resolution, args.albedo, args.seed)
    cli.explain(args, device)


def main() -> None:
    """Write the scenes and the images, and say so."""
    args = parse_arguments()
    out = cli.output_folder(args.out)
    envmap = cli.load_map(args)

    from lightdome import pbrt, settings
    from lightdome.images import auto_exposure, tone_map, write_image

    print(f"map: {args.map}, {envmap.width} x {envmap.height}")
    scenes = pbrt.write_scenes(
        cli.output_folder(out / "pbrt"), envmap, args.spp, args.resolution, args.albedo, args.seed
    )
    print(f"wrote {out / 'pbrt'}: scenes for PBRT-v3 and PBRT-v4, and their maps")

    program, reason = None, ""
    if args.renderer != "opencl":
        try:
            program = pbrt.find_pbrt(args.pbrt)
        except LightdomeError as error:
            # A program that was asked for by name is not silently replaced.
            if args.renderer == "pbrt" or args.pbrt:
                raise
            reason = f", because: {str(error).partition(';')[0]}"
    print(f"renderer: {program or 'opencl'}{reason}")
    if program and program.version == 3 and args.seed:
        print("note: PBRT-v3 has no seed; --seed does nothing")

    device = None
    if program:
        images = pbrt.render(program, scenes)
    else:
        from lightdome.device import open_device

        device = open_device(args.device)
        print(f"device: {device.description}")
        images = with_opencl(args, envmap, device)
    done = {}
    for spp, image in images:
        write_image(out / f"sphere_{spp}spp.pfm", image)
        done[spp] = image
    # The image of most samples knows best how bright the sphere is, and one exposure serves all.
    exposure = args.exposure or auto_exposure(done[max(done)])
    for spp, image in done.items():
        picture = tone_map(image, exposure, args.gamma)
        for suffix in ("ppm", "png"):
            write_image(out / f"sphere_{spp}spp.{suffix}", picture)
        print(f"wrote {out}/sphere_{spp}spp.pfm, .ppm, .png")
    names = [f"sphere_{spp}spp.{suffix}" for spp in done for suffix in ("pfm", "ppm", "png")]
    made_with = settings.settings(device, envmap, vars(args)) | {"pbrt": program and f"PBRT-v{program.version}"}
    settings.write(out, made_with, names)
    print(f"exposure {exposure:.4g}, gamma {args.gamma:g}")


if __name__ == "__main__":
    cli.run(main)
