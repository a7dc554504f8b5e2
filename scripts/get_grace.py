#!/usr/bin/env python3
"""Fetch the Grace Cathedral light probe (Paul Debevec, 1998/1999).

Standard library only, so that it runs before anything is installed. The file appears under its final name only if its
size and SHA-256 are right.
"""

import os
import signal

if __name__ == "__main__":  # before the other imports, so that Ctrl-C works while they load
    for _number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(_number) is not signal.SIG_IGN:  # as a shell does for background jobs
            signal.signal(_number, lambda number, _: os._exit(128 + number))

import argparse
import contextlib
import hashlib
import http.client
import sys
import urllib.request
from pathlib import Path

URL = "https://raw.githubusercontent.com/mmp/pbrt-v2/master/scenes/textures/grace_latlong.exr"
SIZE = 1_726_329
SHA256 = "7c017bce200658354d72774712e51f039d472aa1399a91c2d0e3eb81ca909079"
SILENCE = 20  # seconds to wait for a connection or for a byte
ELSEWHERE = "try again, or get the file elsewhere and pass it with --from FILE"


def read(source: str, size: int) -> bytes:
    """The content of ``source``, a URL or a path, up to one byte more than ``size``.

    Raises SystemExit with one line if it cannot be read.
    """
    is_url = source.startswith(("http://", "https://"))
    try:
        with urllib.request.urlopen(source, timeout=SILENCE) if is_url else Path(source).open("rb") as stream:
            return stream.read(size + 1)
    except (OSError, http.client.HTTPException, ValueError) as error:
        # A server's reply may contain line breaks and escape sequences.
        reason = "".join(c if c.isprintable() else "?" for c in str(getattr(error, "strerror", None) or error))
        sys.exit(f"get_grace: cannot read {source}: {reason}; {ELSEWHERE}")


def fetch(source: str, out: Path, size: int = SIZE, sha256: str = SHA256) -> None:
    """Copy ``source``, a URL or a path, to ``out`` if it has this size and SHA-256.

    If anything is wrong, raises SystemExit with one line, and leaves ``out`` as it was.
    """
    content = read(source, size)
    if len(content) != size:
        found = f"more than {size:,}" if len(content) > size else f"{len(content):,}"
        sys.exit(f"get_grace: {source} is not the Grace map: {found} bytes instead of {size:,}; {ELSEWHERE}")
    digest = hashlib.sha256(content).hexdigest()
    if digest != sha256:
        sys.exit(f"get_grace: {source} is not the Grace map: its SHA-256 is {digest}, expected {sha256}; {ELSEWHERE}")
    if out.exists() and not out.is_file():  # it would replace a device
        sys.exit(f"get_grace: cannot write {out}: it is not a regular file; choose another file with --out")
    temporary = out.with_name(f".{out.name}.part")
    try:
        temporary.write_bytes(content)
        temporary.replace(out)
    except OSError as error:
        with contextlib.suppress(OSError):
            temporary.unlink()
        sys.exit(f"get_grace: cannot write {out}: {error.strerror}; choose another file with --out")


def main() -> None:
    """Parse the command line and fetch."""
    out = Path(__file__).resolve().parent.parent / "data" / "grace_latlong.exr"
    parser = argparse.ArgumentParser(
        description="Fetch the Grace Cathedral light probe (Paul Debevec, 1998/1999; 1024 x 512, EXR).",
        epilog="example: scripts/get_grace.py --from ~/Downloads/grace_latlong.exr",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    parser.add_argument("--from", dest="source", default=URL, metavar="FILE_OR_URL", help="where to get the map")
    parser.add_argument("--out", type=Path, default=out, metavar="FILE", help="file to write")
    arguments = parser.parse_args()
    if arguments.out.is_file() and hashlib.sha256(arguments.out.read_bytes()).hexdigest() == SHA256:
        print(f"{arguments.out} already exists and is the right file: nothing to do")
        return
    fetch(arguments.source, arguments.out)
    print(f"wrote {arguments.out}: the Grace Cathedral light probe by Paul Debevec, {SIZE:,} bytes, checksum verified")


if __name__ == "__main__":
    main()
