"""Try OpenCL devices, and measure their speed.

A broken OpenCL implementation lists its devices just as a working one does, then fails every build or aborts the
process. So a device counts only once this command has succeeded, in a process that may die:

    python -m lightdome.probe PLATFORM DEVICE

It compiles and runs a kernel on the device with these indices, prints its :class:`lightdome.opencl.rates.Rates` as JSON
and exits with 0, or says in one line why the device fails and exits with 1.
"""

from __future__ import annotations

import argparse
import json
import os
from typing import TYPE_CHECKING

from ..cache import ensure_room
from ..errors import LightdomeError

if TYPE_CHECKING:
    from .rates import Rates

# With vectors of 16, as in lightdome's kernels, because some compilers fail only on those.
_SOURCE = """
kernel void probe(global float *a)
{
    const size_t i = get_global_id(0);
    vstore16(vload16(i, a) * 2.0f + 1.0f, i, a);
}
"""


def main() -> None:
    """Probe the device that the command line names."""
    parser = argparse.ArgumentParser(
        prog="python -m lightdome.probe",
        description="Test whether the OpenCL device at these indices runs a kernel, and print its rates as JSON."
        " To list all devices: lightdome devices.",
    )
    parser.add_argument("platform", type=int, metavar="PLATFORM", help="index of the platform, from 0")
    parser.add_argument("device", type=int, metavar="DEVICE", help="index of the device in it, from 0")
    args = parser.parse_args()
    print(json.dumps(probe(args.platform, args.device).to_json()))


def probe(platform: int, device: int) -> Rates:
    """The rates of the device with these indices.

    Raises :class:`LightdomeError` if it does not compile and run kernels.
    """
    # No caches: a cached binary does not tell whether the compiler works now.
    os.environ["PYOPENCL_NO_CACHE"] = "1"
    os.environ["POCL_KERNEL_CACHE"] = "0"
    ensure_room()
    import numpy as np
    import pyopencl as cl

    from .programs import compiler_says
    from .rates import measure

    try:
        devices = [found.get_devices() for found in cl.get_platforms()]
    except cl.Error:  # how the loader reports that there are no platforms
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
        if not np.array_equal(result, values * 2 + 1):
            raise LightdomeError("the device computed wrong numbers")
        return measure(context)
    except cl.Error as error:
        raise LightdomeError(f"the device fails: {compiler_says(error)}") from error
