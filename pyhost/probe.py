"""``python -m lightdome.probe``: one OpenCL device, in a process that may die, by :mod:`lightdome.opencl.probe`."""

from .console import run
from .opencl.probe import main

if __name__ == "__main__":
    run(main)
