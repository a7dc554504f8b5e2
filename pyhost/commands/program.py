"""The console program: ``lightdome COMMAND [OPTION]...``, also as ``python -m lightdome``."""

from __future__ import annotations

import argparse
import sys
from importlib import import_module

from .. import __version__
from ..console import run
from ..names import COMMANDS


def main() -> None:
    """Run the command that the command line names, and exit."""
    run(_command)


def _command() -> None:
    parser = argparse.ArgumentParser(
        prog="lightdome",
        usage="%(prog)s COMMAND [OPTION]...",
        description="Image-based lighting with OpenCL: sample an environment map, shade with it, measure the error.",
        epilog="commands:\n"
        + "\n".join(f"  {name:<10} {command.purpose}" for name, command in COMMANDS.items())
        + "\n\nlightdome COMMAND --help says more of each.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"lightdome {__version__}")
    parser.add_argument("command", choices=COMMANDS, metavar="COMMAND", help="what to do, see below")
    name = parser.parse_args(sys.argv[1:2]).command
    sys.argv[:2] = [f"lightdome {name}"]  # what messages and the command's own parser call themselves
    import_module(f".{COMMANDS[name].module}", __package__).main()
