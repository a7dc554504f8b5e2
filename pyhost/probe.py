"""``python -m lightdome.probe``: try an OpenCL device in a process that may crash, by :mod:`lightdome.opencl.probe`."""

from .console import run
from .opencl.probe import main

if __name__ == "__main__":
    run(main)
