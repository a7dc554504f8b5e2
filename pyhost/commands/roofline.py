"""Roofline: the machine's limits, and how close each stage comes to them, at all sizes."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import asdict

from . import cli

# Map heights, image resolutions, and samples or lights.
SIZES = (512, 2048, 8192), (255, 511, 2047), (64, 1024, 16384, 131072, 1048576)
QUICK_SIZES = (512, 2048), (255, 511), (64, 1024, 65536)


def main() -> None:
    parser = cli.parser(
        "Measure the machine's limits, and how close each stage comes to them as maps, images and counts grow.\n\n"
        "Writes roofline.csv (a row per stage and size), roofline.json (the same with the limits; seconds, bytes,"
        " amounts per second) and plots: stages against the limits, time and memory against size.",
        "--quick",
        "out/roofline",
    )
    cli.map_options(parser)
    parser.add_argument(
        "--resolution",
        type=cli.positive_int,
        default=511,
        metavar="R",
        help="width and height in pixels of the images while maps and counts grow",
    )
    parser.add_argument("--repeats", type=cli.times, default=5, metavar="N", help="number of runs for the times")
    parser.add_argument(
        "--quick",
        action="store_true",
        help="smaller maps and images, fewer counts and repeats: about a minute on two cores",
    )
    cli.device_option(parser)
    args = parser.parse_args()
    if args.quick:
        cli.quicken(parser, args, resolution=255, repeats=3)
    run(args)


def run(
    args: argparse.Namespace,
    sizes: tuple[Sequence[int], Sequence[int], Sequence[int]] | None = None,
    copy_bytes: Sequence[int] | None = None,
) -> None:
    """Measure; tests pass small ``sizes``, in the form of :data:`SIZES`, and ``copy_bytes``."""
    out = cli.output_folder(args.out)
    envmap = cli.load_map(args)

    from ..evaluation import roofline, roofline_plot, roofline_stages
    from ..plotting import save_figure
    from ..progress import Progress
    from .settings import settings

    device = cli.open_device(args)
    print(f"map: {args.map}, {envmap.width} x {envmap.height}")
    heights, resolutions, counts = sizes or (QUICK_SIZES if args.quick else SIZES)
    copies = [copy_bytes] if copy_bytes else []
    sides = sorted({*resolutions, args.resolution})
    plan = roofline_stages.plan(device, envmap, args.map.name, heights, sides, args.resolution, counts, N=1024)
    timings = []
    with Progress("roofline") as progress:
        before = roofline.measure_limits(device, *copies)
        for fraction, stage in plan:
            progress.update(fraction)
            timings.append(roofline.time_stage(device, stage, args.repeats))
        after = roofline.measure_limits(device, *copies)
    limits = before.best(after)
    points = [roofline.rated(timing, limits) for timing in timings]

    made_with = settings(device, envmap, vars(args))
    made_with["limits"] = {"before": asdict(before), "after": asdict(after)}
    made_with["exponents"] = roofline.exponents(points)
    roofline.write_stage_csv(out / "roofline.csv", points)
    roofline.write_stage_json(out / "roofline.json", points, made_with)
    title = device.hardware
    save_figure(roofline_plot.roofline(points, limits, title), out / "roofline.png")
    save_figure(roofline_plot.scaling(points, title), out / "roofline_scaling.png")

    for size, rate in limits.copies.items():
        print(f"copy of {size >> 20:>4} MiB: {1e-9 * rate:8.1f} GB/s")
    print(f"multiply-adds:    {1e-9 * limits.multiply_adds:8.1f} G/s")
    print(f"launch:           {1e6 * limits.launch_seconds:8.1f} us")
    heads = f"{'stage':<18}{'map':>13}{'image':>6}{'N':>9}{'ms':>11}{'spread':>9}{'M per second':>20}"
    print(f"\n{heads}{'share of its limit':>22}")
    for p in points:
        of_map = f"{p.width} x {p.height}" if p.width else ""
        least = p.counted == "least"
        share = f"{100 * p.bound_share:.1f} % {p.bound}" if least else f"{p.bound_share:.2f} x brute force"
        print(
            f"{p.stage:<18}{of_map:>13}{p.resolution or '':>6}{p.N or '':>9}{1e3 * p.seconds:>11.3f}"
            f"{1e3 * p.spread:>9.3f}{1e-6 * p.rate:>12.1f} {p.unit:<7}{share:>22}"
        )
    print(f"\nwrote {out}/roofline.csv, roofline.json, roofline.png, roofline_scaling.png")
