"""The one way to launch a kernel, see :meth:`lightdome.opencl.device.Device.launch`."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from typing import TYPE_CHECKING

from ..progress import Progress
from .memory import DeviceArray

if TYPE_CHECKING:
    from .device import Device
    from .signature import Argument


def launch(
    device: Device,
    name: str,
    size: tuple[int, ...],
    arguments: Mapping[str, Argument],
    stage: str | None,
    defines: Mapping[str, int],
    group: int | None,
    step: int | None,
    progress: str | None,
) -> None:
    """Launch the kernel ``name``; see :meth:`lightdome.opencl.device.Device.launch` for the arguments."""
    _check(name, size, group, step)
    kernel = device.kernel(name, **defines)
    stage = stage or name.rpartition("/")[2]
    arrays = [value for value in arguments.values() if isinstance(value, DeviceArray)]
    local: tuple[int, ...] | None
    if group:
        size, local = (-(-size[0] // group) * group,), (group,)
    else:
        # Left to choose, PoCL takes another local size for nearly every global one, and compiles the kernel for each.
        # Work-items that have much to do are one a group on a CPU; a GPU's driver chooses.
        local = None if device.is_gpu else (1,) * len(size)
    length, *across = size
    step = step or length
    with Progress(progress) if progress else contextlib.nullcontext() as line:
        for begin in range(0, length, step):
            end = min(begin + step, length)
            offset = (begin, *(0 for _ in across))
            event = kernel(device.queue, (end - begin, *across), local, global_offset=offset, **arguments)
            device.profile.record(stage, event, arrays)
            if line and step < length:
                device.wait()
                line.update(end / length)


def _check(name: str, size: tuple[int, ...], group: int | None, step: int | None) -> None:
    """Refuse what would run no work-item, or others than were asked for."""
    if min(size, default=0) < 1:
        raise ValueError(f"the kernel {name} needs a size of at least one work-item, got {size}")
    if step is not None and step < 1:
        raise ValueError(f"the kernel {name} needs a step of at least one work-item, got {step}")
    if group is None:
        return
    if group < 1 or len(size) != 1:
        raise ValueError(f"the kernel {name}: groups need one dimension and a positive number, got {group} of {size}")
    if step is not None and step % group:
        raise ValueError(f"the kernel {name}: the step must be a multiple of the group, {group}, got {step}")
