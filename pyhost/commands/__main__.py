"""``python -m lightdome.commands NAME [OPTION]...``: run a command as the script of its name does."""

import argparse
import sys
from importlib import import_module

from ..console import run
from ..names import COMMANDS


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m lightdome.commands",
        usage="%(prog)s NAME [OPTION]...",
        description="Run a command of lightdome without its script. NAME --help says what it does.",
    )
    parser.add_argument("name", choices=COMMANDS, metavar="NAME", help=", ".join(COMMANDS))
    command = import_module(f".{parser.parse_args(sys.argv[1:2]).name}", __package__)
    sys.argv[:2] = [str(command.__file__)]  # what messages and the command's own parser take its name from
    command.main()


if __name__ == "__main__":
    run(main)
