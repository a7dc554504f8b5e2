"""Benchmark: how much error does a millisecond buy, and with which method?"""

from __future__ import annotations

import argparse
from dataclasses import asdict

from .. import names
from . import cli

ERRORS = (0.1, 0.03, 0.01, 0.003)
# Map heights, image resolutions, and samples or lights, of --roofline.
ROOFLINE = (512, 2048, 8192), (255, 511, 2047), (64, 1024, 16384, 131072, 1048576)
ROOFLINE_QUICK = (512, 2048), (255, 511), (64, 1024, 65536)


def main() -> None:
    parser = cli.parser(
        "Measure every method's error and run time on one map, against the exact image that it converges to.\n\n"
        "Writes bench.csv, bench.json (errors relative to that image, times in seconds) and plots: error against"
        " time, error against count, stages, images.",
        "scripts/bench.py --quick",
        "out/bench",
    )
    cli.map_options(parser)
    parser.add_argument(
        "--counts",
        type=cli.positive_int,
        nargs="+",
        default=[16, 64, 256, 1024, 4096],
        metavar="N",
        help="samples or lights that all pixels share",
    )
    parser.add_argument(
        "--methods",
        nargs="+",
        choices=names.METHODS,
        metavar="NAME",
        help=f"methods to measure (default: all): {', '.join(names.METHODS)}",
    )
    parser.add_argument(
        "--peers",
        nargs="+",
        choices=["numpy", "mitsuba", "pbrt"],
        default=[],
        help="other programs to measure too (default: none)",
    )
    parser.add_argument(
        "--pbrt",
        nargs="+",
        default=[],
        metavar="PATH",
        help="PBRT programs, or their folders, to measure too (default: none; --peers pbrt takes the one of part 4)",
    )
    parser.add_argument(
        "--spp", type=cli.positive_int, nargs="+", default=[8, 16, 32, 64], metavar="N", help="samples per pixel"
    )
    parser.add_argument(
        "--resolution", type=cli.positive_int, default=511, metavar="R", help="width and height of the images in pixels"
    )
    parser.add_argument("--seeds", type=cli.times, default=8, metavar="N", help="seeds for the errors")
    parser.add_argument("--repeats", type=cli.times, default=5, metavar="N", help="runs for the times")
    parser.add_argument(
        "--quick",
        action="store_true",
        help="smaller image, fewer counts, seeds and repeats: under half a minute on two cores",
    )
    parser.add_argument(
        "--roofline",
        action="store_true",
        help="measure the machine's limits instead, and every stage's share of them at all sizes; writes roofline.csv,"
        " roofline.json and plots. Of the options above, --map, --resolution, --repeats and --quick count",
    )
    cli.device_option(parser)
    args = parser.parse_args()
    if args.pbrt and "pbrt" not in args.peers:
        args.peers = [*args.peers, "pbrt"]
    if args.quick:
        for name, value in {"resolution": 255, "seeds": 3, "repeats": 3}.items():
            if getattr(args, name) == parser.get_default(name):
                setattr(args, name, value)
        if args.counts == parser.get_default("counts"):
            args.counts = [16, 64, 256, 1024]
        if args.spp == parser.get_default("spp"):
            args.spp = [8, 32]
    (run_roofline if args.roofline else run)(args)


def run(args: argparse.Namespace) -> None:
    out = cli.output_folder(args.out)
    envmap = cli.load_map(args)

    from ..errors import LightdomeError
    from ..evaluation import benchmark, benchmark_plot, peers
    from ..lighting.exact import exact_kept
    from ..progress import Progress
    from .settings import settings

    device = cli.open_device(args)
    print(f"map: {args.map}, {envmap.width} x {envmap.height}")
    methods = benchmark.methods(device, envmap, args.resolution)
    chosen = [method for name, method in methods.items() if not args.methods or name in args.methods]
    found = peers.find(args.peers, envmap, args.resolution, args.pbrt)
    chosen += found.methods.values()
    references = {
        pixels: exact_kept(device, envmap, args.resolution, pixels)
        for pixels in {"centres", *(method.pixels for method in chosen)}
    }

    counts = {"shared": args.counts, "per pixel": args.spp}
    plan = [(method, count) for method in chosen for count in method.counts or sorted(set(counts[method.kind]))]
    points = []
    with Progress("benchmark") as progress:
        for done, (method, count) in enumerate(plan):
            if method.name in found.absent:
                continue
            try:
                points.append(benchmark.measure(method, count, args.seeds, args.repeats, references[method.pixels]))
            except LightdomeError as error:
                if not method.peer:
                    raise
                found.absent[method.name] = f"failed at {count}: {error}"
            progress.update((done + 1) / len(plan))

    chosen = [method for method in chosen if method.name not in found.absent]
    for name, reason in found.absent.items():
        print(f"peer {name}: absent ({reason})")

    made_with = settings(device, envmap, vars(args)) | {"peers": found.about, "absent": found.absent}
    benchmark.write_csv(out / "bench.csv", points)
    benchmark.write_json(out / "bench.json", points, made_with)
    title = f"{args.map.name}, {args.resolution} x {args.resolution}, {device.handle.name.strip()}"
    benchmark_plot.save(benchmark_plot.error_against_time(points, title), out / "error_time.png")
    benchmark_plot.save(benchmark_plot.error_against_count(points, title), out / "error_count.png")
    benchmark_plot.save(benchmark_plot.stages(points, title), out / "stages.png")
    middle = {kind: sorted(set(of_kind))[len(set(of_kind)) // 2] for kind, of_kind in counts.items()}
    shown, exact_of = {}, {}
    for m in chosen:
        if not m.name.startswith("exact"):
            count = 2 if m.counts else middle[m.kind]
            shown[f"{m.name} {count}"] = m.run(count, 0)
            exact_of[f"{m.name} {count}"] = references[m.pixels]
    figure = benchmark_plot.images(shown, references["centres"], title, exact_of)
    benchmark_plot.save(figure, out / "images.png")

    print(f"\n{'method':<20}{'count':>7}{'RMSE %':>10}{'spread':>9}{'bias %':>9}{'ms':>10}")
    for p in points:
        print(
            f"{p.method:<20}{p.count:>7}{100 * p.rmse:>10.3f}{100 * p.rmse_spread:>9.3f}"
            f"{100 * p.bias:>9.3f}{1e3 * p.wall_seconds:>10.2f}"
        )
    print("\ncheapest method measured")
    for error in ERRORS:
        best = benchmark.cheapest(points, error)
        found = f"{best.method} {best.count}, {1e3 * best.wall_seconds:.1f} ms" if best else "none"
        print(f"  for {100 * error:4.1f} %: {found}")
    print(f"\nwrote {out}/bench.csv, bench.json, error_time.png, error_count.png, stages.png, images.png")


def run_roofline(args: argparse.Namespace) -> None:
    out = cli.output_folder(args.out)
    envmap = cli.load_map(args)

    from ..evaluation import benchmark, roofline, roofline_plot, roofline_stages
    from ..evaluation.benchmark_plot import save
    from ..progress import Progress
    from .settings import settings

    device = cli.open_device(args)
    print(f"map: {args.map}, {envmap.width} x {envmap.height}")
    heights, resolutions, counts = ROOFLINE_QUICK if args.quick else ROOFLINE
    sides = sorted({*resolutions, args.resolution})
    plan = roofline_stages.plan(device, envmap, args.map.name, heights, sides, args.resolution, counts, N=1024)
    timings = []
    with Progress("roofline") as progress:
        before = roofline.measure_limits(device)
        for fraction, stage in plan:
            progress.update(fraction)
            timings.append(roofline.measure(device, stage, args.repeats))
        after = roofline.measure_limits(device)
    limits = before.best(after)
    points = [roofline.rated(timing, limits) for timing in timings]

    made_with = settings(device, envmap, vars(args))
    made_with["limits"] = {"before": asdict(before), "after": asdict(after)}
    made_with["exponents"] = roofline.exponents(points)
    roofline.write_csv(out / "roofline.csv", points)
    benchmark.write_json(out / "roofline.json", points, made_with)
    title = device.handle.name.strip()
    save(roofline_plot.roofline(points, limits, title), out / "roofline.png")
    save(roofline_plot.scaling(points, title), out / "roofline_scaling.png")

    for size, rate in limits.copies.items():
        print(f"copy of {size >> 20:>4} MiB: {1e-9 * rate:8.1f} GB/s")
    print(f"multiply-adds:    {1e-9 * limits.multiply_adds:8.1f} G/s")
    print(f"launch:           {1e6 * limits.launch_seconds:8.1f} us")
    heads = f"{'stage':<18}{'map':>13}{'image':>6}{'N':>9}{'ms':>11}{'spread':>9}{'M a second':>20}"
    print(f"\n{heads}{'share of its limit':>22}")
    for p in points:
        size = f"{p.width} x {p.height}" if p.width else ""
        least = p.counted == "least"
        share = f"{100 * p.bound_share:.1f} % {p.bound}" if least else f"{p.bound_share:.2f} x brute force"
        print(
            f"{p.stage:<18}{size:>13}{p.resolution or '':>6}{p.N or '':>9}{1e3 * p.seconds:>11.3f}"
            f"{1e3 * p.spread:>9.3f}{1e-6 * p.rate:>12.1f} {p.unit:<7}{share:>22}"
        )
    print(f"\nwrote {out}/roofline.csv, roofline.json, roofline.png, roofline_scaling.png")
