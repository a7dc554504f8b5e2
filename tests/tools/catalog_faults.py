"""Kills processes of ``lightdome catalog`` at random moments, and checks that the next run completes the same table.

    python tests/tools/catalog_faults.py [--count 20] [--kinds client worker scheduler]

For each kind of process, a run is killed and the same command runs again. Apart from times, the table must then equal
that of an undisturbed run. No row in the journal may be computed again, and no file may be incomplete. The scheduler is
killed in a separate cluster, the other processes in the cluster that the command starts.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import psutil  # Dask needs it too
import pyarrow.parquet as pq
from helpers import LONG, stiff_radiance
from lightdome.catalog.journal import NAME
from lightdome.commands import catalog
from lightdome.maps.images import write_image

MAPS = 24
KINDS = ("client", "worker", "scheduler")


@dataclass
class Outcome:
    """The result of a kill after ``at`` rows: rows finished by then, how many of those were lost, incomplete files.

    ``is_killed`` is False if the run was over before.
    """

    kind: str
    at: int
    finished: int
    lost: int
    is_equal: bool
    half: list[str]
    is_killed: bool


class Trial:
    """Maps in a folder, the table expected for them, and runs of the command on them.

    Runs that are not to be killed are computed by the cluster of ``address`` or, without one, by ``workers``.
    """

    def __init__(self, folder: Path, maps: int = MAPS, workers: int = 2, address: str | None = None) -> None:
        self.folder, self.workers, self.address = folder, workers, address
        (folder / "maps").mkdir()
        for n in range(maps):
            radiance = stiff_radiance(*((8, 16) if n % 4 else (32, 64)), n)
            write_image(folder / "maps" / f"m{n:03}.{'pfm' if n % 2 else 'exr'}", radiance)
        (folder / "maps" / "cut.exr").write_bytes((folder / "maps" / "m000.exr").read_bytes()[:300])
        self.complete(folder / "whole")
        self.expected = table(folder / "whole")

    def arguments(self, out: Path, *more: object) -> list[str]:
        return [str(word) for word in ("catalog", self.folder / "maps", "--out", out, "--thumbnails", *more)]

    def start(self, out: Path, *more: object) -> subprocess.Popen[str]:
        command = [sys.executable, "-m", "lightdome", *self.arguments(out, *(more or ("--workers", self.workers)))]
        return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

    def complete(self, out: Path) -> None:
        """Compute what is missing, in this process if there is a cluster for it."""
        if self.address is None:
            self.end(self.start(out))
            return
        with patch.object(sys, "argv", self.arguments(out, "--scheduler", self.address)):
            catalog.main()

    def end(self, process: subprocess.Popen[str]) -> str:
        said, errors = process.communicate(timeout=LONG)
        if process.returncode:
            raise RuntimeError(f"exit status {process.returncode}: {said}{errors}")
        return said

    def kill(self, kind: str, rows: int) -> Outcome:
        """Kill a process of a run that has ``rows`` rows, or is starting if 0, and let the run complete."""
        out, is_killed = Path(tempfile.mkdtemp(dir=self.folder)), True
        if kind == "scheduler":
            with cluster(self.folder) as (scheduler, file):
                process = self.start(out, "--scheduler-file", file)
                self._wait(process, out, rows)
                scheduler.kill()
                errors = process.communicate(timeout=LONG)[1]
                if process.returncode not in (0, 1) or "Traceback" in errors:
                    raise RuntimeError(f"exit status {process.returncode}: {errors}")
        else:
            process = self.start(out)
            self._wait(process, out, rows)
            if kind == "client":
                process.kill()
                process.communicate()
            else:
                is_killed = False
                while process.poll() is None and not is_killed:
                    with suppress(IndexError, psutil.Error):  # no worker yet, or it has just ended
                        random.choice(workers_of(process.pid)).send_signal(signal.SIGKILL)
                        is_killed = True
        finished = done(out)
        half = incomplete(out)
        if kind == "worker":
            self.end(process)
        else:
            self.complete(out)
        return Outcome(
            kind, rows, len(finished), self._lost(out, finished), table(out) == self.expected, half, is_killed
        )

    def _wait(self, process: subprocess.Popen[str], out: Path, rows: int) -> None:
        """Wait until the journal has ``rows`` rows, and then a random time."""
        journal = out / NAME
        while process.poll() is None:
            if rows == 0 or (journal.exists() and journal.read_bytes().count(b"\n") >= rows):
                time.sleep(random.uniform(0, 2 if rows == 0 else 0.2))
                return
            time.sleep(0.01)

    def _lost(self, out: Path, finished: dict[str, int]) -> int:
        """The number of finished rows that are gone or were computed again."""
        now = done(out)
        return sum(now.get(path) != 1 for path in finished)


@contextmanager
def cluster(folder: Path) -> Iterator[tuple[subprocess.Popen[bytes], Path]]:
    """A scheduler and a worker, each in its own process."""
    file = Path(tempfile.mkdtemp(dir=folder)) / "scheduler.json"
    environment = {**os.environ, "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "0"}
    options: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "env": environment}
    dask, here = [sys.executable, "-m", "dask"], ["--host", "127.0.0.1", "--scheduler-file", str(file)]
    served = ["--port", "0", "--dashboard-address", "127.0.0.1:0"]
    scheduler = subprocess.Popen([*dask, "scheduler", *here, *served], **options)
    computed = ["--nthreads", "2", "--no-dashboard", "--local-directory", str(folder), "--death-timeout", "60"]
    worker = subprocess.Popen([*dask, "worker", *here, *computed], **options)
    try:
        yield scheduler, file
    finally:
        for process in (scheduler, worker):
            process.kill()
            process.wait()


def workers_of(client: int) -> list[psutil.Process]:
    """The worker processes started by a client's nannies."""
    found = []
    with suppress(psutil.Error):
        for process in psutil.Process(client).children(recursive=True):
            if "spawn_main" in " ".join(process.cmdline()):
                found.append(process)
    return found


def table(out: Path) -> list[dict[str, Any]]:
    """The rows of both tables, without times."""
    rows = pq.read_table(out / "catalog.parquet").to_pylist()
    with (out / "catalog.csv").open(newline="", encoding="utf-8") as file:
        rows += csv.DictReader(file)
    return [{name: value for name, value in row.items() if not name.startswith("seconds_")} for row in rows]


def done(out: Path) -> dict[str, int]:
    """The number of finished rows in the journal, by map."""
    counts: dict[str, int] = {}
    journal = out / NAME
    for line in journal.read_bytes().splitlines() if journal.exists() else []:
        try:
            row = json.loads(line)["row"]
        except ValueError:
            continue  # a line cut short
        if row["status"] == "done":
            counts[row["path"]] = counts.get(row["path"], 0) + 1
    return counts


def incomplete(out: Path) -> list[str]:
    """Incomplete files under their final names."""
    ends = {".png": b"IEND\xaeB`\x82", ".html": b"</html>\n", ".parquet": b"PAR1"}
    files = [path for path in out.rglob("[!.]*") if path.suffix in ends]
    return [path.name for path in files if not path.read_bytes().endswith(ends[path.suffix])]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--count", type=int, default=20, help="number of kills of each kind")
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=KINDS, help="processes to kill")
    parser.add_argument("--maps", type=int, default=MAPS, help="maps per run")
    parser.add_argument("--workers", type=int, default=2, help="workers per run")
    parser.add_argument("--seed", type=int, default=0, help="seed of the random moments")
    args = parser.parse_args()
    random.seed(args.seed)
    with tempfile.TemporaryDirectory() as folder:
        trial = Trial(Path(folder), args.maps, args.workers)
        for kind in args.kinds:
            outcomes = []
            for _ in range(args.count):
                outcomes.append(trial.kill(kind, random.randint(0, args.maps)))
                print(outcomes[-1], flush=True)
            print(
                f"{kind}: killed {sum(o.is_killed for o in outcomes)} times,"
                f" {sum(o.finished for o in outcomes)} rows finished before,"
                f" {sum(o.lost for o in outcomes)} lost, {sum(o.is_equal for o in outcomes)} tables equal,"
                f" {sum(len(o.half) for o in outcomes)} files incomplete"
            )


if __name__ == "__main__":
    main()
