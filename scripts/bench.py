#!/usr/bin/env python3
"""Benchmark: how much error does a millisecond buy, and with which method?"""

import argparse

from lightdome import cli

ERRORS = (0.1, 0.03, 0.01, 0.003)


def main() -> None:
    parser = cli.parser(
        "Measure every method's error and run time on one map, against the exact image.\n\n"
        "Writes bench.csv, bench.json (errors relative to the exact image, times in seconds) and plots: error against"
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
    parser.add_argument("--methods", nargs="+", metavar="NAME", help="methods to measure (default: all)")
    parser.add_argument(
        "--peers",
        nargs="+",
        choices=["numpy", "mitsuba", "pbrt"],
        default=[],
        help="other programs to measure too (default: none)",
    )
    parser.add_argument(
        "--pbrt", nargs="+", default=[], metavar="PATH", help="PBRT programs, or their folders (default: pbrt on PATH)"
    )
    parser.add_argument(
        "--spp", type=cli.positive_int, nargs="+", default=[8, 16, 32, 64], metavar="N", help="samples a pixel"
    )
    parser.add_argument(
        "--resolution", type=cli.positive_int, default=511, metavar="R", help="width and height of the images in pixels"
    )
    parser.add_argument("--seeds", type=cli.positive_int, default=8, metavar="N", help="seeds for the errors")
    parser.add_argument("--repeats", type=cli.positive_int, default=5, metavar="N", help="runs for the times")
    parser.add_argument("--quick", action="store_true", help="smaller image, fewer counts, seeds and repeats: a minute")
    cli.device_option(parser)
    args = parser.parse_args()
    if args.quick:
        for name, value in {"resolution": 255, "seeds": 3, "repeats": 3}.items():
            if getattr(args, name) == parser.get_default(name):
                setattr(args, name, value)
        if args.counts == parser.get_default("counts"):
            args.counts = [16, 64, 256, 1024]
        if args.spp == parser.get_default("spp"):
            args.spp = [8, 32]
    run(args)


def run(args: argparse.Namespace) -> None:
    out = cli.output_folder(args.out)
    envmap = cli.load_map(args)

    from lightdome import benchmark, benchmark_plot, peers
    from lightdome.device import open_device
    from lightdome.errors import LightdomeError
    from lightdome.progress import Progress
    from lightdome.sphere import exact_kept

    device = open_device(args.device)
    print(f"device: {device.description}")
    print(f"map: {args.map}, {envmap.width} x {envmap.height}")
    methods = benchmark.methods(device, envmap, args.resolution)
    unknown = set(args.methods or ()) - set(methods)
    if unknown:
        raise LightdomeError(f"unknown method {sorted(unknown)[0]!r}; there is {', '.join(methods)}")
    chosen = [method for name, method in methods.items() if not args.methods or name in args.methods]
    reference = exact_kept(device, envmap, args.resolution)
    found = peers.find(args.peers, envmap, args.resolution, args.pbrt)
    chosen += found.methods.values()

    counts = {"shared": args.counts, "per pixel": args.spp}
    plan = [(method, count) for method in chosen for count in method.counts or sorted(set(counts[method.kind]))]
    points = []
    with Progress("benchmark") as progress:
        for done, (method, count) in enumerate(plan):
            if method.name in found.absent:
                continue
            try:
                points.append(benchmark.measure(method, count, args.seeds, args.repeats, reference))
            except LightdomeError as error:
                if not method.peer:
                    raise
                found.absent[method.name] = f"failed at {count}: {error}"
            progress.update((done + 1) / len(plan))

    chosen = [method for method in chosen if method.name not in found.absent]
    for name, reason in found.absent.items():
        print(f"peer {name}: absent ({reason})")

    settings = benchmark.settings(device, envmap, vars(args)) | {"peers": found.about, "absent": found.absent}
    benchmark.write_csv(out / "bench.csv", points)
    benchmark.write_json(out / "bench.json", points, settings)
    title = f"{args.map.name}, {args.resolution} x {args.resolution}, {device.handle.name.strip()}"
    benchmark_plot.save(benchmark_plot.error_against_time(points, title), out / "error_time.png")
    benchmark_plot.save(benchmark_plot.error_against_count(points, title), out / "error_count.png")
    benchmark_plot.save(benchmark_plot.stages(points, title), out / "stages.png")
    middle = {kind: sorted(set(of_kind))[len(set(of_kind)) // 2] for kind, of_kind in counts.items()}
    shown = {
        f"{m.name} {count}": m.run(count, 0)
        for m in chosen
        if m.name != "exact"
        for count in [2 if m.counts else middle[m.kind]]
    }
    benchmark_plot.save(benchmark_plot.images(shown, reference, title), out / "images.png")

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


if __name__ == "__main__":
    cli.run(main)
