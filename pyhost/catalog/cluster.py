"""The Dask cluster that computes a catalog: one on this machine, on loopback only, or a running one."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import dask
from distributed import Client, LocalCluster
from distributed.security import Security

from ..errors import LightdomeError, one_line
from .worker import THREADS, opencl_threads

# No task is tried again by the scheduler: which one killed its worker is found out one at a time. Logs of the scheduler
# are short, so that its memory does not grow with the number of maps.
LOCAL = {
    "distributed.scheduler.allowed-failures": 0,
    "distributed.admin.low-level-log-length": 100,
    "distributed.admin.log-length": 100,
    "distributed.worker.profile.enabled": False,
    # What glibc comes to by itself. Dask's own value makes every large array a new mapping, and costs a third.
    "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": 64 << 20,
    "distributed.nanny.pre-spawn-environ.MALLOC_MMAP_THRESHOLD_": 32 << 20,
}


@dataclass(frozen=True)
class Place:
    """Where the maps are computed: by ``workers`` on this machine, or by those of a ``scheduler``, or of its ``file``.

    - ``threads``: of OpenCL in each worker on this machine; ``memory``: bytes that each may take
    - ``tls``: three files of PEM: the authority's certificate, an own one, and its key
    """

    workers: int
    threads: int
    memory: int
    scheduler: str | None = None
    file: Path | None = None
    tls: tuple[Path, Path, Path] | None = None

    @property
    def security(self) -> Security | None:
        if self.tls is None:
            return None
        ca, certificate, key = map(str, self.tls)
        parts = {
            f"tls_{role}_{part}": file
            for role in ("client", "scheduler", "worker")
            for part, file in (("cert", certificate), ("key", key))
        }
        return Security(tls_ca_file=ca, require_encryption=True, **parts)


@contextmanager
def connected(place: Place, folder: str) -> Iterator[Client]:
    """A client; workers on this machine have ``folder``. Raises :class:`LightdomeError` if there is no cluster."""
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)  # what it loses is told in a line
    with ExitStack() as stack:
        try:
            where: dict[str, object] = {"address": place.scheduler}
            if place.file:
                where = {"scheduler_file": str(place.file)}
            elif not place.scheduler:
                where = {"address": stack.enter_context(_local(place, folder))}
            client = Client(**where, security=place.security, set_as_default=False, timeout="20s")
        except (OSError, TimeoutError, ValueError) as error:
            raise LightdomeError(
                f"there is no Dask scheduler at {place.scheduler or place.file or 'loopback'}: {one_line(error)}"
            ) from error
        yield stack.enter_context(client)


@contextmanager
def _local(place: Place, folder: str) -> Iterator[LocalCluster]:
    with (
        dask.config.set(LOCAL),
        LocalCluster(
            n_workers=place.workers,
            threads_per_worker=THREADS,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
            memory_limit=place.memory,
            local_directory=folder,
            security=place.security,
            silence_logs=logging.CRITICAL,
            env=opencl_threads(place.threads),
        ) as cluster,
    ):
        yield cluster
