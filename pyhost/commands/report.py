"""The written report as PDF, and a zip of it and all images, from existing results or from fresh runs."""

from __future__ import annotations

import argparse
import atexit
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .. import __version__
from . import cli

if TYPE_CHECKING:
    from ..maps.envmap import EnvironmentMap

COUNTS = [64, 256, 1024]  # samples shared by all pixels
SPP = [8, 16, 32, 64]


class Runs:
    """The commands' results: existing ones, next to the report's folder or inside it, or fresh ones."""

    def __init__(self, out: Path, run: Callable[..., int] | None = None) -> None:
        self.out = out
        self._run = run or run_command
        self.folders: dict[str, Path] = {}
        self.settings: dict[str, dict[str, Any]] = {}

    def need(self, name: str, command: str, record: str, wanted: Mapping[str, object], *options: object) -> None:
        """Find the results ``name`` with the settings ``wanted``, or run ``command`` with ``options``."""
        from . import settings

        own = self.out / name
        for folder in (self.out.parent / name, own):
            found = settings.read(folder / record)
            other = found and settings.difference(found, wanted)
            if found and not other:
                print(f"{name}: from {folder}", flush=True)
                break
            if found:
                print(f"{name}: not from {folder}, where {other} differs")
        else:
            folder = own
            print(f"{name}: running lightdome {command}", flush=True)
            status = self._run(command, *options, "--out", folder)
            found = settings.read(folder / record)
            # If a case of the stability table fails, the command says so and the report shows it.
            if found is None or settings.difference(found, wanted):
                if status:
                    sys.exit(status)  # the command has said why
                raise RuntimeError(f"{command} did not write the expected results into {folder}")
        self.folders[name], self.settings[name] = folder, found


def run_command(command: str, *options: object) -> int:
    """Run a command with its messages on our terminal; returns its exit status, or 1 if it was killed."""
    words = [sys.executable, "-m", "lightdome", command, *options]
    with subprocess.Popen([str(word) for word in words], stdout=subprocess.DEVNULL) as process:
        atexit.register(process.terminate)  # lets it clean up after itself
        status = process.wait()
        atexit.unregister(process.terminate)
        return status if status >= 0 else 1


def main() -> None:
    parser = cli.parser(
        "Write report.pdf, and lightdome-report.zip with the report and every .pfm and .ppm.\n\n"
        "Results of fresnel, sample, shade, render, bench and stability come from the folders part1 to part4, bench and"
        " stability next to DIR, if they are for this map and version. Missing results are computed, into DIR, and"
        " include numpy, Mitsuba and PBRT if they are installed. To compute everything takes about half an hour on two"
        " cores with Mitsuba and PBRT, and less without.",
        "--quick",
        "out/report",
    )
    cli.map_options(parser)
    parser.add_argument(
        "--pbrt", type=Path, metavar="PATH", help="the program pbrt or its folder (default: as lightdome render)"
    )
    parser.add_argument("--quick", action="store_true", help="smaller images, fewer counts and cases: a few minutes")
    cli.device_option(parser)
    make(parser.parse_args())


def make(args: argparse.Namespace) -> None:
    from .. import pbrt
    from ..evaluation import report

    report.require_typst()
    if args.pbrt:
        pbrt.find_pbrt(args.pbrt)  # checked before any work is wasted
    out = cli.output_folder(args.out, images=True)
    envmap = cli.load_map(args)
    device = cli.open_device(args)
    print(f"map: {args.map}, {envmap.width} x {envmap.height}")
    runs = Runs(out)
    need_all(runs, args, envmap)
    results = report.Results(runs.folders, runs.settings)
    images = report.write(device, envmap, args.map.name, results, out)
    print(f"wrote {out}/{report.PDF} and {report.ARCHIVE} with it and {images} images")


def need_all(runs: Runs, args: argparse.Namespace, envmap: EnvironmentMap) -> None:
    """Find or compute the results that a report on ``envmap`` shows."""
    from ..evaluation import mitsuba_process
    from . import settings

    of_version: dict[str, object] = {"versions": {"lightdome": __version__}}
    of_map = of_version | {"map": {"sha256": settings.map_sum(envmap)}}
    on_device = ["--device", args.device] if args.device else []
    on_map = [*cli.map_arguments(args), *on_device]
    quick = ["--quick"] if args.quick else []
    sphere = {"resolution": 255 if args.quick else 511, "albedo": 1.0}
    estimator = {"estimator": "light", "sequence": "independent", "within": None}
    with_pbrt = {"pbrt": str(args.pbrt)} if args.pbrt else {}

    runs.need("part1", "fresnel", settings.NAME, of_version | {"options": {"eta": 1.4}})
    shown = {"format": cli.FORMATS, "exposure": None}
    options: dict[str, object] = {"counts": COUNTS, **shown}
    runs.need("part2", "sample", settings.NAME, of_map | {"options": options}, "--counts", *COUNTS, *on_map)
    names = [f"samples_{n}.npz" for n in COUNTS]
    runs.need(
        "part3",
        "shade",
        settings.NAME,
        of_version
        | {"options": sphere | shown, "inputs": {name: runs.settings["part2"]["files"][name] for name in names}},
        *(runs.folders["part2"] / name for name in names),
        *("--resolution", sphere["resolution"], *on_device),
    )
    runs.need(
        "part4",
        "render",
        settings.NAME,
        of_map | {"options": {"spp": SPP, **sphere, **shown, **estimator, **with_pbrt}},
        *("--spp", *SPP, "--resolution", sphere["resolution"], *on_map),
        *(["--pbrt", args.pbrt] if args.pbrt else []),
    )
    options = {"quick": args.quick}
    mitsuba = ["mitsuba"] if mitsuba_process.installed() else []
    part4 = runs.settings["part4"]
    peer_pbrt = ["pbrt"] if part4["pbrt"] else []
    runs.need(
        "bench",
        "bench",
        "bench.json",
        of_map | {"options": options | {"methods": None}},
        *("--peers", "numpy", *mitsuba, *peer_pbrt, *quick, *on_map),
        *(["--pbrt", part4["options"]["pbrt"]] if peer_pbrt and part4["options"]["pbrt"] else []),
    )
    runs.need(
        "stability",
        "stability",
        "stability.json",
        of_version | {"options": options},
        *(["--peers", *mitsuba] if mitsuba else []),
        *(*quick, *on_device),
    )
