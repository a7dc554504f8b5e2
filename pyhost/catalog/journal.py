"""The journal of a catalog: a line of JSON for each finished row, added as it comes, from which the table is made.

A process that is killed loses no line that it wrote; of one that was cut short, what is left is skipped. A row counts
for the content, the version and the options that made it. The values stay in the file: in memory is where they are.
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import LightdomeError

NAME = "journal.jsonl"


@dataclass(frozen=True)
class Entry:
    """Where a row is, and the file that it is of: ``modified`` in nanoseconds, None where nothing says it."""

    offset: int
    sha256: str | None
    size: int | None
    modified: int | None
    is_done: bool


class Journal:
    """The journal in a catalog's folder; ``key`` is that of version and options, other rows do not count.

    ``entries`` has the last row of each path, ``by_size`` the contents that have a row, by their size in bytes. Use as
    a context manager: one process at a time has it. Raises :class:`LightdomeError` while another has.
    """

    def __init__(self, folder: Path, key: str) -> None:
        self.key = key
        self.entries: dict[str, Entry] = {}
        self.by_size: dict[int | None, dict[str, Entry]] = {}
        path = folder / NAME
        try:
            self._file = path.open("a+b")
        except OSError as error:
            raise LightdomeError(f"cannot write {path}: {error.strerror}") from error
        try:
            import fcntl  # Unix only

            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except ImportError:
            pass
        except OSError as error:
            self._file.close()
            raise LightdomeError(f"another process writes the catalog in {folder}; wait for it, or stop it") from error
        self._load()

    def __enter__(self) -> Journal:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def add(self, row: dict[str, Any], size: int | None, modified: int | None) -> None:
        """Write a row; it is there when this returns, whatever happens to the process."""
        line = {"key": self.key, "size": size, "modified": modified, "row": row}
        offset = self._file.seek(0, os.SEEK_END)
        self._file.write(json.dumps(line, allow_nan=False, separators=(",", ":")).encode() + b"\n")
        self._file.flush()
        self._note(offset, line)

    def row(self, entry: Entry) -> dict[str, Any]:
        """The values of a row."""
        self._file.seek(entry.offset)
        row: dict[str, Any] = json.loads(self._file.readline())["row"]
        return row

    def _load(self) -> None:
        self._file.seek(0)
        offset, line = 0, b"\n"
        for line in self._file:
            try:
                content = json.loads(line)
                if content["key"] == self.key:
                    self._note(offset, content)
            except (ValueError, KeyError, TypeError):
                pass  # a line that was cut short
            offset += len(line)
        if not line.endswith(b"\n"):
            self._file.write(b"\n")

    def _note(self, offset: int, line: dict[str, Any]) -> None:
        row = line["row"]
        sha256 = row.get("sha256")
        entry = Entry(offset, sha256, line["size"], line["modified"], row["status"] == "done")
        self.entries[row["path"]] = entry
        if entry.is_done and sha256:
            self.by_size.setdefault(entry.size, {})[sha256] = entry
