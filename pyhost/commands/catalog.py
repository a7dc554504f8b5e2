"""Makes a table of many maps: what each contains, a few lights, harmonics, pictures, and a page to browse them."""

from __future__ import annotations

import argparse
import multiprocessing
import multiprocessing.util
import os
import re
import shutil
import tempfile
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from .. import interrupts
from ..errors import LightdomeError
from ..files import abandon
from ..names import LIGHT_FORMATS
from . import cli

if TYPE_CHECKING:
    from ..catalog.cluster import Place
    from ..catalog.computing import Run

MOST = 2**22  # lights or samples of a map
WORKER = 300_000_000  # bytes of a worker without a map; Dask ends one that takes nearly all that it may
LEAST = 1_000_000_000  # reading in bands takes 400 MB
FOLDERS = ("lights", "samples", "thumbnails")


def main() -> None:
    parser = cli.parser(
        "Make a table of many maps: what each contains, a few lights, harmonics, and the error of both.\n\n"
        "Writes catalog.parquet, catalog.csv and index.html, a page that works offline. A map that cannot be read"
        " affects only its own row. Finished rows are saved at once, and the same command resumes a stopped run: it"
        " computes only new, changed and failed maps.",
        "maps --out out/catalog --thumbnails",
    )
    parser.add_argument(
        "maps",
        nargs="+",
        metavar="PATH",
        help="maps, folders to search, globs, .txt files that list such paths, one per line, or URLs that fsspec reads",
    )
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder to write to")
    parser.add_argument("--lights", type=count, default=16, metavar="N", help="lights by median cut; 0 for none")
    parser.add_argument(
        "--harmonics", type=order, default=2, metavar="L", help="order of the harmonics, 0 to 64, or 'none'"
    )
    parser.add_argument(
        "--samples", type=count, default=0, metavar="N", help="write N Sobol samples of each map to a file in samples/"
    )
    parser.add_argument(
        "--light-files",
        choices=LIGHT_FORMATS,
        metavar="FORMAT",
        help=f"write the lights of each map to a file in lights/: {', '.join(LIGHT_FORMATS)}",
    )
    parser.add_argument(
        "--thumbnails",
        action="store_true",
        help="write a picture of each map, and of a sphere lit by it, to thumbnails/",
    )
    parser.add_argument(
        "--workers", type=cli.positive_int, default=cores(), metavar="N", help="number of processes on this machine"
    )
    place = parser.add_mutually_exclusive_group()
    place.add_argument("--scheduler", metavar="ADDRESS", help="compute on this Dask cluster: tcp://HOST:PORT")
    place.add_argument(
        "--scheduler-file", type=Path, metavar="FILE", help="compute on the Dask cluster of this scheduler file"
    )
    parser.add_argument(
        "--tls",
        type=Path,
        nargs=3,
        metavar=("CA", "CERT", "KEY"),
        help="connect over TLS; three PEM files: the authority's certificate, your certificate, and its key",
    )
    parser.add_argument(
        "--limit-memory",
        default="4GB",
        metavar="SIZE",
        help="memory per worker; maps that need more are read in bands",
    )
    parser.add_argument(
        "--timeout",
        type=cli.positive_float,
        default=600,
        metavar="SECONDS",
        help="give up on a map that takes longer to read or to compute",
    )
    cli.device_option(parser)
    args = parser.parse_args()
    if args.light_files and not args.lights:
        raise LightdomeError("--light-files needs lights: raise --lights above 0")

    for needed in ("distributed", "pyarrow"):
        try:
            import_module(needed)
        except ImportError as error:
            raise LightdomeError(f"this needs {needed}: pip install 'lightdome[cluster]'") from error
    catalog(args)


def catalog(args: argparse.Namespace) -> None:
    from dask.utils import parse_bytes

    from ..catalog import sources, table
    from ..catalog.cluster import Place
    from ..catalog.columns import columns
    from ..catalog.computing import Run, rows
    from ..catalog.journal import Journal
    from ..catalog.page import write_page
    from ..catalog.row import Options

    try:
        memory = int(parse_bytes(args.limit_memory))
    except ValueError as error:
        raise LightdomeError(f"--limit-memory must be a size such as 4GB or 2GiB, got {args.limit_memory}") from error
    if memory < LEAST:
        raise LightdomeError(f"--limit-memory must be at least 1GB, got {args.limit_memory}")
    options = Options(
        lights=args.lights,
        harmonics=args.harmonics,
        samples=args.samples,
        light_format=args.light_files,
        thumbnails=args.thumbnails,
        device=args.device,
        memory=memory * 9 // 10 - WORKER,
    )
    for path in args.tls or ():
        if not path.is_file():
            raise LightdomeError(f"cannot read {path}, given with --tls: no such file")
    threads = max(1, cores() // args.workers)
    place = Place(args.workers, threads, memory, args.scheduler, args.scheduler_file, args.tls and tuple(args.tls))
    maps = sources.find(args.maps, args.timeout)
    out = cli.output_folder(args.out)
    with Journal(out, options.key) as journal:
        clear(out)
        run = Run(maps, options, journal, out, args.timeout)
        if run.waiting:
            compute(run, place)
        computed = run.total - run.known
        wanted = columns(options)
        table.write_parquet(out / "catalog.parquet", wanted, lambda: rows(journal, maps), len(maps))
        table.write_csv(out / "catalog.csv", wanted, lambda: rows(journal, maps))
        write_page(out / "index.html", options, lambda: rows(journal, maps))
        failed = sum(not journal.entries[name].is_done for name in maps)
    plural, known = "s" if len(maps) > 1 else "", len(maps) - computed
    print(f"{len(maps)} map{plural}: {computed} computed, {known} already known, {failed} failed")
    print(f"wrote {out / 'catalog.parquet'}, catalog.csv and index.html")


def compute(run: Run, place: Place) -> None:
    """Compute what is missing; if a signal stops it, say how to resume."""
    from ..catalog.cluster import connected
    from ..catalog.computing import GO_ON

    with tempfile.TemporaryDirectory(prefix="lightdome-", ignore_cleanup_errors=True) as folder:

        def stop() -> None:
            for process in multiprocessing.active_children():
                process.kill()
            multiprocessing.util._run_finalizers(0)  # type: ignore[attr-defined] # or Python warns of leaked semaphores
            abandon()
            shutil.rmtree(folder, ignore_errors=True)
            done = f"{run.done} of {run.total} maps are done and saved; {GO_ON}\n"
            os.write(2, done.encode())

        take_back = interrupts.end_after(stop)
        try:
            with connected(place, folder) as client:
                print(f"Dask's dashboard: {client.dashboard_link}")
                run(client)
        finally:
            take_back()


def cores() -> int:
    """The number of processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def count(text: str) -> int:
    """Argument type: a whole number from 0 to 4194304."""
    value = 0 if text == "0" else cli.positive_int(text)
    if value > MOST:
        raise argparse.ArgumentTypeError(f"{text} is not a whole number from 0 to {MOST}")
    return value


def order(text: str) -> int | None:
    """Argument type: a whole number from 0 to 64, or "none"."""
    if text == "none":
        return None
    if not (text.isdecimal() and int(text) <= 64):
        raise argparse.ArgumentTypeError(f"{text} is neither none nor a whole number from 0 to 64")
    return int(text)


def clear(out: Path) -> None:
    """Remove unfinished files of a killed run, and nothing else that lies in ``out``."""
    for folder, name in ((out, "(catalog|index)"), *((out / name, ".+") for name in FOLDERS)):
        for path in folder.glob(".*"):
            if re.fullmatch(rf"\.{name}\.[0-9a-f]{{8}}(\..+)?", path.name):
                shutil.rmtree(path) if path.is_dir() else path.unlink()
