"""The one way to launch a kernel: :meth:`lightdome.opencl.device.Device.launch`."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from ..progress import Progress
from .memory import DeviceArray

if TYPE_CHECKING:
    from .device import Device
    from .signature import Argument

GROUP = 256  # work-items on a GPU that share local memory


def launch(
    device: Device,
    name: str,
    size: tuple[int, ...],
    /,
    *,
    stage: str | None = None,
    defines: Mapping[str, int] | None = None,
    group: int | None = None,
    step: int | None = None,
    progress: str | None = None,
    **arguments: Argument,
) -> None:
    """Launch a kernel, such as ``sampling/guide``, over ``size`` work-items; it may still be running on return.

    ``arguments`` are named as in the kernel's signature and cast to its types: device arrays for pointers, numbers for
    scalars, sequences of numbers for vectors. The arrays are kept alive until the kernel is done.

    - ``stage``: the name in the profile; by default the kernel's
    - ``defines``: the preprocessor defines that the kernel is built with
    - ``group``: work-items per group, for short work-items; the size is rounded up to whole groups, and the kernel must
      ignore the work-items beyond it
    - ``step``: work-items per launch, see :meth:`lightdome.opencl.device.Device.items_per_launch`. The launches run one
      after the other, and a line that begins with ``progress`` shows how far along they are

    Raises ``TypeError`` for arguments that do not match the kernel's signature; ``ValueError`` for an empty size, for a
    group in more than one dimension, and for a step that is not a multiple of the group; and :class:`LightdomeError`
    if the device's compiler refuses the kernel, or in a forked process.
    """
    _check(name, size, group, step)
    kernel = device.kernel(name, **(defines or {}))
    stage = stage or name.rpartition("/")[2]
    arrays = [value for value in arguments.values() if isinstance(value, DeviceArray)]
    local: tuple[int, ...] | None
    if group:
        size, local = (-(-size[0] // group) * group,), (group,)
    else:
        # If left to choose, PoCL picks a different local size for nearly every global size, and compiles the kernel for
        # each. So on a CPU, where a work-item does much, a group is a single work-item. On a GPU, the driver chooses.
        local = None if device.is_gpu else (1,) * len(size)
    length, *across = size
    step = step or length
    with Progress(progress) if progress and step < length else contextlib.nullcontext() as line:
        for begin in range(0, length, step):
            end = min(begin + step, length)
            offset = (begin, *(0 for _ in across))
            event = kernel(device.queue, (end - begin, *across), local, global_offset=offset, **arguments)
            device.profile.record(stage, event, arrays)
            if line:
                device.wait()
                line.update(end / length)


def launch_rows(
    device: Device,
    name: str,
    count: int | tuple[int, int],
    /,
    *,
    defines: Mapping[str, int] | None = None,
    step: int | None = None,
    group: int = GROUP,
    **options: Any,
) -> None:
    """:func:`launch` a kernel over ``count`` rows, or other parts of a map or image, in the variant for the device.

    On a CPU, each row is a work-item of the kernel ``name``. On a GPU, each is a group of ``group`` work-items of the
    kernel ``name`` + ``_grouped``. ``step`` counts rows. If ``count`` is (across, down), a GPU numbers the groups from
    left to right, then from top to bottom.
    """
    size = (count,) if isinstance(count, int) else count
    if not device.is_gpu:
        launch(device, name, size, defines=defines, step=step, **options)
        return
    defines = {"GROUP": group, **(defines or {})}
    step = step and step * group
    launch(device, f"{name}_grouped", (math.prod(size) * group,), defines=defines, group=group, step=step, **options)


def _check(name: str, size: tuple[int, ...], group: int | None, step: int | None) -> None:
    """Refuse sizes for which no work-items would run, or not the requested ones."""
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
