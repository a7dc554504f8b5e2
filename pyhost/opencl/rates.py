"""Measure how fast an OpenCL device is, since what its implementation claims says little.

An implementation that claims fused multiply-adds may take five times as long for ``fma()`` as for a product and a sum,
and a newer implementation is not always faster. So a few small kernels run once for each device and version, in the
process in which :mod:`lightdome.probe` tries the device. Their rates decide which device is used, and how kernels write
a multiply-add.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import pyopencl as cl

from .memory import DeviceArray
from .programs import Programs

REPEATS = 15  # the fastest counts, since other programs on the machine can only slow it down
CHAINS, STEPS = 8, 2**11  # of multiply_add.cl
ITEMS_PER_UNIT, GPU_ITEMS_PER_UNIT = 64, 2048  # work-items per compute unit: a third of a millisecond on two fast cores
COPY_BYTES, COPY_BLOCK = 2**25, 2048  # read and written together; vectors per work-item
TRANSFER_BYTES = 2**24
MATRIX = 512  # rows and columns of the matrices that numpy multiplies

FUSED_PAYS = 0.9  # kernels use fma, which is also more exact, if its rate is at least this share of the plain rate
SLOW = 1 / 3  # a device is slow if its rate is below this share of numpy's

# A frame: roughly what one image takes.
FRAME_MULTIPLY_ADDS = 2**30
FRAME_COPIES = 2**26
FRAME_TRANSFERS = 2**24
FRAME_LAUNCHES = 16


@dataclass(frozen=True)
class Rates:
    """Measured rates, per second.

    - ``fused``, ``plain``: float32 multiply-adds, as ``fma(a, b, c)`` and as ``a * b + c`` rounded twice
    - ``copies``: bytes that a kernel reads and writes
    - ``transfers``: bytes between host and device; None if they share memory
    - ``launches``: empty kernels, one after the other
    - ``numpy``: float32 multiply-adds of numpy's matrix product on the same machine
    """

    fused: float
    plain: float
    copies: float
    transfers: float | None
    launches: float
    numpy: float

    @property
    def is_fused(self) -> bool:
        """Whether kernels should use ``fma``."""
        return self.fused >= FUSED_PAYS * self.plain

    @property
    def multiply_adds(self) -> float:
        """Multiply-adds per second, in the faster of the two forms."""
        return self.fused if self.is_fused else self.plain

    @property
    def is_slow(self) -> bool:
        """Whether the device does less than a third of numpy's multiply-adds on the same machine."""
        return self.multiply_adds < SLOW * self.numpy

    @property
    def frame_seconds(self) -> float:
        """Seconds for a frame: 2^30 multiply-adds, 64 MiB read and written, 16 MiB transferred and 16 launches."""
        transfer = FRAME_TRANSFERS / self.transfers if self.transfers else 0.0
        return (
            FRAME_MULTIPLY_ADDS / self.multiply_adds
            + FRAME_COPIES / self.copies
            + transfer
            + FRAME_LAUNCHES / self.launches
        )

    def to_json(self) -> dict[str, float | None]:
        """Plain numbers, for :meth:`from_json`."""
        return asdict(self)

    @classmethod
    def from_json(cls, values: object) -> Rates:
        """The rates that :meth:`to_json` returned. Raises ``TypeError`` or ``ValueError`` for anything else."""
        if not isinstance(values, dict):
            raise TypeError("rates are an object")
        result = cls(**values)
        for name, value in values.items():
            if not (value is None and name == "transfers") and not 0 < float(value) < float("inf"):
                raise ValueError(f"{name} must be a positive number")
        return result


def measure(context: cl.Context) -> Rates:
    """Measure the one device of ``context``: a fraction of a second."""
    (device,) = context.devices
    queue = cl.CommandQueue(context, properties=cl.command_queue_properties.PROFILING_ENABLE)
    programs = Programs(context)
    is_gpu = bool(device.type & cl.device_type.GPU)
    local = None if is_gpu else (1,)

    def room(size: int) -> DeviceArray:
        return DeviceArray(cl.Buffer(context, cl.mem_flags.READ_WRITE, size), (size // 4,), np.dtype(np.float32), None)

    chains, block = (1, 1) if is_gpu else (CHAINS, COPY_BLOCK)
    items = (GPU_ITEMS_PER_UNIT if is_gpu else ITEMS_PER_UNIT) * device.max_compute_units
    result = room(64 * items)

    def multiply_add(fused: int) -> Callable[[], cl.Event]:
        kernel = programs.kernel("limits/multiply_add", CHAINS=chains, FUSED=fused)
        return lambda: kernel(queue, (items,), local, factor=1, term=1, steps=STEPS, result=result)

    fused, plain = (16 * chains * STEPS * items / s for s in _on_device(multiply_add(1), multiply_add(0)))
    source, target = (room(COPY_BYTES // 2) for _ in range(2))
    for array in (source, target):  # touch all pages first
        cl.enqueue_fill_buffer(queue, array.buffer, np.ones(1, np.float32), 0, COPY_BYTES // 2)
    copy, count = programs.kernel("limits/copy", VECTORS=block), COPY_BYTES // 2 // (16 * block)
    launch = programs.kernel("limits/launch")
    arguments: dict[str, Any] = {"from": source, "to": target}  # `from` is a Python keyword
    (copy_seconds,) = _on_device(lambda: copy(queue, (count,), local, **arguments))
    return Rates(
        fused=fused,
        plain=plain,
        copies=COPY_BYTES / copy_seconds,
        transfers=None if device.type & cl.device_type.CPU else _transfers(queue, source.buffer),
        launches=1 / _on_host(lambda: launch(queue, (1,), (1,)).wait()),
        numpy=_numpy(),
    )


def _transfers(queue: cl.CommandQueue, buffer: cl.Buffer) -> float:
    half = np.ones(TRANSFER_BYTES // 8, np.float32)

    def both_ways() -> None:
        cl.enqueue_copy(queue, buffer, half)
        cl.enqueue_copy(queue, half, buffer)

    return TRANSFER_BYTES / _on_host(both_ways)


def _numpy() -> float:
    matrix = np.ones((MATRIX, MATRIX), np.float32)
    out = np.empty_like(matrix)
    return MATRIX**3 / _on_host(lambda: np.matmul(matrix, matrix, out=out))


def _on_device(*starts: Callable[[], cl.Event]) -> list[float]:
    """The shortest device time of each, in seconds. They take turns, so that other programs slow all of them alike."""
    seconds: list[list[float]] = [[] for _ in starts]
    for _ in range(1 + REPEATS):
        for start, of_start in zip(starts, seconds, strict=True):
            event = start()
            event.wait()
            of_start.append(max(event.profile.end - event.profile.start, 1) * 1e-9)
    return [min(of_start[1:]) for of_start in seconds]


def _on_host(run: Callable[[], object]) -> float:
    """The shortest time by the host's clock, in seconds."""
    seconds = []
    for _ in range(1 + REPEATS):
        begin = time.perf_counter()
        run()
        seconds.append(time.perf_counter() - begin)
    return max(min(seconds[1:]), 1e-9)
