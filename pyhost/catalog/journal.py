"""The journal of a catalog: one line of JSON per finished row, appended as it arrives. The table is made from it.

A killed process loses no line that it has written; a line cut short is skipped. A row is valid only for the content,
version and options that produced it. The values stay in the file; memory holds only their positions.
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
    """The position of a row, and the file it describes.

    ``modified`` is a time in nanoseconds or, for a URL, what its server says; None if unknown.
    """

    offset: int
    sha256: str | None
    size: int | None
    modified: int | str | None
    is_done: bool


class Journal:
    """The journal in a catalog's folder. ``key`` stands for version and options; rows with another key are ignored.

    ``entries`` has the last row of each path; ``by_size`` has the contents with a row, by size in bytes. Use it as a
    context manager. Only one process can hold it: raises :class:`LightdomeError` while another does.
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
            raise LightdomeError(f"another process is writing the catalog in {folder}; wait or stop it") from error
        self._load()

    def __enter__(self) -> Journal:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def add(self, row: dict[str, Any], size: int | None, modified: int | str | None) -> None:
        """Write a row; once this returns, the row survives the end of this process."""
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
