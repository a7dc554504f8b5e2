"""``python -m lightdome.probe``: the OpenCL devices and which is taken, by :mod:`lightdome.opencl.probe`."""

from .console import run
from .opencl.probe import main

if __name__ == "__main__":
    run(main)
