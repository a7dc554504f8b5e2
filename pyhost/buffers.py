"""Move arrays between host and device; in place where the device shares the host's memory."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pyopencl as cl

from .device import Device


@dataclass(frozen=True)
class DeviceArray:
    """A numpy array's shape and type, and the OpenCL buffer that holds its values."""

    buffer: cl.Buffer
    shape: tuple[int, ...]
    dtype: np.dtype
    host: np.ndarray | None  # the memory itself, where host and device share it


def upload(device: Device, array: np.ndarray, stage: str = "upload") -> DeviceArray:
    """Make ``array`` readable for kernels. Shared memory is not copied: leave ``array`` unchanged."""
    array = np.ascontiguousarray(array)
    flags = cl.mem_flags.READ_ONLY
    if device.shares_host_memory:
        buffer = cl.Buffer(device.context, flags | cl.mem_flags.USE_HOST_PTR, hostbuf=array)
        return DeviceArray(buffer, array.shape, array.dtype, array)
    buffer = cl.Buffer(device.context, flags, array.nbytes)
    device.profile.record(stage, cl.enqueue_copy(device.queue, buffer, array, is_blocking=False))
    return DeviceArray(buffer, array.shape, array.dtype, None)


def empty(device: Device, shape: int | tuple[int, ...], dtype: type) -> DeviceArray:
    """Room for a kernel's result, not initialised."""
    shape = (shape,) if isinstance(shape, int) else shape
    kind = np.dtype(dtype)
    flags = cl.mem_flags.READ_WRITE
    if device.shares_host_memory:
        host = np.empty(shape, kind)
        return DeviceArray(
            cl.Buffer(device.context, flags | cl.mem_flags.USE_HOST_PTR, hostbuf=host), shape, kind, host
        )
    size = int(np.prod(shape, dtype=np.int64)) * kind.itemsize
    return DeviceArray(cl.Buffer(device.context, flags, size), shape, kind, None)


def zeros(device: Device, shape: int | tuple[int, ...], dtype: type) -> DeviceArray:
    """Room for a kernel's result, all zero."""
    array = empty(device, shape, dtype)
    size = int(np.prod(array.shape, dtype=np.int64)) * array.dtype.itemsize
    device.profile.record("clear", cl.enqueue_fill_buffer(device.queue, array.buffer, np.uint8(0), 0, size))
    return array


def download(device: Device, array: DeviceArray, stage: str = "download") -> np.ndarray:
    """The values of ``array`` once all kernels before have run; shared memory is not copied."""
    if array.host is not None:
        mapped, event = cl.enqueue_map_buffer(
            device.queue, array.buffer, cl.map_flags.READ, 0, array.shape, array.dtype
        )
        device.profile.record(stage, event)
        mapped.base.release(device.queue)
        return array.host
    result = np.empty(array.shape, array.dtype)
    device.profile.record(stage, cl.enqueue_copy(device.queue, result, array.buffer))
    return result
