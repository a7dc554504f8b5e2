"""Move arrays between host and device; in place where the device shares the host's memory."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pyopencl as cl

from ..errors import LightdomeError

if TYPE_CHECKING:
    from .device import Device

CACHE_LINE = 64  # bytes


@dataclass(frozen=True)
class DeviceArray:
    """A numpy array's shape and type, and the OpenCL buffer that holds its values."""

    buffer: cl.Buffer
    shape: tuple[int, ...]
    dtype: np.dtype
    host: np.ndarray | None  # the memory itself, if host and device share it
    is_read_only: bool = False  # if uploaded: a kernel that wrote to it would change the caller's own array


def upload(device: Device, array: np.ndarray) -> DeviceArray:
    """Make ``array`` readable by kernels, which cannot write to it.

    Do not change ``array`` until every kernel that reads it is done: shared memory is not copied, and a copy to a
    device with its own memory may still be under way on return. Raises :class:`LightdomeError` if the device does not
    have enough memory.
    """
    array = np.ascontiguousarray(array)
    flags = cl.mem_flags.READ_ONLY
    if device.shares_host_memory:
        device.decisions.skip("copies between host and device", "it works on the host's memory")
        return DeviceArray(_buffer(device, flags, array.nbytes, array), array.shape, array.dtype, array, True)
    device.decisions.use("copies between host and device", "the device has a memory of its own")
    buffer = _buffer(device, flags, array.nbytes, None)
    device.profile.record("upload", cl.enqueue_copy(device.queue, buffer, array, is_blocking=False), array)
    return DeviceArray(buffer, array.shape, array.dtype, None, True)


def empty(device: Device, shape: int | tuple[int, ...], dtype: type) -> DeviceArray:
    """An array for a kernel's result, not initialised.

    Raises :class:`LightdomeError` if the device does not have enough memory.
    """
    shape = (shape,) if isinstance(shape, int) else shape
    kind = np.dtype(dtype)
    size = math.prod(shape) * kind.itemsize
    check_room(device, size)
    host = _aligned(shape, kind) if device.shares_host_memory else None
    return DeviceArray(_buffer(device, cl.mem_flags.READ_WRITE, size, host), shape, kind, host)


def _aligned(shape: tuple[int, ...], kind: np.dtype) -> np.ndarray:
    """An uninitialised array that begins at a cache line, as vectors of 16 must."""
    memory = np.empty(math.prod(shape) * kind.itemsize + CACHE_LINE, np.uint8)
    return np.ndarray(shape, kind, memory, -memory.ctypes.data % CACHE_LINE)


# Why no index in a kernel overflows: larger arrays are refused here, or by the host. Columns, rows and lights are
# counted in 32 bits; 2^32 of them would take 48 GiB of map or 96 GiB of lights. There are fewer than 2^31 samples.
# Products such as y * width + x or 3 i are computed in size_t, except for an image's pixels, where at the largest
# resolution, 16384, no product exceeds 2^29.
def check_room(device: Device, size: int) -> None:
    """Raise :class:`LightdomeError` if the device cannot hold an array of ``size`` bytes."""
    room = device.handle.max_mem_alloc_size
    if size > room:
        device.wait()  # the process may end next, and would crash while a kernel is still being compiled
        raise LightdomeError(
            f"the device holds arrays of up to {room >> 20} MiB and this needs {size >> 20} MiB;"
            " use fewer samples, a smaller map or image, or another --device"
        )


def _buffer(device: Device, flags: int, size: int, host: np.ndarray | None) -> cl.Buffer:
    device.programs.check_process()
    check_room(device, size)
    try:
        if host is None:
            return cl.Buffer(device.context, flags, size)
        return cl.Buffer(device.context, flags | cl.mem_flags.USE_HOST_PTR, hostbuf=host)
    except cl.Error as error:
        raise LightdomeError(
            f"not enough memory on the device for {size >> 20} MiB ({error}); use fewer samples or a smaller map"
        ) from error


def zeros(device: Device, shape: int | tuple[int, ...], dtype: type) -> DeviceArray:
    """An array for a kernel's result, all zero."""
    return full(device, shape, 0, dtype)


def full(device: Device, shape: int | tuple[int, ...], value: float, dtype: type) -> DeviceArray:
    """An array filled with ``value``."""
    array = empty(device, shape, dtype)
    size = math.prod(array.shape) * array.dtype.itemsize
    pattern = np.array(value, array.dtype if value else np.uint8)  # PoCL fills faster by single bytes
    event = cl.enqueue_fill_buffer(device.queue, array.buffer, pattern, 0, size)
    device.profile.record("clear", event, array)
    return array


def download(device: Device, array: DeviceArray) -> np.ndarray:
    """The values of ``array`` once all kernels launched so far have run; shared memory is not copied."""
    (result,) = download_all(device, [array])
    return result


def download_all(device: Device, arrays: Sequence[DeviceArray]) -> list[np.ndarray]:
    """:func:`download` one or more arrays, and wait only once."""
    device.programs.check_process()
    results, mapped = [], []
    for array in arrays:
        if array.host is None:
            results.append(np.empty(array.shape, array.dtype))
            done = cl.enqueue_copy(device.queue, results[-1], array.buffer, is_blocking=False)
            device.profile.record("download", done, results[-1])
        else:
            results.append(array.host)
            memory, done = cl.enqueue_map_buffer(
                device.queue, array.buffer, cl.map_flags.READ, 0, array.shape, array.dtype, is_blocking=False
            )
            mapped.append((memory.base, array))
    done.wait()
    for memory, array in mapped:
        device.profile.record("download", memory.release(device.queue), array)
    return results
