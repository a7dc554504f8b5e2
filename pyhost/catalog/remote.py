"""Maps behind URLs that fsspec reads: their names, whether they have changed, and temporary copies of them."""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from hashlib import sha256
from importlib import import_module
from pathlib import Path
from typing import Any

import fsspec

from ..errors import LightdomeError, one_line

WAITS = 3  # requests for a map that may go unanswered, one after the other, before its time is over
# What file systems call the properties that change with a file's content.
VERSIONS = (
    "ETag",
    "etag",
    "Content-MD5",
    "Digest",
    "Last-Modified",
    "LastModified",
    "last_modified",
    "updated",
    "mtime",
)


def is_url(source: str) -> bool:
    """Whether it is read through fsspec rather than the file system."""
    return "://" in source


def is_http(url: str) -> bool:
    return url.startswith(("http://", "https://"))


def name_of(source: str) -> str:
    """What a source is called in tables and messages: a URL without user and password, its query replaced by a hash."""
    if not is_url(source):
        return source
    address, _, query = source.partition("?")
    return without_secrets(address) + (f"?{sha256(query.encode()).hexdigest()[:8]}" if query else "")


def without_secrets(text: str) -> str:
    """A message without the users, passwords and queries of the URLs in it."""
    return re.sub(r"(://[^\s?]*)\?[^\s'\"]*", r"\1?...", re.sub(r"://[^/?#\s]*@", "://", text))


def file_system(url: str, seconds: float) -> tuple[Any, str]:
    """The file system of a URL, and the path in it. An HTTP server may not take longer than ``seconds`` to go on."""
    options: dict[str, Any] = {}
    if is_http(url):
        try:
            aiohttp = import_module("aiohttp")
        except ImportError as error:
            raise LightdomeError("http:// needs aiohttp: pip install 'lightdome[cluster]'") from error
        options["client_kwargs"] = {"timeout": aiohttp.ClientTimeout(None, connect=seconds, sock_read=seconds)}
    files, path = fsspec.core.url_to_fs(url, **options)
    return files, path


def reason(error: Exception) -> str:
    """What a file system's error says, in one line without secrets."""
    # fsspec says "not found" for whatever the server said.
    cause = (isinstance(error, FileNotFoundError) and error.__cause__) or error
    if isinstance(cause, LightdomeError):
        return str(cause)
    # In this order: a URL that is cut short may have lost the sign that ends its password.
    return f"{type(cause).__name__}: {one_line(without_secrets(str(cause)))}"


class _Limit(fsspec.Callback):  # type: ignore[misc] # fsspec has no types
    """Ends the transfer of a file that is larger than ``most`` bytes."""

    def __init__(self, most: int) -> None:
        super().__init__()
        self.most = most

    def set_size(self, size: int | None) -> None:
        self._check(size or 0)

    def relative_update(self, inc: int = 1) -> None:
        self.value += inc
        self._check(self.value)

    def _check(self, size: int) -> None:
        if size > self.most:
            raise LightdomeError(f"the file is larger than {self.most / 1e6:.0f} MB; raise --limit-memory")


class Remote:
    """The file at a URL. Raises :class:`LightdomeError` if it cannot be reached within a part of ``seconds``.

    ``version`` differs if the server says that the content has changed; it is None if the server says nothing.
    """

    def __init__(self, url: str, seconds: float) -> None:
        self.url = url
        try:
            self._files, self._path = file_system(url, seconds / WAITS)
            info = self._files.info(self._path)
        except Exception as error:
            raise self._error(error) from error
        versions = [str(info[name]) for name in VERSIONS if info.get(name)]
        self.version = " ".join([str(info.get("size")), *versions]) if versions else None

    @contextmanager
    def copied(self, most: int) -> Iterator[Path]:
        """A temporary copy. Raises :class:`LightdomeError` if it has more than ``most`` bytes or ends too soon."""
        with tempfile.TemporaryDirectory(prefix="lightdome-") as folder:
            path = Path(folder) / f"map{os.path.splitext(self._path.partition('?')[0])[1]}"  # noqa: PTH122 - of a URL
            try:
                self._files.get_file(self._path, str(path), callback=_Limit(most))
            except Exception as error:
                raise self._error(error) from error
            yield path

    def _error(self, error: Exception) -> LightdomeError:
        return LightdomeError(f"cannot read {name_of(self.url)}: {reason(error)}")
