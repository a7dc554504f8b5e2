"""Part 2: draw light directions from an environment map and show where they fell."""

from __future__ import annotations

import sys
from argparse import Namespace
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import LightdomeError
from ..names import SEED, SEQUENCES, WITHIN
from ..sampling.samples import check_count
from . import cli

if TYPE_CHECKING:
    from ..maps.images import ImageRows
    from ..opencl.device import Device

BYTES_PER_PIXEL = 50  # peak memory on the host per pixel of the map: map, CDFs, pictures and marks


def main() -> None:
    parser = cli.parser(
        "Draw directions from an environment map with probability proportional to (R + G + B) sin(theta).\n\n"
        "Writes samples_N.npz, and em_N.pfm, em_N.ppm and em_N.png, or the formats of --format: the map with a square"
        " on each pixel drawn. settings.json records how they were made. Another --seed draws another set: how well one"
        " set does is chance.",
        "--counts 64 256 --seed 1",
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
        "--sequence", choices=SEQUENCES, default=SEQUENCES[0], help="the points that samples are made from"
    )
    parser.add_argument(
        "--within",
        choices=WITHIN,
        default=WITHIN[0],
        help="where directions lie: at the centre of their pixels, or anywhere in them, uniform over the solid angle",
    )
    parser.add_argument("--seed", type=cli.seed, default=SEED, help="seed of the points, a whole number")
    parser.add_argument(
        "--marker", type=cli.positive_int, default=5, metavar="M", help="side of the blue squares in pixels"
    )
    parser.add_argument(
        "--samples-only",
        action="store_true",
        help="write samples_N.npz and no pictures; the map is read in parts, so it may be larger than memory",
    )
    cli.image_options(parser)
    cli.device_option(parser)
    cli.explain_option(parser)
    args = parser.parse_args()
    args.counts = sorted(set(args.counts))
    check_count(args.counts[-1])

    out = cli.output_folder(args.out, images=not args.samples_only)

    from ..maps.images import ImageRows

    image = ImageRows(args.map, layer=args.layer, flip=args.flip)
    if args.samples_only and (image.is_cube or args.projection not in (None, "latlong")):
        raise LightdomeError(
            "--samples-only reads only latitude-longitude maps; lightdome convert makes one from any other"
        )
    device = cli.open_device(args)
    print(f"map: {args.map}, {image.width} x {image.height}")
    if args.samples_only:
        image.reorder(cli.map_columns(args, image.width, ", or leave out --samples-only"))
        write_samples(args, out, image, device)
    else:
        large = f"not enough memory for a {image.width} x {image.height} map; use --samples-only"
        here = device.handle
        room = here.global_mem_size / BYTES_PER_PIXEL if device.shares_host_memory else here.max_mem_alloc_size / 12
        if image.width * image.height > room:
            raise LightdomeError(large)
        try:
            write_samples_and_pictures(args, out, device)
        except MemoryError as error:
            raise LightdomeError(large) from error


def write_samples(args: Namespace, out: Path, image: ImageRows, device: Device) -> None:
    from ..maps.envmap import shape_note
    from ..sampling.streaming import sample_file
    from . import settings

    for note in (*image.notes, shape_note(image.height, image.width)):
        if note:
            print(note, file=sys.stderr)
    names = []
    sets = sample_file(
        device,
        image,
        args.counts,
        args.seed,
        args.sequence,
        within=args.within,
        sanitize=args.sanitize,
        report=lambda replaced: print(replaced.note, file=sys.stderr),
    )
    for samples in sets:
        names.append(f"samples_{len(samples)}.npz")
        samples.save(out / names[-1])
        print(f"wrote {out}/{names[-1]}")
    # A checksum of its radiance would need all rows in order, and not every file stores them so.
    of_map = {"width": image.width, "height": image.height, "file_sha256": settings.file_sum(args.map)}
    settings.write(out, settings.settings(device, None, vars(args)) | {"map": of_map}, names)
    # All counts are drawn in one go.
    cli.explain(args, f"{', '.join(map(str, args.counts))} samples", device.decisions.take())
    cli.explain_kernels(args, device)


def write_samples_and_pictures(args: Namespace, out: Path, device: Device) -> None:
    from ..maps.images import auto_exposure, tone_map
    from ..maps.markers import mark_picture, mark_pixels
    from ..maps.sphere import sphere_exposure
    from ..sampling.distribution import build_distribution
    from . import settings

    envmap = cli.load_map(args)
    distribution = build_distribution(device, envmap)
    cli.explain(args, "the map", device.decisions.take())
    exposure = args.exposure or auto_exposure(envmap.radiance)
    picture = tone_map(envmap.radiance, exposure, args.gamma)

    names = []
    for count in args.counts:
        em, name = out / f"em_{count}", f"samples_{count}.npz"
        samples = distribution.sample(count, seed=args.seed, sequence=args.sequence, within=args.within)
        samples.save(out / name)

        marked = envmap.radiance.copy()
        mark_pixels(marked, samples.pixel, args.marker, (0, 0, 1))
        images = cli.write_images(args, em, marked)
        marked = picture.copy()
        mark_picture(marked, samples.pixel, args.marker)
        names += [name, *images, *cli.write_images(args, em, marked)]
        print(f"wrote {out}/{name} and {em.name}{cli.formats(args)}")
        cli.explain(args, f"{count} samples", device.decisions.take())
    # For part 3, which never sees the map.
    of_sphere = {"sphere_exposure": sphere_exposure(envmap)}
    settings.write(out, settings.settings(device, envmap, vars(args)) | of_sphere, names)
    print(cli.tone(args, exposure))
    cli.explain_kernels(args, device)
