"""What is kept between runs, under ``$XDG_CACHE_HOME/lightdome`` or ``~/.cache/lightdome``.

Everything in it can be made again; where it cannot be written, nothing is kept. PoCL and pyopencl keep their
programs beside it.
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

ROOM = 64 << 20  # bytes; PoCL compiles through files in its cache, and ends the process where the disk is full


def _base() -> Path:
    base = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")  # noqa: PTH111 - no home: no error
    return Path(base)


def cache_folder(kind: str) -> Path:
    """The folder for one ``kind`` of thing; it may not exist."""
    return _base() / "lightdome" / kind


def ensure_room() -> None:
    """Where the folder for caches cannot be written or is full, use a temporary one until the process ends.

    It becomes this process's ``XDG_CACHE_HOME``, for OpenCL implementations, which cannot do without, to find.
    Raises :class:`LightdomeError` where there is no room for a temporary folder either.
    """
    if _has_room(_base()):
        return
    if not _has_room(Path(tempfile.gettempdir())):
        raise LightdomeError(
            f"there is no room to compile kernels in {_base()}; set XDG_CACHE_HOME to a folder with {ROOM >> 20} MiB"
        )
    temporary = tempfile.TemporaryDirectory(prefix="lightdome-", ignore_cleanup_errors=True)
    atexit.register(temporary.cleanup)
    os.environ["XDG_CACHE_HOME"] = temporary.name


def _has_room(folder: Path) -> bool:
    try:
        existing = next(f for f in (folder, *folder.absolute().parents) if f.exists())
        return existing.is_dir() and os.access(existing, os.W_OK) and shutil.disk_usage(existing).free >= ROOM
    except OSError:
        return False


def key_of(*parts: str | bytes | memoryview) -> str:
    """A name for what depends on ``parts`` and on nothing else."""
    digest = hashlib.sha256()
    for part in parts:
        data = part.encode() if isinstance(part, str) else part
        digest.update(len(memoryview(data).cast("B")).to_bytes(8, "little"))
        digest.update(data)
    return digest.hexdigest()[:32]


def remembered(kind: str, key: str, make: Callable[[], np.ndarray], shape: tuple[int, ...]) -> np.ndarray:
    """The float32 array that ``make`` returned for ``key`` before, or now.

    What is on disk counts only if it has ``shape`` and matches the checksum beside it.
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
