"""The sphere's exact image, from every pixel of a map, with which others are compared."""

from __future__ import annotations

from ..names import PIXELS
from . import cli


def main() -> None:
    parser = cli.parser(
        "Compute a diffuse sphere's exact image from every pixel of a map: what estimators converge to.\n\n"
        "Writes exact_centres or exact_areas as .pfm (linear radiance), .ppm and .png, or as --format says, and"
        " settings.json, which records how they were made.",
        "--map map.exr --pixels areas --format exr",
        "out/exact",
    )
    cli.map_options(parser)
    parser.add_argument(
        "--pixels",
        choices=PIXELS,
        default=PIXELS[0],
        help="how to treat the map's pixels: as the directions of their centres, like samples at the centres, or as"
        " areas of constant radiance, like bsdf, mis, and samples anywhere within the pixels",
    )
    cli.sphere_options(parser)
    cli.image_options(parser)
    cli.display_option(parser)
    cli.device_option(parser)
    cli.explain_option(parser)
    args = parser.parse_args()

    out = cli.output_folder(args.out, images=True)
    envmap = cli.load_map(args)

    from ..lighting.exact import exact
    from ..maps.images import tone_map
    from ..maps.sphere import sphere_exposure
    from . import settings

    device = cli.open_device(args)
    print(f"map: {args.map}, {envmap.width} x {envmap.height}")
    image = exact(device, envmap, args.resolution, args.albedo, args.pixels)
    exposure = args.exposure or sphere_exposure(envmap, args.albedo)
    path = out / f"exact_{args.pixels}"
    names = cli.write_images(args, path, image)
    names += cli.write_images(args, path, tone_map(image, exposure, args.gamma))
    print(f"wrote {path}{cli.formats(args)}")
    cli.explain(args, "the image", device.decisions.take())
    settings.write(out, settings.settings(device, envmap, vars(args)), names)
    print(cli.tone(args, exposure))
    cli.explain_kernels(args, device)
