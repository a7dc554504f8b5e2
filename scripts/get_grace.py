#!/usr/bin/env python3
"""Fetch the Grace Cathedral light probe (Paul Debevec, 1998/1999).

Standard library only, so that it runs before anything is installed. The file appears under its name
only when its size and SHA-256 are right; whatever goes wrong, nothing is left behind.
"""

import os
import signal

if __name__ == "__main__":  # before anything else, for Ctrl-C to be heard while the rest is loaded

    def _end(number: int, frame: object) -> None:
        os._exit(128 + number)

    for _number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(_number) is not signal.SIG_IGN:
            signal.signal(_number, _end)

import argparse
import contextlib
import errno
import hashlib
import http.client
import ssl
import sys
import tempfile
import threading
import time
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO, NoReturn

if sys.version_info < (3, 10):  # noqa: UP036 - an older one may well run this
    import _start  # noqa: F401 - goes on with the Python of .venv

URL = "https://raw.githubusercontent.com/mmp/pbrt-v2/master/scenes/textures/grace_latlong.exr"
SIZE = 1_726_329
SHA256 = "7c017bce200658354d72774712e51f039d472aa1399a91c2d0e3eb81ca909079"

SILENCE = 20.0  # seconds without a byte, or to connect
DEADLINE = 300.0  # seconds for everything, whatever the server does
BLOCK = 1 << 16
ELSEWHERE = "get the file some other way and pass it with --from FILE"


class GraceError(Exception):
    """What went wrong, in one line that says what to do."""


class _OnlyHttp(urllib.request.HTTPRedirectHandler):
    """Follows redirects to http and https only."""

    def redirect_request(self, req, fp, code, msg, headers, newurl):  # type: ignore[no-untyped-def]
        if urllib.parse.urlsplit(newurl).scheme.lower() not in ("http", "https"):
            raise GraceError(f"{req.full_url} redirects to {newurl!r}, which is not http or https; {ELSEWHERE}")
        return super().redirect_request(req, fp, code, msg, headers, newurl)


def _open_url(url: str) -> BinaryIO:
    # Only these handlers: urllib's default opener also knows file:, ftp: and data:.
    opener = urllib.request.OpenerDirector()
    for handler in (
        urllib.request.ProxyHandler(),
        urllib.request.HTTPHandler(),
        urllib.request.HTTPSHandler(),
        urllib.request.HTTPDefaultErrorHandler(),
        urllib.request.HTTPErrorProcessor(),
        _OnlyHttp(),
    ):
        opener.add_handler(handler)
    request = urllib.request.Request(url, headers={"User-Agent": "lightdome get_grace"})
    response = opener.open(request, timeout=SILENCE)
    if response is None:
        raise GraceError(f"cannot open {url}; {ELSEWHERE}")
    return response


def _reason(error: Exception) -> str:
    if isinstance(error, urllib.error.HTTPError):
        return f"the server answers {error.code} {error.reason}".rstrip()
    if isinstance(error, urllib.error.URLError):
        inner = error.reason
        return _reason(inner) if isinstance(inner, Exception) else str(inner)
    if isinstance(error, TimeoutError):
        return f"no answer for {SILENCE:g} seconds"
    if isinstance(error, ssl.SSLCertVerificationError):
        return f"the server's certificate is not accepted ({error.verify_message})"
    if isinstance(error, http.client.HTTPException):
        return "the answer is not proper HTTP" if not str(error) else f"the connection broke ({error})"
    return (getattr(error, "strerror", None) or str(error) or type(error).__name__).strip()


def _read(stream: BinaryIO, limit: int, take: Callable[[bytes], object], name: str) -> int:
    """Pass at most ``limit`` bytes of ``stream`` to ``take``; return their number."""
    began = shown = time.monotonic()
    count = 0
    # One call to the system a read, so that dripping bytes cannot hold up the look at the clock.
    read = getattr(stream, "read1", stream.read)
    try:
        while count < limit:
            block = read(min(BLOCK, limit - count))
            if not block:
                break
            take(block)
            count += len(block)
            now = time.monotonic()
            if now - began > DEADLINE:
                raise GraceError(
                    f"gave up on {name}: only {count:,} bytes in {DEADLINE:g} seconds; try again or {ELSEWHERE}"
                )
            if sys.stderr.isatty() and now - began > 2 and now - shown > 0.2:
                print(f"\r{count / limit:4.0%} of {limit / 1e6:.1f} MB", end="", file=sys.stderr, flush=True)
                shown = now
    finally:
        if shown != began:
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)
    return count


def matches(path: Path, size: int, sha256: str) -> bool:
    """Whether ``path`` is a regular file with this size and sum."""
    try:
        if not path.is_file() or path.stat().st_size != size:
            return False
        return hashlib.sha256(path.read_bytes()).hexdigest() == sha256
    except OSError:
        return False


def _source(text: str) -> str | Path:
    """A URL or a path. Only http, https and paths of files are accepted."""
    scheme, separator, _ = text.partition("://")
    if separator:
        if scheme.lower() not in ("http", "https"):
            raise GraceError(f"cannot fetch {text}: only http, https and paths of files are accepted")
        try:
            parsed = urllib.parse.urlsplit(text)
            usable = bool(parsed.hostname) and parsed.port != 0
        except ValueError:
            usable = False
        if not usable or any(c.isspace() or not c.isprintable() or ord(c) > 126 for c in text):
            raise GraceError(f"cannot fetch {text!r}: this is not a proper address")
        return text
    return Path(text)


def _open(source: str | Path) -> BinaryIO:
    if isinstance(source, str):
        return _open_url(source)
    if not source.exists():
        raise GraceError(f"cannot read {source}: no such file; give the path of grace_latlong.exr")
    if not source.is_file():  # a pipe or a device could block for ever
        raise GraceError(f"cannot read {source}: not a regular file; give the path of grace_latlong.exr")
    return source.open("rb")


def fetch(source: str, out: Path, size: int = SIZE, sha256: str = SHA256) -> None:
    """Copy ``source`` (URL or path) to ``out`` if it has this size and sum.

    Raises :class:`GraceError` and leaves ``out`` as it was if anything is wrong.
    """
    where = _source(source)
    temporary: Path | None = None
    try:
        if out.exists() and not out.is_file():  # renaming onto a device would replace the device
            raise GraceError(f"cannot write {out}: not a regular file; give the name of a file with --out")
        # A signal waits while the file exists and its name is not yet noted.
        with _signals_wait():
            handle, name = tempfile.mkstemp(dir=out.parent, prefix=f".{out.stem}.", suffix=out.suffix)
            temporary = Path(name)
        with os.fdopen(handle, "wb", buffering=0) as target:
            _copy(where, target, size, sha256)
        # mkstemp makes files that only their owner reads; this is an ordinary file.
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)
        temporary.replace(out)
    except OSError as error:
        full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
        advice = f"free {size / 1e6:.1f} MB or choose another place" if full else "choose another place"
        raise GraceError(f"cannot write {out}: {error.strerror}; {advice} with --out") from error
    finally:
        if temporary is not None:
            with _signals_wait(), contextlib.suppress(OSError):
                temporary.unlink(missing_ok=True)


class _TargetError(Exception):
    """Carries an OSError of the target past the handling of those of the source."""

    def __init__(self, cause: OSError) -> None:
        super().__init__(str(cause))
        self.cause = cause


def _copy(source: str | Path, target: BinaryIO, size: int, sha256: str) -> None:
    digest = hashlib.sha256()

    def take(block: bytes) -> None:
        digest.update(block)
        view = memoryview(block)
        try:
            while view:
                view = view[target.write(view) :]
        except OSError as error:
            raise _TargetError(error) from error

    begun = False
    try:
        with _open(source) as stream:
            begun = True
            declared = getattr(stream, "length", None)
            count = _read(stream, size + 1, take, str(source))
    except _TargetError as error:
        raise error.cause from None
    except (OSError, http.client.HTTPException, ValueError) as error:
        if isinstance(source, Path):
            raise GraceError(f"cannot read {source}: {_reason(error)}") from error
        what = "the download of {} broke off" if begun else "cannot fetch {}"
        raise GraceError(f"{what.format(source)}: {_reason(error)}; try again or {ELSEWHERE}") from error
    if count < size and declared is not None and count < declared:
        raise GraceError(
            f"the download of {source} broke off after {count:,} of {declared:,} bytes; try again or {ELSEWHERE}"
        )
    if count != size:
        found = f"more than {size:,}" if count > size else f"{count:,}"
        raise GraceError(f"{source} is not the Grace map: {found} bytes instead of {size:,}; {ELSEWHERE}")
    if digest.hexdigest() != sha256:
        raise GraceError(
            f"{source} is not the Grace map: its SHA-256 is {digest.hexdigest()}, expected {sha256}; {ELSEWHERE}"
        )


@contextlib.contextmanager
def _signals_wait():  # type: ignore[no-untyped-def]
    if not hasattr(signal, "pthread_sigmask") or threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _terminated(number: int, frame: object) -> NoReturn:
    print("get_grace: terminated", file=sys.stderr)
    raise SystemExit(128 + number)  # unwinds, so that the temporary file goes


def _too_late(number: int, frame: object) -> NoReturn:
    raise GraceError(f"gave up after {DEADLINE:g} seconds; try again or {ELSEWHERE}")


def main() -> None:
    """Parse the command line and fetch."""
    out = Path(__file__).resolve().parent.parent / "data" / "grace_latlong.exr"
    parser = argparse.ArgumentParser(
        description="Fetch the Grace Cathedral light probe (Paul Debevec, 1998/1999; 1024 x 512, EXR).",
        epilog="example: scripts/get_grace.py --from ~/Downloads/grace_latlong.exr",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    parser.add_argument("--from", dest="source", default=URL, metavar="FILE_OR_URL", help="where to get it")
    parser.add_argument("--out", type=Path, default=out, metavar="FILE", help="the file to write")
    arguments = parser.parse_args()
    if not arguments.source:
        parser.error("argument --from: expected a path or an address")
    if matches(arguments.out, SIZE, SHA256):
        print(f"{arguments.out} is already there and is the right file: nothing to do")
        return
    for name in ("SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) is not signal.SIG_IGN:  # nohup ignores SIGHUP
            signal.signal(number, _terminated)
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if hasattr(signal, "SIGALRM"):
        # Looking up a name and reading headers have no bound of their own.
        signal.signal(signal.SIGALRM, _too_late)
        signal.setitimer(signal.ITIMER_REAL, DEADLINE + 1)
    fetch(arguments.source, arguments.out)
    print(f"wrote {arguments.out}: the Grace Cathedral light probe by Paul Debevec, {SIZE:,} bytes, sum checked")


if __name__ == "__main__":
    try:
        sys.stdout.reconfigure(errors="backslashreplace")  # names of files may hold any bytes
        main()
        sys.stdout.flush()
    except GraceError as error:
        # A name or a server's answer may hold line breaks and escape sequences.
        line = "".join(c if c.isprintable() else "?" for c in str(error))
        print(f"get_grace: {line}", file=sys.stderr)
        sys.exit(1)
    except KeyboardInterrupt:
        print("\nget_grace: interrupted", file=sys.stderr)
        sys.exit(130)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
