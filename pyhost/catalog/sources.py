"""Finds the maps that a command line names: folders, files, globs, lists in text files, and URLs that fsspec reads."""

from __future__ import annotations

import glob
import os
from collections.abc import Iterable, Iterator
from pathlib import Path

from ..errors import LightdomeError, one_line
from ..maps.images import READABLE
from .remote import file_system, is_http, is_url, name_of, reason

DEEPEST = 16  # folders below an HTTP URL


def find(paths: Iterable[str], seconds: float = 600) -> dict[str, str]:
    """Absolute paths and URLs of maps by the names that the table gives them, sorted and without duplicates.

    A folder stands for every .exr, .hdr and .pfm file below it that is not hidden, and a glob for those that it
    matches. A .txt file lists paths, globs and URLs, one per line; paths are relative to its folder. Folders that
    cannot be listed and missing files of a list are among the maps, so that their rows say so. A server may take
    ``seconds`` to answer. Raises :class:`LightdomeError` if anything else is missing or there is no map at all.
    """
    found = {name_of(source): source for path in paths for source in _found(path, Path.cwd(), seconds)}
    if not found:
        raise LightdomeError(f"found no maps: no file ends in {', '.join(READABLE)}")
    return dict(sorted(found.items()))


def _found(path: str, base: Path, seconds: float, is_listed: bool = False) -> Iterator[str]:
    if is_url(path):
        if "::" in path:
            raise LightdomeError(f"chained URLs cannot be read: {name_of(path)}")
        yield from _remote(path, seconds)
        return
    absolute = os.path.abspath(base / path)  # noqa: PTH100 - resolve() would follow links
    if os.path.isdir(absolute):  # noqa: PTH112
        yield from _below(absolute)
    elif not os.path.exists(absolute) and glob.has_magic(path):  # noqa: PTH110
        matches = list(_matching(path, base))
        if not matches:
            raise LightdomeError(f"no file matches {path}")
        for match in matches:
            if os.path.isdir(match):  # noqa: PTH112
                yield from _below(match)
            elif _is_map(match):
                yield match
    elif absolute.lower().endswith(".txt"):
        yield from _listed(Path(absolute), seconds)
    elif is_listed or os.path.exists(absolute):  # noqa: PTH110
        yield absolute  # if it cannot be read, only its own row fails
    else:
        raise LightdomeError(f"{path} does not exist")


def _below(folder: str) -> Iterator[str]:
    unreadable: list[OSError] = []
    for here, folders, files in os.walk(folder, onerror=unreadable.append, followlinks=False):
        folders[:] = (name for name in folders if not name.startswith("."))
        yield from (f"{here}/{name}" for name in files if _is_map(name))
    yield from (error.filename for error in unreadable)


def _matching(pattern: str, base: Path) -> Iterator[str]:
    head, stars, tail = pattern.partition("**/")
    for match in glob.glob(head or ".", root_dir=base):  # noqa: PTH207 - Path.glob takes no absolute pattern
        path = os.path.abspath(base / match)  # noqa: PTH100
        if stars:  # glob itself would follow links, for ever
            yield from (found for found in _below(path) if Path(found).relative_to(path).match(tail or "*"))
        else:
            yield path


def _listed(path: Path, seconds: float) -> Iterator[str]:
    try:
        lines = path.read_text(encoding="utf-8-sig").split("\n")  # other separators may be parts of names
    except (OSError, UnicodeError) as error:
        raise LightdomeError(f"cannot read the list of maps {path}: {one_line(error)}") from error
    for line in (line.removesuffix("\r") for line in lines):
        if not line.strip() or line.startswith("#"):
            continue
        if line.lower().endswith(".txt"):
            raise LightdomeError(f"{path} names another list, {line}; give both lists on the command line")
        yield from _found(line, path.parent, seconds, is_listed=True)


def _remote(url: str, seconds: float) -> Iterator[str]:
    plain = url.partition("?")[0] if is_http(url) else url
    deepest = {"maxdepth": DEEPEST} if is_http(url) else {}  # links between pages can go round in circles
    try:
        files, root = file_system(url, seconds)
        if glob.has_magic(plain):
            matches = files.glob(root, **deepest)
        elif _is_map(plain):
            matches = [root]
        else:
            files.ls(root, detail=False)  # find() hides why a folder cannot be listed
            matches = [name for name in files.find(root, **deepest) if _is_map(name)]
        yield from (files.unstrip_protocol(name) for name in matches)
    except Exception as error:  # each file system raises its own kinds
        raise LightdomeError(f"cannot list {name_of(url)}: {reason(error)}") from error


def _is_map(name: str) -> bool:
    base = name.rpartition("/")[2]
    return base.lower().endswith(READABLE) and not base.startswith(".")
