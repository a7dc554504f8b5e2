"""Compile and run a trivial kernel on one OpenCL device; meant to run in a child process.

A broken OpenCL implementation lists its devices like a sound one, then fails every build or
aborts the process. So a device counts only after this, in a process that may die:

    python -m lightdome.probe PLATFORM DEVICE

exits with 0 if the device of these indices computes. Without indices, it tries every device in turn, prints the
name of the best one that works, and exits with 1 if there is none.
"""

from __future__ import annotations

import argparse
import os

from .cache import ensure_room
from .cli import run
from .errors import LightdomeError

# With a vector of 16, as lightdome's kernels have: some compilers fail only on those.
_SOURCE = """
kernel void probe(global float *a)
{
    const size_t i = get_global_id(0);
    vstore16(vload16(i, a) * 2.0f + 1.0f, i, a);
}
"""


def main() -> None:
    """Probe the device that the command line names, or find one that works."""
    parser = argparse.ArgumentParser(
        prog="python -m lightdome.probe",
        usage="%(prog)s [-h] [PLATFORM DEVICE]",
        description="Print the best OpenCL device that works, or test whether the one at these indices runs a kernel.",
    )
    parser.add_argument("platform", type=int, nargs="?", metavar="PLATFORM", help="index of the platform, from 0")
    parser.add_argument("device", type=int, nargs="?", metavar="DEVICE", help="index of the device in it, from 0")
    args = parser.parse_args()
    if args.platform is None:
        from .device import open_device

        print(open_device().description)
    elif args.device is None:
        parser.error("expected the index of a device too")
    else:
        probe(args.platform, args.device)


def probe(platform: int, device: int) -> None:
    """Compile and run a kernel on the device of these indices, or raise :class:`LightdomeError`."""
    # A binary from a better day says nothing about the compiler of today: no cache.
    os.environ["PYOPENCL_NO_CACHE"] = "1"
    os.environ["POCL_KERNEL_CACHE"] = "0"
    ensure_room()
    import numpy as np
    import pyopencl as cl

    try:
        devices = [found.get_devices() for found in cl.get_platforms()]
    except cl.Error:  # the loader's way to say that there are none
        devices = []
    if not (0 <= platform < len(devices) and 0 <= device < len(devices[platform])):
        there = ", ".join(f"{p} {d}" for p, of_platform in enumerate(devices) for d in range(len(of_platform)))
        raise LightdomeError(f"there is no OpenCL device {platform} {device}; the devices are {there or 'none at all'}")
    values = np.arange(1024, dtype=np.float32)
    result = np.empty_like(values)
    try:
        context = cl.Context([devices[platform][device]])
        queue = cl.CommandQueue(context)
        buffer = cl.Buffer(context, cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR, hostbuf=values)
        cl.Program(context, _SOURCE).build().probe(queue, (values.size // 16,), None, buffer)
        cl.enqueue_copy(queue, result, buffer)
    except cl.Error as error:
        raise LightdomeError(f"the device fails: {' '.join(str(error).split())}") from error
    if not np.array_equal(result, values * 2 + 1):
        raise LightdomeError("the device computed wrong numbers")


if __name__ == "__main__":
    run(main)
