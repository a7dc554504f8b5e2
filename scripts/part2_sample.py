#!/usr/bin/env python3
"""Part 2: draw light directions from an environment map and show where they fell."""

from lightdome import cli
from lightdome.samples import SEQUENCES


def main() -> None:
    parser = cli.parser(
        "Draw directions from an environment map with probability proportional to luminance x sin(theta).\n\n"
        "Writes samples_N.npz, and em_N.pfm, em_N.ppm and em_N.png: the map with a square on each pixel drawn.",
        "scripts/part2_sample.py --counts 64 256 --seed 1",
        "out/part2",
    )
    cli.map_options(parser)
    parser.add_argument(
        "--counts",
        type=cli.positive_int,
        nargs="+",
        default=[64, 256, 1024],
        metavar="N",
        help="samples to draw",
    )
    parser.add_argument(
        "--sequence", choices=SEQUENCES, default=SEQUENCES[0], help="the points that samples are made of"
    )
    parser.add_argument("--seed", type=cli.seed, default=0, help="seed of the points, a whole number")
    parser.add_argument(
        "--marker", type=cli.positive_int, default=5, metavar="M", help="side of the blue squares in pixels"
    )
    cli.tone_options(parser)
    cli.device_option(parser)
    args = parser.parse_args()

    out = cli.output_folder(args.out)
    envmap = cli.load_map(args)

    from lightdome.device import open_device
    from lightdome.distribution import build_distribution
    from lightdome.images import auto_exposure, tone_map, write_image
    from lightdome.markers import mark_pixels

    device = open_device(args.device)
    print(f"device: {device.description}")
    print(f"map: {args.map}, {envmap.width} x {envmap.height}")
    distribution = build_distribution(device, envmap)
    exposure = args.exposure or auto_exposure(envmap.radiance)
    picture = tone_map(envmap.radiance, exposure, args.gamma)

    for count in sorted(set(args.counts)):
        samples = distribution.sample(count, seed=args.seed, sequence=args.sequence)
        samples.save(out / f"samples_{count}.npz")

        marked = envmap.radiance.copy()
        mark_pixels(marked, samples.pixel, args.marker, (0, 0, 1))
        write_image(out / f"em_{count}.pfm", marked)
        marked = picture.copy()
        mark_pixels(marked, samples.pixel, args.marker, (0, 0, 255))
        for suffix in ("ppm", "png"):
            write_image(out / f"em_{count}.{suffix}", marked)
        print(f"wrote {out}/samples_{count}.npz and em_{count}.pfm, .ppm, .png")
    print(f"exposure {exposure:.4g}, gamma {args.gamma:g}")


if __name__ == "__main__":
    cli.run(main)
