"""The console program: ``lightdome COMMAND [OPTION]...``, also as ``python -m lightdome``."""

from __future__ import annotations

import argparse
import os
import sys
from importlib import import_module

from .. import __version__
from ..console import run
from ..names import COMMANDS
from . import cli


def main() -> None:
    """Run the command named on the command line, and exit."""
    run(_command)


def _command() -> None:
    parser = cli.Parser(
        prog="lightdome",
        usage="%(prog)s COMMAND [OPTION]...",
        description="Image-based lighting with OpenCL: sample an environment map, shade with it, measure the error.",
        epilog="commands:\n"
        + "\n".join(f"  {name:<10} {command.purpose}" for name, command in COMMANDS.items())
        + "\n\nFor more, see: lightdome COMMAND --help",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"lightdome {__version__}")
    parser.add_argument("command", choices=COMMANDS, metavar="COMMAND", help="what to do, listed below")
    name = _to_complete() or parser.parse_args(sys.argv[1:2]).command
    sys.argv[:2] = [f"lightdome {name}"]  # the name in messages and in the command's own help
    import_module(f".{COMMANDS[name].module}", __package__).main()


def _to_complete() -> str | None:
    """The command whose options a shell wants to complete, if any; argcomplete then takes it as the program."""
    line = os.environ.get("COMP_LINE", "")[: int(os.environ.get("COMP_POINT", 0))]
    first = int(os.environ.get("_ARGCOMPLETE", 0))  # 1 if the program is the first word
    words = line.split()
    goes_on = len(words) > first + 1 or (len(words) == first + 1 and line[-1].isspace())
    if not first or not goes_on or words[first] not in COMMANDS:
        return None
    os.environ["_ARGCOMPLETE"] = str(first + 1)
    return words[first]
