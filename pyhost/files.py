"""Files that appear under their final name only when they are complete."""

from __future__ import annotations

import csv
import json
import os
import secrets
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from .errors import LightdomeError

# The files that :func:`abandon` removes. Any thread may call it, as the process ends without unwinding the stack.
_unfinished: set[Path] = set()


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """Yield a temporary file beside ``path``; rename it to ``path`` if the block succeeds.

    The temporary name starts with a dot and keeps the suffix, so that writers that choose a format by the suffix work.
    If the block raises, nothing is left behind; a process killed with SIGKILL leaves the hidden file. Errors of the
    operating system (a full disk, no permission) are raised as :class:`LightdomeError`.
    """
    path = Path(path)
    if not path.name:
        raise LightdomeError(f"cannot write {path}: a file needs a name")
    temporary = path.with_name(f".{path.stem}.{secrets.token_hex(4)}{path.suffix}")
    # Everything from here on can be interrupted at any moment.
    try:
        if path.exists() and not path.is_file():
            raise LightdomeError(f"cannot write {path}: it exists and is not a regular file")
        _unfinished.add(temporary)
        temporary.touch(exist_ok=False)
        yield temporary
        temporary.replace(path)
    except OSError as error:
        raise cannot_write(path, error.strerror or str(error)) from error
    finally:
        with suppress(OSError):  # the folder may not exist
            temporary.unlink(missing_ok=True)
        _unfinished.discard(temporary)


def write_json(path: str | Path, content: Mapping[str, object], allow_nan: bool = False) -> None:
    """Write ``content`` as indented JSON. Raises ``ValueError`` for NaN and infinity, unless ``allow_nan``."""
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(content, indent=2, allow_nan=allow_nan) + "\n", encoding="utf-8")


def write_table(path: str | Path, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Write ``rows`` as CSV below a line with the names of the ``columns``; None becomes a blank."""
    with replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows(rows)


def abandon() -> None:
    """Remove all temporary files of :func:`replacing`, when the process is about to end."""
    for temporary in list(_unfinished):
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def utf8_name(path: Path) -> str:
    """``path`` as text for a library that takes only UTF-8 names, whatever the locale's encoding.

    Raises :class:`LightdomeError` if the name is not UTF-8.
    """
    try:
        return os.fsencode(path).decode("utf-8")
    except UnicodeError as error:
        raise LightdomeError(
            f"OpenImageIO opens only files with UTF-8 names, and {path} is not UTF-8; rename it"
        ) from error


def cannot_write(path: Path, reason: str) -> LightdomeError:
    """The error for a file that cannot be written, with what to do."""
    return LightdomeError(f"cannot write {path}: {reason}; make room there or choose another folder")
