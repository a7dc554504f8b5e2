"""The image that a whole map makes of the sphere, to which others are compared."""

from __future__ import annotations

from ..names import PIXELS
from . import cli


def main() -> None:
    parser = cli.parser(
        "Sum a diffuse sphere's image over every pixel of a map: what estimators converge to.\n\n"
        "Writes exact_centres or exact_areas as .pfm (linear radiance), .ppm and .png, or --format. settings.json says"
        " what made it.",
        "--map map.exr --pixels areas --format exr",
        "out/exact",
    )
    cli.map_options(parser)
    parser.add_argument(
        "--pixels",
        choices=PIXELS,
        default=PIXELS[0],
        help="what pixels of the map are: the directions of their centres, as for samples that lie there, or areas of"
        " constant radiance, as for bsdf and mis and for samples anywhere within",
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
    from ..maps.images import auto_exposure, tone_map
    from . import settings

    device = cli.open_device(args)
    print(f"map: {args.map}, {envmap.width} x {envmap.height}")
    image = exact(device, envmap, args.resolution, args.albedo, args.pixels)
    exposure = args.exposure or auto_exposure(image)
    path = out / f"exact_{args.pixels}"
    names = cli.write_images(args, path, image)
    names += cli.write_images(args, path, tone_map(image, exposure, args.gamma))
    print(f"wrote {path}{cli.formats(args)}")
    cli.explain(args, "the image", device.decisions.take())
    settings.write(out, settings.settings(device, envmap, vars(args)), names)
    print(cli.tone(args, exposure))
    cli.explain_kernels(args, device)
