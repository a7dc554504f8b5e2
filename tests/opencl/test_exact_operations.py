"""Divisions and roots that are exact on every device, compared with integers and correct rounding."""

from __future__ import annotations

import numpy as np
import pyopencl as cl
import pytest
from lightdome.opencl import memory
from lightdome.opencl.device import Device
from lightdome.opencl.programs import source

# Some compilers print remarks even on success.
pytestmark = pytest.mark.filterwarnings("ignore::pyopencl.CompilerWarning")

KERNELS = """
kernel void quotients(global const ulong2 *of, global ulong *result)
{
    result[get_global_id(0)] = quotient(of[get_global_id(0)].x, of[get_global_id(0)].y);
}

kernel void roots(global const float *of, global float *result)
{
    result[get_global_id(0)] = exact_root(of[get_global_id(0)]);
}
"""


def run(device: Device, kernel: str, array: np.ndarray, off: int = 0) -> np.ndarray:
    """The result of ``kernel`` for ``array``; ``off`` is added to the device's roots of squares, 2^46 to 2^48."""
    text = source("common/within_pixel.clh").replace("sqrt((float)square)", f"(sqrt((float)square) + {off})")
    assert f"+ {off})" in text
    options = ["-cl-std=CL1.2", f"-DCPU={int(not device.is_gpu)}"]
    program = cl.Program(device.context, text + KERNELS).build(options)
    result = memory.empty(device, len(array), array.dtype.type)
    getattr(program, kernel)(device.queue, (len(array),), None, memory.upload(device, array).buffer, result.buffer)
    return memory.download(device, result)


def test_quotients_are_rounded_down_also_next_to_whole_ones(device: Device) -> None:
    rng = np.random.default_rng(0)
    d = [int(x) for x in np.exp2(rng.uniform(0, 32, 30_000))] + [1, 2, 3, 2**30, 2**31, 2**32 - 1, 2**32] * 100
    q = [int(x) for x in np.exp2(rng.uniform(0, 32, len(d)))]
    pairs = [(n, b) for a, b in zip(q, d, strict=True) for n in (a * b - 1, a * b, a * b + b - 1, a * b + b // 2)]
    pairs += [(n, b) for b in set(d) for n in (0, b - 1, min((b << 32) + b - 1, 2**64 - 1))]
    pairs = [(n, b) for n, b in pairs if n < min(2**64, (b << 32) + b)]
    found = run(device, "quotients", np.array(pairs, np.uint64))
    np.testing.assert_array_equal(found, np.array([n // b for n, b in pairs], np.uint64))


@pytest.mark.parametrize("off", [-3, -1, 0, 2, 3])  # units in the last place, up to what OpenCL allows a root
def test_roots_are_rounded_correctly_however_the_device_rounds_its_own(device: Device, off: int) -> None:
    rng = np.random.default_rng(1)
    squares = (np.arange(2**23, 2**24, 997, dtype=np.float64) * 2.0**-24) ** 2
    near = np.concatenate([np.nextafter(squares.astype(np.float32), np.float32(end)) for end in (0, 1)])
    x = np.concatenate([np.exp2(-rng.uniform(0, 100, 200_000)), squares, near, 2.0 ** -np.arange(100)])
    x = x.astype(np.float32)
    np.testing.assert_array_equal(run(device, "roots", x, off), np.sqrt(x))
