"""Computes the rows of many maps on a cluster: a bounded number at a time, each recorded as soon as it arrives."""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import CancelledError
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any
from uuid import uuid4

from distributed import Client, Future, KilledWorker, LocalCluster

from .. import __version__
from ..errors import LightdomeError, one_line, shown
from ..files import replacing
from ..progress import Progress
from .journal import Entry, Journal
from .remote import is_url
from .row import Options, Row
from .worker import work

AHEAD = 2  # maps submitted per thread of the cluster
POLL = 1.0  # seconds between checks of the cluster
PATIENCE = 10.0  # seconds without any worker before our own cluster gets another one
ALONE = 60.0  # seconds without any worker before the run ends
GO_ON = "run the same command again to resume"
NO_WORKER = f"the Dask scheduler has had no worker for {{:.0f}} s; start one, then {GO_ON}"
MOST_KNOWN = 100  # at most so many known contents of the same size are compared with a map's


@dataclass
class Flight:
    """A map submitted to the cluster."""

    name: str
    size: int | None
    modified: int | None
    is_alone: bool
    since: float = field(default_factory=time.monotonic)


class Run:
    """Computes the rows of ``sources``, by name, that the journal lacks, and writes their files to the folder ``out``.

    Maps whose worker died are retried after all others, one at a time, so that a second death is that map's own fault.
    """

    client: Client

    def __init__(self, sources: dict[str, str], options: Options, journal: Journal, out: Path, seconds: float) -> None:
        self.sources, self.options, self.journal, self.out, self.seconds = sources, options, journal, out, seconds
        self.waiting = self._new()
        self.total, self.done, self.known = len(self.waiting), 0, 0
        self._finished: SimpleQueue[Future[Row]] = SimpleQueue()
        self._flying: dict[Any, tuple[Future[Row], Flight]] = {}
        self._suspects: deque[str] = deque()
        self._name = f"map-{uuid4()}"
        self._submitted = 0
        self._looked, self._last_worker = 0.0, time.monotonic()
        self._most = AHEAD

    def __call__(self, client: Client) -> None:
        """Raises :class:`LightdomeError` if the cluster is lost; the journal keeps the rows finished so far."""
        try:
            self._compute(client)
        except (OSError, TimeoutError, CancelledError) as error:
            raise LightdomeError(f"the connection to the Dask cluster was lost ({one_line(error)}); {GO_ON}") from error

    def _compute(self, client: Client) -> None:
        self.client, waiting = client, self.waiting
        self._wait_for_worker()
        begin = time.monotonic()
        with Progress("maps") as progress:
            while waiting or self._flying or self._suspects:
                self._look()
                while waiting and len(self._flying) < self._most:
                    self._submit(waiting.popleft())
                if not self._flying:
                    self._wait_for_worker()  # so that its time starts with its work
                    self._submit(self._suspects.popleft(), is_alone=True)
                try:
                    future = self._finished.get(timeout=POLL)
                except Empty:
                    pass
                else:
                    self._take(future)
                rate = self.done / (time.monotonic() - begin)
                progress.label = f"{self.done} of {self.total} maps, {rate:.2g} per second"
                progress.update(self.done / self.total)

    def _new(self) -> deque[str]:
        """The maps without a row, with a failed row, or whose files may have changed since."""
        found: deque[str] = deque()
        for name, source in self.sources.items():
            entry = self.journal.entries.get(name)
            # The workers ask for the version of a URL, so that many are asked for at a time.
            if not (entry and entry.is_done and entry.modified and (entry.size, entry.modified) == _stat(source)):
                found.append(name)
        return found

    def _submit(self, name: str, is_alone: bool = False) -> None:
        source = self.sources[name]
        size, modified = _stat(source)
        known, version = list(islice(self.journal.by_size.get(size, ()), MOST_KNOWN)), None
        own = self.journal.entries.get(name)
        if own and own.is_done and own.sha256:
            known.insert(0, own.sha256)
            version = own.modified if is_url(source) else None
        future = self.client.submit(
            work,
            source,
            self.options,
            self.options.key,
            known,
            version,
            self.seconds,
            key=(self._name, self._submitted),
            pure=False,
        )
        self._submitted += 1
        self._flying[future.key] = future, Flight(name, size, modified, is_alone)
        future.add_done_callback(self._finished.put)

    def _take(self, future: Future[Row]) -> None:
        _, flight = self._flying.pop(future.key)
        try:
            row = future.result()
        except KilledWorker:
            if not flight.is_alone:
                self._suspects.append(flight.name)
                return
            took = time.monotonic() - flight.since
            why = f"it took more than {self.seconds:g} s" if took >= self.seconds else "its worker process died"
            row = _failed(flight.name, f"{why}, twice: skipped")
        except (OSError, TimeoutError, CancelledError):
            raise
        except Exception as error:
            row = _failed(flight.name, f"{type(error).__name__}: {one_line(error)}")
        self._write(row, flight)

    def _write(self, row: Row, flight: Flight) -> None:
        for name, content in row.files.items():
            path = self.out / name
            path.parent.mkdir(exist_ok=True)
            with replacing(path) as temporary:
                temporary.write_bytes(content)
        sha256 = row.values.get("sha256")
        values: dict[str, Any] = row.values
        if row.values["status"] != "done" and row.values["error"] is None:  # another row has the same content
            values = {**self.journal.row(self._entry(sha256)), "path": flight.name}
            self.known += 1
        self.journal.add(values, flight.size, row.version or flight.modified)
        self.done += 1

    def _entry(self, sha256: str | None) -> Entry:
        return next(rows[sha256] for rows in self.journal.by_size.values() if sha256 in rows)

    def _wait_for_worker(self) -> None:
        """Wait until there is a worker; our own cluster gets another one if that takes long.

        Dask does not restart a worker that died while it started.
        """
        try:
            self.client.wait_for_workers(1, timeout=PATIENCE)
        except TimeoutError:
            if isinstance(self.client.cluster, LocalCluster):
                self.client.cluster.scale(len(self.client.cluster.worker_spec) + 1)
            try:
                self.client.wait_for_workers(1, timeout=ALONE)
            except TimeoutError as error:
                raise LightdomeError(NO_WORKER.format(ALONE)) from error
        self._last_worker = time.monotonic()

    def _look(self) -> None:
        """Check that the cluster is still there, and count its threads."""
        now = time.monotonic()
        if now - self._looked < POLL:
            return
        self._looked = now
        if self.client.status != "running":
            raise LightdomeError(f"the Dask scheduler has stopped; restart it, then {GO_ON}")
        threads = sum(self.client.nthreads().values())
        if threads:
            self._last_worker = now
        elif now - self._last_worker > ALONE:
            raise LightdomeError(NO_WORKER.format(ALONE))
        self._most = max(AHEAD, AHEAD * threads)


def rows(journal: Journal, names: Iterable[str]) -> Iterator[dict[str, Any]]:
    """The rows of these maps, in the order given."""
    return (journal.row(journal.entries[name]) for name in names)


def _stat(source: str) -> tuple[int | None, int | None]:
    """Size and modification time, or None where they are unknown without reading the file."""
    if is_url(source):
        return None, None
    try:
        status = os.stat(source)  # noqa: PTH116
    except OSError:
        return None, None
    return status.st_size, status.st_mtime_ns


def _failed(name: str, why: str) -> Row:
    return Row({"path": name, "status": "failed", "error": shown(why), "version": __version__})
