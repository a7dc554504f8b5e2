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

    A folder stands for every .exr, .hdr and .pfm file below it that is not hidden. A .txt file lists paths, globs and
    URLs, one per line; paths are relative to its folder. A server may take ``seconds`` to answer. Raises
    :class:`LightdomeError` if something is missing or there is no map at all.
    """
    found = {name_of(source): source for path in paths for source in _found(path, Path.cwd(), seconds)}
    if not found:
        raise LightdomeError(f"found no maps: no file ends in {', '.join(READABLE)}")
    return dict(sorted(found.items()))


def _found(path: str, base: Path, seconds: float) -> Iterator[str]:
    if is_url(path):
        yield from _remote(path, seconds)
        return
    absolute = os.path.abspath(base / path)  # noqa: PTH100 - resolve() would follow links
    if os.path.isdir(absolute):  # noqa: PTH112
        yield from _below(absolute)
    elif not os.path.exists(absolute) and glob.has_magic(path):  # noqa: PTH110
        matches = glob.glob(absolute, recursive=True)  # noqa: PTH207 - of an absolute pattern
        if not matches:
            raise LightdomeError(f"no file matches {path}")
        for match in matches:
            yield from _below(match) if os.path.isdir(match) else [match]  # noqa: PTH112
    elif absolute.lower().endswith(".txt"):
        yield from _listed(Path(absolute), seconds)
    else:
        yield absolute  # if it cannot be read, only its own row fails


def _below(folder: str) -> Iterator[str]:
    for here, folders, files in os.walk(folder, followlinks=False):
        folders[:] = (name for name in folders if not name.startswith("."))
        yield from (f"{here}/{name}" for name in files if _is_map(name))


def _listed(path: Path, seconds: float) -> Iterator[str]:
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeError) as error:
        raise LightdomeError(f"cannot read the list of maps {path}: {one_line(error)}") from error
    for line in filter(None, map(str.strip, lines)):
        if line.lower().endswith(".txt"):
            raise LightdomeError(f"{path} names another list, {line}; give both lists on the command line")
        yield from _found(line, path.parent, seconds)


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
