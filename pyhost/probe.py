"""Compile and run a trivial kernel on one OpenCL device; meant to run in a child process.

A broken OpenCL implementation lists its devices like a sound one, then fails every build or
aborts the process. So a device counts only after this, in a process that may die:

    python -m lightdome.probe PLATFORM_INDEX DEVICE_INDEX

exits with 0 if the device computes. Without indices, it tries every device in turn, prints the
name of the best one that works, and exits with 1 if there is none.
"""

from __future__ import annotations

import os
import sys

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
    if len(sys.argv) == 1:
        from .device import open_device
        from .errors import LightdomeError

        try:
            print(open_device().description)
        except LightdomeError as error:
            sys.exit(str(error))
        return

    # A binary from a better day says nothing about the compiler of today: no cache.
    os.environ["PYOPENCL_NO_CACHE"] = "1"
    os.environ["POCL_KERNEL_CACHE"] = "0"
    import numpy as np
    import pyopencl as cl

    device = cl.get_platforms()[int(sys.argv[1])].get_devices()[int(sys.argv[2])]
    context = cl.Context([device])
    queue = cl.CommandQueue(context)
    values = np.arange(1024, dtype=np.float32)
    buffer = cl.Buffer(context, cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR, hostbuf=values)
    cl.Program(context, _SOURCE).build().probe(queue, (values.size // 16,), None, buffer)
    result = np.empty_like(values)
    cl.enqueue_copy(queue, result, buffer)
    if not np.array_equal(result, values * 2 + 1):
        sys.exit("the device computed wrong numbers")


if __name__ == "__main__":
    main()
