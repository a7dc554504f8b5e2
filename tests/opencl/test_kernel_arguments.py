"""Kernels' arguments are named, checked and cast, and their arrays are kept until the kernels are done."""

from __future__ import annotations

import contextlib
import gc
import re
import threading
import weakref
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pyopencl as cl
import pytest
from helpers import ROOT
from lightdome.errors import LightdomeError
from lightdome.opencl import memory
from lightdome.opencl.device import Device
from lightdome.opencl.memory import DeviceArray
from lightdome.opencl.profile import PENDING, Profile
from lightdome.opencl.programs import source
from lightdome.opencl.signature import Parameter, Signature, signature

TEXT = """
kernel void other(const int a) {}

kernel void some(global const uint2 *restrict table,  // not, this, comma
                 const float2 pair,
                 const ulong cap,
                 global arc *restrict arcs,
                 const float scale)
{
}
"""
UINT = Parameter("n", "uint", False, np.dtype(np.uint32), 1)


def test_a_signature_is_that_of_the_kernel() -> None:
    found = signature("folder/some", TEXT).parameters
    assert [parameter.name for parameter in found] == ["table", "pair", "cap", "arcs", "scale"]
    table, pair, cap, arcs, scale = found
    assert (table.is_pointer, table.dtype, table.lanes) == (True, np.uint32, 2)
    assert (pair.is_pointer, pair.dtype, pair.lanes) == (False, np.float32, 2)
    assert (cap.dtype, scale.dtype) == (np.uint64, np.float32)
    assert (arcs.is_pointer, arcs.dtype) == (True, None)
    assert [parameter.is_writable for parameter in found] == [False, False, False, True, False]
    assert signature("launch", "kernel void launch(void)\n{\n}").parameters == ()


@pytest.mark.parametrize("path", sorted((ROOT / "clkernels").glob("*/*.cl")), ids=lambda path: path.stem)
def test_every_kernel_has_a_signature_that_is_understood(path: object) -> None:
    name = str(path.relative_to(ROOT / "clkernels").with_suffix(""))
    assert signature(name, source(f"{name}.cl")).kernel == name


@pytest.mark.parametrize(
    "text",
    [
        "kernel void other(void)",
        "kernel void some(half_open x)",
        "kernel void some(const float3 x)",
        "kernel void some(uint)",
        "kernel void some(\n#if A\n)",
    ],
)
def test_a_signature_that_is_not_understood_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"no kernel of that name|not (supported|understood)|unknown type|has 3 lanes"):
        signature("some", text)


def test_what_a_kernel_does_not_read_may_be_absent_but_not_what_it_writes() -> None:
    table, _, _, arcs, _ = signature("some", TEXT).parameters
    assert table.cast(None) is None
    with pytest.raises(TypeError, match="must be an array on the device, got NoneType"):
        arcs.cast(None)


def test_scalars_and_vectors_are_cast_to_the_types_of_the_signature(device: Device) -> None:
    _, pair, cap, _, scale = signature("some", TEXT).parameters
    assert UINT.cast(np.int64(7)) == 7
    assert type(UINT.cast(7)) is np.uint32
    assert type(cap.cast(2**64 - 1)) is np.uint64
    assert type(scale.cast(1)) is np.float32
    for value in ((1, 0.5), np.array([1, 0.5]), [np.float32(1), np.float32(0.5)]):
        vector = pair.cast(value)
        assert (vector.dtype, vector.tolist()) == (np.float32, [1, 0.5])


LAUNCH: dict[str, Callable[[DeviceArray], object]] = {
    "cdf": lambda table: table,
    "width": lambda table: 4,
    "strip_bits": lambda table: 0,
    "shift": lambda table: 31,
    "guide": lambda table: table,
    "total": lambda table: table,
}
MISTAKES: dict[str, tuple[str, object]] = {
    "lacks the argument 'cdf'": ("cdf", None),
    "lacks the argument 'shift'": ("shift", None),
    "takes no argument 'height'": ("height", 4),
    "'width' must be uint, got -1": ("width", -1),
    "'width' must be uint, got 4294967296": ("width", 2**32),
    "'shift' 'float' object cannot be interpreted as an integer": ("shift", 1.0),
    "'guide' must be an array on the device, got ndarray": ("guide", np.zeros(4, np.uint32)),
    "'guide' must be an array on the device, got int": ("guide", 4),
}


@pytest.mark.parametrize("message", MISTAKES)
def test_a_wrong_argument_is_a_defect_that_names_kernel_and_argument(device: Device, message: str) -> None:
    table = memory.zeros(device, 4, np.uint32)
    name, value = MISTAKES[message]
    arguments = {key: of(table) for key, of in LAUNCH.items()} | {name: value}
    if value is None:
        del arguments[name]
    with pytest.raises(TypeError, match=rf"sampling/guide.*{re.escape(message)}"):
        device.launch("sampling/guide", (1,), **arguments)


def test_an_array_of_another_type_is_refused(device: Device) -> None:
    table, floats = memory.zeros(device, 4, np.uint32), memory.zeros(device, 4, np.float32)
    with pytest.raises(TypeError, match="'cdf' must hold uint32, got float32"):
        device.launch("sampling/guide", (1,), cdf=floats, width=4, strip_bits=0, shift=31, guide=table, total=table)


@pytest.mark.parametrize(
    ("declaration", "is_writable"),
    [
        ("global uint *restrict a", True),
        ("global uint *const a", True),
        ("global const uint *a", False),
        ("const global uint *a", False),
        ("global uint const *a", False),
        ("constant uint *a", False),
    ],
)
def test_const_before_the_star_makes_a_pointer_read_only(declaration: str, is_writable: bool) -> None:
    (parameter,) = signature("some", f"kernel void some({declaration})").parameters
    assert parameter.is_writable == is_writable


def test_an_uploaded_array_is_never_written(device: Device, gpu_shaped: Device) -> None:
    message = "'total' must be an array that the kernel may write to, got an uploaded one"
    for each in (device, gpu_shaped):
        cdf = memory.upload(each, np.arange(1, 5, dtype=np.uint32))
        table = memory.zeros(each, (4, 2), np.uint32)
        with pytest.raises(TypeError, match=message):
            each.launch("sampling/guide", (1,), cdf=cdf, width=4, strip_bits=0, shift=31, guide=table, total=cdf)
        np.testing.assert_array_equal(memory.download(each, cdf), [1, 2, 3, 4])


def test_a_vector_of_another_length_is_refused() -> None:
    pair = Signature("some", (Parameter("pair", "float2", False, np.dtype(np.float32), 2),))
    with pytest.raises(TypeError, match="the kernel some: the argument 'pair' must be float2, got 3 numbers"):
        pair.bind({"pair": (1, 2, 3)})
    with pytest.raises(TypeError, match="the argument 'pair'"):
        pair.bind({"pair": 1})


@pytest.mark.parametrize("step", [None, 1, 3, 7, 100])
def test_steps_cover_every_work_item_once(device: Device, step: int | None) -> None:
    radiance = np.random.default_rng(3).random((7, 5, 3), np.float32)
    weight = memory.zeros(device, (7, 5), np.float32)
    device.launch(
        "sampling/map_weights",
        (7,),
        step=step,
        progress="weighing",
        radiance=memory.upload(device, radiance),
        width=5,
        scale=1,
        f=weight,
    )
    expected = radiance[..., 0] + radiance[..., 1] + radiance[..., 2]
    np.testing.assert_array_equal(memory.download(device, weight), expected)


@pytest.mark.parametrize(
    ("size", "options", "message"),
    [
        ((0,), {}, "a size of at least one work-item, got (0,)"),
        ((4, 0), {}, "a size of at least one work-item, got (4, 0)"),
        ((), {}, "a size of at least one work-item, got ()"),
        ((4,), {"step": 0}, "a step of at least one work-item, got 0"),
        ((4, 4), {"group": 2}, "groups need one dimension"),
        ((4,), {"group": 0}, "groups need one dimension and a positive number"),
        ((8,), {"group": 4, "step": 6}, "the step must be a multiple of the group, 4, got 6"),
    ],
)
def test_a_size_that_cannot_be_launched_is_a_defect(
    device: Device, size: tuple[int, ...], options: dict[str, int], message: str
) -> None:
    with pytest.raises(ValueError, match=rf"limits/launch.*{re.escape(message)}"):
        device.launch("limits/launch", size, **options)


@pytest.mark.parametrize("step", [None, 4, 8])
def test_groups_are_filled_up(device: Device, step: int | None) -> None:
    device.launch("limits/launch", (6,), group=4, step=step)
    device.wait()


@pytest.fixture
def gate(device: Device) -> Iterator[cl.UserEvent]:
    """An event that holds up launched kernels until it is complete."""
    event = cl.UserEvent(device.context)
    device.wait()
    cl.enqueue_barrier(device.queue, wait_for=[event])
    yield event
    if event.command_execution_status != cl.command_execution_status.COMPLETE:
        event.set_status(cl.command_execution_status.COMPLETE)
    device.wait()


def weigh(device: Device) -> weakref.ref[DeviceArray]:
    """Launch a kernel; returns a reference that tells whether its result is still kept."""
    array, radiance = memory.empty(device, 16, np.float32), memory.empty(device, 3, np.float32)
    device.launch("sampling/map_weights", (1,), radiance=radiance, width=1, scale=1, f=array)
    return weakref.ref(array)


def test_what_a_kernel_works_on_stays_until_it_is_done(device: Device, gate: cl.UserEvent) -> None:
    alive = weigh(device)
    gc.collect()
    assert alive() is not None
    gate.set_status(cl.command_execution_status.COMPLETE)
    device.wait()
    gc.collect()
    assert alive() is None


@contextlib.contextmanager
def opened_soon(gate: cl.UserEvent) -> Iterator[None]:
    """Complete ``gate`` while the ``with`` block waits for it."""
    opener = threading.Timer(0.1, gate.set_status, [cl.command_execution_status.COMPLETE])
    opener.start()
    try:
        yield
    finally:
        opener.join()


def test_only_so_many_launches_are_pending(device: Device, gate: cl.UserEvent) -> None:
    alive = weigh(device)
    for _ in range(PENDING - 1):
        device.launch("limits/launch", (1,))
    assert alive() is not None
    with opened_soon(gate):
        device.launch("limits/launch", (1,))  # waits for the oldest
        assert alive() is None


def test_memory_is_refused_once_nothing_is_under_way(device: Device, gate: cl.UserEvent) -> None:
    """The process may end next, and a compiler still working on a kernel might crash it."""
    alive = weigh(device)
    with opened_soon(gate):
        with pytest.raises(LightdomeError, match="use fewer samples"):
            memory.empty(device, 2**60, np.uint8)
        assert alive() is None


def test_a_profile_adds_up_what_it_forgets(device: Device) -> None:
    fresh = replace(device, profile=Profile())
    for _ in range(10):
        fresh.launch("limits/launch", (1,))
    ten = fresh.profile.seconds()["launch"]
    assert ten > 0
    fresh.launch("limits/launch", (1,), stage="another")
    assert fresh.profile.seconds().keys() == {"launch", "another"}
    assert fresh.profile.seconds()["launch"] == ten
