"""The Dask cluster that computes a catalog: a local one, on loopback, or an existing one."""

from __future__ import annotations

import json
import logging
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import dask
from distributed import Client, LocalCluster
from distributed.comm.addressing import get_address_host_port
from distributed.security import Security

from ..errors import LightdomeError, one_line
from .worker import THREADS, opencl_threads

# The scheduler must not retry tasks: the maps of a dead worker are retried one by one, to find the one that killed it.
# The scheduler's logs are short, so that its memory does not grow with the number of maps.
LOCAL = {
    "distributed.scheduler.allowed-failures": 0,
    "distributed.admin.low-level-log-length": 100,
    "distributed.admin.log-length": 100,
    "distributed.worker.profile.enabled": False,
    # The values that glibc settles on by itself. Dask's own allocate every large array anew, which costs a third more.
    "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": 64 << 20,
    "distributed.nanny.pre-spawn-environ.MALLOC_MMAP_THRESHOLD_": 32 << 20,
}

PATIENCE = 20  # seconds for a scheduler to answer


@dataclass(frozen=True)
class Place:
    """Where maps are computed: by local ``workers``, or by the cluster of a ``scheduler`` (its address) or ``file``.

    - ``threads``: OpenCL threads of each local worker; ``memory``: the bytes that each may use
    - ``tls``: three PEM files: the certificate of the authority, your own certificate, and its key
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
    """A client. Local workers write to ``folder``. Raises :class:`LightdomeError` if there is no cluster."""
    for name in ("distributed.client", "tornado.application"):  # this program reports lost clusters and workers itself
        logging.getLogger(name).setLevel(logging.CRITICAL)
    with ExitStack() as stack:
        address = _address(place)
        try:
            where = address or stack.enter_context(_local(place, folder))
            client = Client(where, security=place.security, set_as_default=False, timeout=f"{PATIENCE}s")
        except (OSError, TimeoutError, ValueError) as error:
            raise LightdomeError(
                f"cannot connect to a Dask scheduler at {address or 'loopback'}: {one_line(error)}"
            ) from error
        yield stack.enter_context(client)


def _address(place: Place) -> str | None:
    """The address of an existing scheduler; its file may take a while to appear."""
    address = place.scheduler
    if place.file:
        end = time.monotonic() + PATIENCE
        while not place.file.exists() and time.monotonic() < end:
            time.sleep(0.05)
        try:
            address = str(json.loads(place.file.read_text(encoding="utf-8"))["address"])
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise LightdomeError(f"cannot read the scheduler file {place.file}: {one_line(error)}") from error
    if address and "://" not in address:
        address = f"{'tls' if place.tls else 'tcp'}://{address}"
    if address and not address.startswith("inproc://"):  # which has no port
        try:
            get_address_host_port(address, strict=True)
        except ValueError as error:
            raise LightdomeError(f"{address} is not the address of a Dask scheduler: {one_line(error)}") from error
    # Dask's client reports these two with a traceback, after 40 s.
    if address and address.startswith("tls://") and not place.tls:
        raise LightdomeError(f"the Dask scheduler at {address} needs --tls")
    if address and place.tls and not address.startswith("tls://"):
        raise LightdomeError(f"--tls needs a Dask scheduler at tls://..., got {address}")
    return address


@contextmanager
def _local(place: Place, folder: str) -> Iterator[LocalCluster]:
    with (
        dask.config.set(LOCAL),
        LocalCluster(
            n_workers=0,
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
        cluster.scale(place.workers)  # unlike the constructor, it goes on without a worker that dies while it starts
        yield cluster
