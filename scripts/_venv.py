"""Goes on in .venv, where scripts/demo installs lightdome, if the Python that runs a script does not have it.

The scripts import this before anything else. This file, and the syntax of theirs, stay within Python 3.6: a Python that
is too old for lightdome is no reason for a traceback.
"""

import contextlib
import importlib.util
import os
import shlex
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def has_lightdome() -> bool:
    """Whether this Python can run lightdome; a mere folder of that name has no file, and does not count."""
    if sys.version_info < (3, 10):  # noqa: UP036 - an older one may well run this
        return False
    found = importlib.util.find_spec("lightdome")
    return found is not None and found.origin is not None


def go_on_in_venv() -> None:
    """Run the same command with the Python of .venv; return if there is none, or if it is what runs already."""
    python = str(ROOT / ".venv" / "bin" / "python")
    if sys.executable != python:
        with contextlib.suppress(OSError):
            os.execv(python, [python, *getattr(sys, "orig_argv", ["", *sys.argv])[1:]])


if not has_lightdome():
    go_on_in_venv()
    version = "{}.{}.{}".format(*sys.version_info)
    demo = shlex.quote(str(ROOT / "scripts" / "demo"))
    sys.exit(f"{Path(sys.argv[0]).stem}: Python {version} has no lightdome; run {demo}, which sets it up")
