"""Imported first by every script: lets Ctrl-C, SIGTERM and SIGHUP end it at once, and finds the Python of .venv.

If the Python that runs a script has no lightdome, the script starts again with the Python of .venv, where scripts/demo
installs lightdome. This file, and the syntax of the scripts, must stay within Python 3.6, so that a Python too old for
lightdome does not end in a traceback.
"""

import os
import signal
import sys

# If not a script, then a test imports this.
FOLDER = os.path.dirname(os.path.realpath(__file__))  # noqa: PTH120
IS_SCRIPT = os.path.dirname(os.path.realpath(sys.argv[0])) in (FOLDER, os.path.join(os.path.dirname(FOLDER), "data"))  # noqa: PTH118, PTH120

SIGNALS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]

if IS_SCRIPT:
    for _number in SIGNALS:
        if signal.getsignal(_number) is not signal.SIG_IGN:  # as a shell does for background jobs
            signal.signal(_number, lambda number, _: os._exit(128 + number))
    if hasattr(signal, "pthread_sigmask"):  # not on Windows
        signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)  # blocked by go_on_in_venv

import contextlib  # noqa: E402
import importlib  # noqa: E402
import importlib.util  # noqa: E402
import shlex  # noqa: E402
from pathlib import Path  # noqa: E402

ROOT = Path(__file__).resolve().parent.parent


def has_lightdome() -> bool:
    """Whether this Python can run lightdome; a folder of that name that is not a package does not count."""
    if sys.version_info < (3, 10):  # noqa: UP036 - an older one may well run this
        return False
    found = importlib.util.find_spec("lightdome")
    return found is not None and found.origin is not None


def go_on_in_venv() -> None:
    """Run the same command with the Python of .venv; return if there is none, or if it is already running."""
    python = str(ROOT / ".venv" / "bin" / "python")
    if sys.executable != python and os.access(python, os.X_OK) and os.environ.get("LIGHTDOME_VENV") != python:
        os.environ["LIGHTDOME_VENV"] = python  # try only once: it may be a wrapper around a Python of another name
        signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)  # delivered once that Python can handle them
        with contextlib.suppress(OSError):
            os.execv(python, [python, *getattr(sys, "orig_argv", ["", *sys.argv])[1:]])


if not has_lightdome():
    go_on_in_venv()
    version = "{}.{}.{}".format(*sys.version_info)
    demo = shlex.quote(str(ROOT / "scripts" / "demo"))
    sys.exit(f"{Path(sys.argv[0]).stem}: Python {version} has no lightdome; run {demo}, which sets it up")


def command(name: str) -> None:
    """Run the command in ``lightdome.commands.name``, and exit."""
    from lightdome import console

    console.run(importlib.import_module(f"lightdome.commands.{name}").main)
