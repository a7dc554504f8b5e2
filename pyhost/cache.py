"""The cache kept between runs, in ``$XDG_CACHE_HOME/lightdome`` or ``~/.cache/lightdome``.

Everything in it can be regenerated; if the folder cannot be written, nothing is kept. PoCL and pyopencl keep their
compiled programs beside it.
"""

from __future__ import annotations

import atexit
import contextlib
import hashlib
import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from .errors import LightdomeError
from .files import replacing

ROOM = 64 << 20  # bytes; PoCL compiles through files in its cache and kills the process if the disk is full


def _base() -> Path:
    """``$XDG_CACHE_HOME``, else ``.cache`` in the user's home, else a path below the null device: nothing is kept."""
    given = Path(os.environ.get("XDG_CACHE_HOME", ""))
    if given.is_absolute():  # the specification says to ignore relative paths
        return given
    home = Path(os.environ.get("HOME", ""))
    if not home.is_absolute():
        try:
            import pwd  # Unix only

            home = Path(pwd.getpwuid(os.getuid()).pw_dir)
        except ImportError:
            home = Path.home()
        except KeyError:  # a user without an entry, as in a container
            home = Path(os.devnull)
    return home / ".cache"


def cache_folder(kind: str) -> Path:
    """The folder for one ``kind`` of cache entry; it may not exist."""
    return _base() / "lightdome" / kind


def ensure_room() -> None:
    """Repair this process's environment where it lacks what OpenCL implementations need.

    They need a linker on ``PATH``, and a cache folder with free space. If the usual folder cannot be written or is
    full, a temporary one is used until the process ends. ``XDG_CACHE_HOME`` is set where ``HOME`` does not lead to the
    folder, as under cron. Raises :class:`LightdomeError` if there is no room for a temporary folder either.
    """
    if shutil.which("ld", path=os.environ.get("PATH", "")) is None:  # PoCL runs it for each kernel
        os.environ["PATH"] = os.pathsep.join(filter(None, (os.environ.get("PATH"), os.defpath)))
    of_pocl = os.environ.get("POCL_CACHE_DIR")
    if of_pocl == "" or (of_pocl and not _has_room(of_pocl)):
        del os.environ["POCL_CACHE_DIR"]
    base = _base()
    if not _has_room(base):
        try:
            elsewhere = tempfile.gettempdir()
        except OSError:  # there is no temporary folder
            elsewhere = os.devnull
        if not _has_room(elsewhere):
            raise LightdomeError(
                f"no room to compile kernels in {base}; set XDG_CACHE_HOME to a folder with {ROOM >> 20} MiB free"
            )
        temporary = tempfile.TemporaryDirectory(prefix="lightdome-", ignore_cleanup_errors=True)
        atexit.register(temporary.cleanup)
        base = Path(temporary.name)
    if "XDG_CACHE_HOME" in os.environ or base != Path(os.environ.get("HOME", ""), ".cache"):
        os.environ["XDG_CACHE_HOME"] = str(base)


def _has_room(folder: str | Path) -> bool:
    try:
        folder = Path(folder).absolute()
        existing = next(f for f in (folder, *folder.parents) if f.exists())
        no_programs = getattr(os, "ST_NOEXEC", 0)  # Linux only
        if no_programs and os.statvfs(existing).f_flag & no_programs:  # PoCL loads kernels from there
            return False
        return existing.is_dir() and os.access(existing, os.W_OK) and shutil.disk_usage(existing).free >= ROOM
    except OSError:
        return False


def key_of(*parts: str | bytes | memoryview) -> str:
    """A cache key that depends on ``parts`` and on nothing else."""
    digest = hashlib.sha256()
    for part in parts:
        data = part.encode() if isinstance(part, str) else part
        digest.update(len(memoryview(data).cast("B")).to_bytes(8, "little"))
        digest.update(data)
    return digest.hexdigest()[:32]


def remembered(kind: str, key: str, make: Callable[[], np.ndarray], shape: tuple[int, ...]) -> np.ndarray:
    """The float32 array that ``make`` returned for ``key`` in an earlier run, or returns now.

    An array on disk is used only if it has ``shape`` and matches the checksum stored with it.
    """
    path = cache_folder(kind) / f"{key}.f32"
    with contextlib.suppress(OSError):
        data = path.read_bytes()
        size = 4 * int(np.prod(shape, dtype=np.int64))
        if len(data) == size + 32 and hashlib.sha256(data[:size]).digest() == data[size:]:
            return np.frombuffer(data[:size], np.float32).reshape(shape).copy()
    array = np.ascontiguousarray(make(), dtype=np.float32)
    with contextlib.suppress(OSError, LightdomeError):
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as temporary:
            temporary.write_bytes(array.tobytes() + hashlib.sha256(array.tobytes()).digest())
    return array
