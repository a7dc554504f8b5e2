"""Measures the scheduling of ``lightdome catalog`` without its work: tasks only sleep, on a cluster of many threads.

    python tests/tools/catalog_simulation.py --maps 10000 --workers 32 --seconds 0

Prints how many maps per second the client, the scheduler and the journal handle, and how their memory grows. Everything
runs in one process, so the time per map covers all three.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import dask
import psutil
from distributed import Client, LocalCluster
from lightdome.catalog import computing
from lightdome.catalog.cluster import LOCAL
from lightdome.catalog.columns import columns
from lightdome.catalog.journal import Journal
from lightdome.catalog.row import Options, Row
from lightdome.maps.default_map import default_map

LIGHT = dict.fromkeys(("to_light_x", "to_light_y", "to_light_z", "flux_red", "flux_green"), 0.123456789012345)


def made(source: str, options: Options, key: str, known: object, version: object, seconds: float) -> Row:
    """A row of the usual size, after a pause."""
    time.sleep(PAUSE)
    values: dict[str, Any] = {column.name: 0.123456789012345 for column in columns(options)}
    values |= {
        "path": source,
        "status": "done",
        "error": None,
        "sha256": f"{hash(source):064x}",
        "lights": [LIGHT] * 16,
    }
    return Row(values)


def main() -> None:
    global PAUSE
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--maps", type=int, default=10_000, help="number of rows")
    parser.add_argument("--workers", type=int, default=32, help="number of workers, of two threads each")
    parser.add_argument("--seconds", type=float, default=0.0, help="time that a row takes")
    args = parser.parse_args()
    PAUSE = args.seconds
    computing.work = made
    computing._stat = lambda source: (None, None)
    process, options = psutil.Process(), Options()
    with (
        tempfile.TemporaryDirectory() as folder,
        dask.config.set(LOCAL),
        LocalCluster(
            processes=False, n_workers=args.workers, threads_per_worker=2, dashboard_address=None, silence_logs=50
        ) as cluster,
        Client(cluster, set_as_default=False) as client,
        Journal(Path(folder), options.key) as journal,
    ):
        for part in range(4):
            begin, busy = time.perf_counter(), process.cpu_times()
            names = [f"{default_map()}?{part * args.maps // 4 + n}" for n in range(args.maps // 4)]
            computing.Run(dict(zip(names, names, strict=True)), options, journal, Path(folder), 600)(client)
            took, now = time.perf_counter() - begin, process.cpu_times()
            cpu = now.user + now.system - busy.user - busy.system
            print(
                f"{len(journal.entries)} maps: {len(names) / took:.0f} per second, {1000 * cpu / len(names):.2f} ms of"
                f" processor time per map, {process.memory_info().rss >> 20} MiB",
                flush=True,
            )


if __name__ == "__main__":
    main()
