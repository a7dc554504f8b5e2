"""Devices are chosen by what works, programs are built once, stages are timed by name."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyopencl as cl
import pytest
from lightdome import buffers, probe
from lightdome.device import Device, open_device
from lightdome.errors import LightdomeError
from lightdome.programs import Programs, source


def test_a_device_is_found_by_part_of_its_name(device: Device) -> None:
    name = device.handle.name
    assert open_device(name[:6].upper()).handle.name == name
    assert open_device(f"{device.handle.platform.name}:0").handle.platform == device.handle.platform


def test_a_device_is_found_by_every_name_that_is_shown(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    handle, platform = device.handle, device.handle.platform
    of_platform = (platform.name, platform.vendor, platform.version)
    of_device = (handle.name, handle.vendor, handle.version, handle.driver_version)
    words = re.findall(r"[A-Za-z]\w{2,}", device.description)
    assert len(words) > 2
    for name in (device.description, *of_platform, *of_device, *words):
        if not name.isdecimal():
            assert open_device(name.upper()).handle.platform.name, name
            assert name.lower() in shown(open_device(name.swapcase())), name
    for first in (*of_platform, str(cl.get_platforms().index(platform))):
        for second in (*of_device, str(platform.get_devices().index(handle))):
            if ":" not in first:
                assert open_device(f"{first.lower()}:{second.lower()}").handle == handle
    listed = f"{cl.get_platforms().index(platform)}:{platform.get_devices().index(handle)} {device.description}"
    assert open_device(listed).handle == handle
    monkeypatch.setenv("PYOPENCL_CTX", words[-1].upper())
    assert words[-1].lower() in shown(open_device())


def shown(device: Device) -> str:
    """All that is said of a device, in small letters."""
    handle, platform = device.handle, device.handle.platform
    names = (device.description, platform.name, platform.vendor, platform.version)
    return " ".join((*names, handle.name, handle.vendor, handle.version, handle.driver_version)).lower()


@pytest.mark.parametrize("asked", ["pocl", "POCL", "PoCL:0", "pocl:pthread", "Portable:pocl"])
def test_pocl_is_found_by_the_name_that_all_know_it_by(device: Device, asked: str) -> None:
    if "PoCL" not in device.description:
        pytest.skip("needs PoCL")
    assert "PoCL" in open_device(asked).description


@pytest.mark.parametrize("asked", ["9" * 5000, "77", "77:0", "0:77", "²", "pocl:Voodoo"])
def test_numbers_and_names_of_no_device_are_one_line(asked: str) -> None:
    with pytest.raises(LightdomeError, match="no OpenCL device matches"):
        open_device(asked)


def test_pyopencl_ctx_is_followed_and_the_argument_goes_first(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYOPENCL_CTX", "no such thing")
    with pytest.raises(LightdomeError, match="no such thing"):
        open_device()
    assert open_device(device.handle.name).handle == device.handle
    index = cl.get_platforms().index(device.handle.platform)
    monkeypatch.setenv("PYOPENCL_CTX", str(index))
    assert open_device().handle == device.handle


def test_an_unknown_device_is_named_with_what_there_is(device: Device) -> None:
    with pytest.raises(LightdomeError, match="no OpenCL device matches 'Voodoo 2'") as error:
        open_device("Voodoo 2")
    assert device.handle.name.strip() in str(error.value)


def test_a_device_that_fails_the_probe_does_not_count(
    device: Device, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    # The child finds no lightdome to import: as good as a compiler that aborts.
    monkeypatch.setattr(sys, "executable", "/bin/false")
    with pytest.raises(LightdomeError, match="no OpenCL device works here"):
        open_device()
    with pytest.raises(LightdomeError, match="does not compile and run"):
        open_device(device.handle.name)
    assert not list(tmp_path.rglob("*"))


def test_a_device_that_passed_the_probe_is_remembered(
    device: Device, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert open_device(device.handle.name).handle == device.handle
    monkeypatch.setattr(sys, "executable", "/bin/false")
    assert open_device(device.handle.name).handle == device.handle


def test_the_probe_names_the_best_device() -> None:
    result = subprocess.run([sys.executable, "-m", "lightdome.probe"], capture_output=True, text=True)
    assert result.returncode == 0
    assert result.stdout.strip() == open_device().description


@pytest.mark.parametrize(
    ("arguments", "status", "said"),
    [
        ("--help", 0, "usage: python -m lightdome.probe"),
        ("0", 2, "expected"),
        ("a b", 2, "'a'"),
        ("0 0 0", 2, "usage"),
        ("0 1.5", 2, "'1.5'"),
        ("0 999", 1, "no OpenCL device 0 999"),
        ("999 0", 1, "no OpenCL device 999 0"),
        ("-1 0", 1, "no OpenCL device -1 0"),
    ],
)
def test_the_probe_has_a_command_line(arguments: str, status: int, said: str) -> None:
    command = [sys.executable, "-m", "lightdome.probe", *arguments.split()]
    result = subprocess.run(command, capture_output=True, text=True)
    assert result.returncode == status
    assert said in result.stdout + result.stderr
    assert "Traceback" not in result.stderr
    assert status != 1 or result.stderr.count("\n") == 1


def test_the_probe_says_why_a_device_fails_in_one_line(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    platform = cl.get_platforms().index(device.handle.platform)
    monkeypatch.setattr(probe, "_SOURCE", "kernel void probe(global float *a) { undeclared; }")
    with pytest.raises(LightdomeError, match="undeclared") as error:
        probe.probe(platform, device.handle.platform.get_devices().index(device.handle))
    assert "\n" not in str(error.value)


def test_a_kernel_is_built_once_per_set_of_defines(device: Device) -> None:
    programs = Programs(device.context)
    kernel = programs.kernel("shade", PIXELS=1, ROWS=1)
    assert programs.kernel("shade", ROWS=1, PIXELS=1) is kernel
    assert programs.kernel("shade", PIXELS=1, ROWS=2) is not kernel


def test_a_build_that_fails_is_one_line(device: Device) -> None:
    with pytest.raises(LightdomeError, match=r"refuses clkernels/shade\.cl") as error:
        Programs(device.context).kernel("shade", PIXELS=3, ROWS=1)
    assert "\n" not in str(error.value)


def test_a_header_is_inlined_once() -> None:
    text = source("row_cdf.cl")
    assert '#include "' not in text
    assert text.count("#define TWO_SUM") == 1
    # An include path with a space in it, as of a clone in such a folder, is lost on PoCL's compiler.
    assert "#include <pyopencl" not in source("sample.cl")
    assert source("sample.cl").count("#define PHILOX_M4x32_0") == 1


def test_stages_are_timed_by_name(device: Device) -> None:
    device.profile.clear()
    array = buffers.zeros(device, (64, 1024), np.float32)
    assert not buffers.download(device, array).any()
    seconds = device.profile.seconds()
    assert set(seconds) == {"clear", "download"}
    assert seconds["clear"] > 0
    device.profile.clear()
    assert device.profile.seconds() == {}
