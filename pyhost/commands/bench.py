"""Benchmark: how much error does a millisecond buy, and with which method?"""

from __future__ import annotations

import argparse

from .. import names
from . import cli


def main() -> None:
    parser = cli.parser(
        "Measure every method's error and run time on one map, against the exact image it converges to.\n\n"
        "Writes bench.csv, bench.json (errors relative to that image, times in seconds) and plots: error against"
        " time, error against count, stages, images.",
        "--quick",
        "out/bench",
    )
    cli.map_options(parser)
    parser.add_argument(
        "--counts",
        type=cli.positive_int,
        nargs="+",
        default=[16, 64, 256, 1024, 4096],
        metavar="N",
        help="numbers of samples or lights that all pixels share",
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
        help="PBRT programs, or their folders, to measure too (default: none; --peers pbrt uses the one that lightdome"
        " render uses)",
    )
    parser.add_argument(
        "--spp", type=cli.positive_int, nargs="+", default=[8, 16, 32, 64], metavar="N", help="samples per pixel"
    )
    parser.add_argument(
        "--resolution", type=cli.positive_int, default=511, metavar="R", help="width and height of the images in pixels"
    )
    parser.add_argument("--seeds", type=cli.times, default=8, metavar="N", help="number of seeds for the errors")
    parser.add_argument("--repeats", type=cli.times, default=5, metavar="N", help="number of runs for the times")
    parser.add_argument(
        "--quick",
        action="store_true",
        help="smaller image, fewer counts, seeds and repeats: under half a minute on two cores",
    )
    cli.explain_option(parser)
    cli.device_option(parser)
    args = parser.parse_args()
    if args.pbrt and "pbrt" not in args.peers:
        args.peers = [*args.peers, "pbrt"]
    if args.quick:
        cli.quicken(parser, args, resolution=255, seeds=3, repeats=3, counts=[16, 64, 256, 1024], spp=[8, 32])
    run(args)


def run(args: argparse.Namespace) -> None:
    out = cli.output_folder(args.out)
    envmap = cli.load_map(args)

    from ..errors import LightdomeError
    from ..evaluation import benchmark, benchmark_plot, metrics, peers
    from ..lighting.exact import exact_kept
    from ..plotting import save_figure
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

    cli.explain(args, "the exact image", device.decisions.take())

    counts = {"shared": args.counts, "per pixel": args.spp}
    plan = [(method, count) for method in chosen for count in method.counts or sorted(set(counts[method.kind]))]
    points = []
    with Progress("benchmark") as progress:
        for done, (method, count) in enumerate(plan):
            if method.name in found.absent:
                continue
            exact = references[method.pixels]
            try:
                points.append(benchmark.measure_method(method, count, args.seeds, args.repeats, exact))
            except LightdomeError as error:
                if not method.peer:
                    raise
                found.absent[method.name] = f"failed at {count}: {error}"
            cli.explain(args, f"{method.name} {count}", device.decisions.take())
            progress.update((done + 1) / len(plan))

    chosen = [method for method in chosen if method.name not in found.absent]
    for name, reason in found.absent.items():
        print(f"peer {name}: absent ({reason})")

    made_with = settings(device, envmap, vars(args)) | {"peers": found.about, "absent": found.absent}
    benchmark.write_method_csv(out / "bench.csv", points)
    benchmark.write_method_json(out / "bench.json", points, made_with)
    title = f"{args.map.name}, {args.resolution} x {args.resolution}, {device.hardware}"
    save_figure(benchmark_plot.error_against_time(points, title), out / "error_time.png")
    save_figure(benchmark_plot.error_against_time_all(points, title), out / "error_time_all.png")
    save_figure(benchmark_plot.error_against_count(points, title), out / "error_count.png")
    save_figure(benchmark_plot.stages(points, title), out / "stages.png")
    middle = {kind: sorted(set(of_kind))[len(set(of_kind)) // 2] for kind, of_kind in counts.items()}
    shown, exact_of = {}, {}
    for m in chosen:
        if not m.name.startswith("exact"):
            count = 2 if m.counts else middle[m.kind]
            shown[f"{m.name} {count}"] = m.run(count, 0)
            exact_of[f"{m.name} {count}"] = references[m.pixels]
    figure = benchmark_plot.images(shown, references["centres"], title, exact_of)
    save_figure(figure, out / "images.png")

    print(f"\n{'method':<20}{'count':>7}{'RMSE %':>10}{'spread':>9}{'bias %':>9}{'ms':>10}")
    for p in points:
        print(
            f"{p.method:<20}{p.count:>7}{100 * p.rmse:>10.3f}{100 * p.rmse_spread:>9.3f}"
            f"{100 * p.bias:>9.3f}{1e3 * p.wall_seconds:>10.2f}"
        )
    print("\nfastest method measured")
    for level in metrics.LEVELS:
        best = metrics.cheapest(points, level)
        said = f"{best.method} {best.count}, {1e3 * best.wall_seconds:.1f} ms" if best else "none"
        print(f"  for {100 * level:4.1f} %: {said}")
    print(
        f"\nwrote {out}/bench.csv, bench.json, error_time.png, error_time_all.png,"
        " error_count.png, stages.png, images.png"
    )
