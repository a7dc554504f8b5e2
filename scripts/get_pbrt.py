#!/usr/bin/env python3
"""Install pbrt-r4, a port of PBRT-v4 in Rust, where part 4 and the benchmark find it."""

import os
import sys

sys.path.insert(0, os.path.dirname(os.path.realpath(__file__)))  # noqa: PTH120 - missing under PYTHONSAFEPATH
import _start  # noqa: F401 - first, so that Ctrl-C is handled and .venv is found

# isort: split
import argparse
import atexit
import shutil
import subprocess
from pathlib import Path

from lightdome.console import run
from lightdome.errors import LightdomeError
from lightdome.pbrt.run import Pbrt, find_pbrt, installed_port, kill_session

CRATE, VERSION = "pbrt-r4", "4.5.2"


def installed(folder: Path) -> "Pbrt | None":
    """The program in ``folder``, if it is this version and runs."""
    try:
        program = find_pbrt(folder / "bin" / CRATE)
    except LightdomeError:
        return None
    return program if program.port == f"{CRATE} {VERSION}" else None


def main() -> None:
    """Build it with cargo, unless it is installed already."""
    parser = argparse.ArgumentParser(
        description="Install pbrt-r4, a port of PBRT-v4 in Rust, into lightdome's cache, where part 4, the benchmark"
        " and the report find it. Needs cargo and a network; takes about five minutes on two cores. To remove it,"
        " delete the folder that it prints.",
        epilog="example: scripts/get_pbrt.py --out ~/pbrt",
    )
    parser.add_argument(
        "--out",
        type=Path,
        metavar="DIR",
        default=installed_port().parent.parent,
        help="folder to install into (default: the cache; for another folder, give part 4 --pbrt DIR/bin)",
    )
    folder = parser.parse_args().out.absolute()
    program = installed(folder)
    if program:
        print(f"{program.name} is already installed: {program.path}")
        return
    cargo = shutil.which("cargo")
    if cargo is None:
        raise LightdomeError("no cargo on PATH; install Rust (https://rustup.rs), then run this again")
    print(f"installing {CRATE} {VERSION} into {folder}: about five minutes on two cores", flush=True)
    command = [cargo, "install", CRATE, "--version", VERSION, "--locked", "--no-default-features", "--bin", CRATE]
    # Without optimisation, the programs that generate its code take far longer to run than to compile.
    environment = {**os.environ, "CARGO_PROFILE_RELEASE_BUILD_OVERRIDE_OPT_LEVEL": "2"}
    try:
        process = subprocess.Popen(
            [*command, "--force", "--root", str(folder)],
            env=environment,
            stdin=subprocess.DEVNULL,
            start_new_session=True,
        )
    except OSError as error:
        raise LightdomeError(f"cannot start {cargo}: {error.strerror}; install Rust (https://rustup.rs)") from error
    atexit.register(kill_session, process)
    status = process.wait()
    program = installed(folder)
    if status != 0 or program is None:
        raise LightdomeError(
            f"cargo did not install {CRATE}, for the reason above; it needs a network and a recent Rust (rustup update)"
        )
    print(f"installed {program.name}: {program.path}")


if __name__ == "__main__":
    run(main)
