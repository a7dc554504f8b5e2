"""``python -m lightdome.commands NAME [OPTION]...``: run a command as the script of its name does."""

import sys
from importlib import import_module

from ..console import run

if __name__ == "__main__":
    del sys.argv[0]
    run(import_module(f".{sys.argv[0]}", __package__).main)
