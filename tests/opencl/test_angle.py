"""The kernels' angle functions compared with float64."""

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
kernel void sines(global const uint *u, global float2 *result)
{
    float sine, cosine;
    sine_cosine(u[get_global_id(0)], &sine, &cosine);
    result[get_global_id(0)] = (float2)(sine, cosine);
}

kernel void sines_of_turns(global const float *t, global float2 *result)
{
    float sine, cosine;
    sine_cosine_of_turns(t[get_global_id(0)], &sine, &cosine);
    result[get_global_id(0)] = (float2)(sine, cosine);
}

kernel void angles(global const float2 *v, global float *result)
{
    result[get_global_id(0)] = turns(v[get_global_id(0)].y, v[get_global_id(0)].x);
}
"""


def run(device: Device, kernel: str, array: np.ndarray, columns: int) -> np.ndarray:
    program = cl.Program(device.context, source("common/angle.clh") + KERNELS).build(["-cl-std=CL1.2"])
    result = memory.empty(device, (len(array), columns), np.float32)
    getattr(program, kernel)(device.queue, (len(array),), None, memory.upload(device, array).buffer, result.buffer)
    return memory.download(device, result)


def test_sines_of_all_parts_of_a_turn(device: Device) -> None:
    u = np.linspace(0, 2**32, 100_003, endpoint=False).astype(np.uint32)
    u = np.concatenate([u, np.arange(0, 2**32, 2**28, dtype=np.uint32), np.array([2**32 - 1], np.uint32)])
    angle = 2 * np.pi * u.astype(np.float64) / 2**32
    np.testing.assert_allclose(run(device, "sines", u, 2), np.stack([np.sin(angle), np.cos(angle)], axis=1), atol=2e-7)


def test_sines_of_turns(device: Device) -> None:
    t = np.linspace(0, 1, 100_003, dtype=np.float32)
    angle = 2 * np.pi * t.astype(np.float64)
    expected = np.stack([np.sin(angle), np.cos(angle)], axis=1)
    np.testing.assert_allclose(run(device, "sines_of_turns", t, 2), expected, atol=2e-7)


def test_angles_of_all_directions(device: Device) -> None:
    angle = np.linspace(-np.pi, np.pi, 100_003)
    v = np.stack([np.cos(angle), np.sin(angle)], axis=1).astype(np.float32)
    axes = np.array([(1, 0), (0, 1), (0, -1), (1, 1e-30), (1e-30, 1), (0, 0)], np.float32)
    v = np.concatenate([v[1:-1], axes])
    expected = np.arctan2(v[:, 1].astype(np.float64), v[:, 0]) / (2 * np.pi)
    np.testing.assert_allclose(run(device, "angles", v, 1)[:, 0], expected, atol=1e-7)
