"""Devices are chosen by what works, programs are built once, stages are timed by name."""

from __future__ import annotations

import importlib.metadata
import json
import os
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from itertools import permutations
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pyopencl as cl
import pytest
from helpers import Script, stiff_radiance
from lightdome.errors import LightdomeError
from lightdome.lighting.shade import shade_samples
from lightdome.maps.envmap import EnvironmentMap
from lightdome.opencl import memory, probe
from lightdome.opencl.device import Device, open_device, survey
from lightdome.opencl.programs import Programs, source
from lightdome.opencl.rates import Rates
from lightdome.rendering.per_pixel import ESTIMATORS, render
from lightdome.sampling.distribution import build_distribution


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
            for asked in (name.upper(), name.swapcase()):
                assert name.lower() in shown(open_device(asked)), asked
    for first in (*of_platform, str(cl.get_platforms().index(platform))):
        for second in (*of_device, str(platform.get_devices().index(handle))):
            if ":" not in first:
                assert open_device(f"{first.lower()}:{second.lower()}").handle == handle
    listed = f"{cl.get_platforms().index(platform)}:{platform.get_devices().index(handle)} {device.description}"
    assert open_device(listed).handle == handle
    monkeypatch.setenv("PYOPENCL_CTX", words[-1].upper())
    assert words[-1].lower() in shown(open_device())


def shown(device: Device) -> str:
    """Everything that is printed about a device, in lower case."""
    handle, platform = device.handle, device.handle.platform
    names = (device.description, platform.name, platform.vendor, platform.version)
    return " ".join((*names, handle.name, handle.vendor, handle.version, handle.driver_version)).lower()


@pytest.mark.parametrize("asked", ["pocl", "POCL", "PoCL:0", "pocl:pthread", "Portable:pocl"])
def test_pocl_is_found_by_its_common_name(device: Device, asked: str) -> None:
    if "PoCL" not in device.description:
        pytest.skip("needs PoCL")
    assert "PoCL" in open_device(asked).description


@pytest.mark.parametrize("asked", ["9" * 5000, "77", "77:0", "0:77", "²", "pocl:Voodoo"])
def test_numbers_and_names_of_no_device_give_one_line(asked: str) -> None:
    with pytest.raises(LightdomeError, match="no OpenCL device matches"):
        open_device(asked)


def test_pyopencl_ctx_is_obeyed_and_the_argument_comes_first(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYOPENCL_CTX", "no such thing")
    with pytest.raises(LightdomeError, match="no such thing"):
        open_device()
    assert open_device(device.handle.name).handle == device.handle
    index = cl.get_platforms().index(device.handle.platform)
    monkeypatch.setenv("PYOPENCL_CTX", str(index))
    assert open_device().handle == device.handle


@pytest.mark.parametrize(
    ("name", "hardware"),
    [
        ("pthread-skylake-avx512-AMD EPYC", "AMD EPYC"),
        ("pthread-AMD EPYC", "AMD EPYC"),
        ("cpu-znver4-AMD Ryzen 9 7950X 16-Core Processor", "AMD Ryzen 9 7950X 16-Core Processor"),
        ("cpu-broadwell-Intel(R) Xeon(R) CPU E5-2690 v4", "Intel(R) Xeon(R) CPU E5-2690 v4"),
        ("cpu-cortex-a72-0xd08", "0xd08"),
        ("NVIDIA H200 ", "NVIDIA H200"),
    ],
)
def test_the_hardware_has_the_makers_name(device: Device, name: str, hardware: str) -> None:
    assert replace(device, handle=SimpleNamespace(name=name)).hardware == hardware


def test_an_implementation_that_the_loader_finds_twice_counts_once(monkeypatch: pytest.MonkeyPatch) -> None:
    platforms = cl.get_platforms()
    once = survey()
    monkeypatch.setattr(cl, "get_platforms", lambda: platforms * 2)
    assert [(found.choice, found.is_taken) for found in survey()] == [(found.choice, found.is_taken) for found in once]


def test_an_unknown_device_is_named_with_what_there_is(device: Device) -> None:
    with pytest.raises(LightdomeError, match="no OpenCL device matches 'Voodoo 2'") as error:
        open_device("Voodoo 2")
    assert device.handle.name.strip() in str(error.value)


def test_a_device_that_fails_the_probe_does_not_count(
    device: Device, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    # The child cannot import lightdome, which has the same effect as a compiler that aborts.
    monkeypatch.setattr(sys, "executable", "/bin/false")
    with pytest.raises(LightdomeError, match="no OpenCL device works here"):
        open_device()
    with pytest.raises(LightdomeError, match="does not compile and run"):
        open_device(device.handle.name)
    assert not list(tmp_path.rglob("*"))


@pytest.mark.parametrize(("found", "advice"), [([], "lightdome[pocl]"), (["it"], "--force-reinstall")])
def test_a_wheel_that_is_there_is_not_advised_again(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, found: list[str], advice: str
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.delenv("PYOPENCL_CTX", raising=False)
    monkeypatch.setattr(sys, "executable", "/bin/false")
    monkeypatch.setattr(importlib.metadata, "distributions", lambda name: found)
    with pytest.raises(LightdomeError, match=re.escape(advice)):
        open_device()


@pytest.mark.slow
def test_a_device_that_passed_the_probe_is_remembered(
    device: Device, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert open_device(device.handle.name).handle == device.handle
    monkeypatch.setattr(sys, "executable", "/bin/false")
    assert open_device(device.handle.name).handle == device.handle


@pytest.mark.slow
def test_devices_are_listed_with_their_rates_and_the_used_one_first(device: Device) -> None:
    result = subprocess.run([sys.executable, "-m", "lightdome", "devices"], capture_output=True, text=True)
    assert result.returncode == 0
    taken, why, _, *table = result.stdout.splitlines()
    assert why.startswith("used (*): ")
    (row,) = (line for line in table if line.startswith("*"))
    platform, index = map(int, row.split()[1].split(":"))
    handle = cl.get_platforms()[platform].get_devices()[index]
    assert handle == device.handle
    assert handle.name.strip() in taken
    assert handle.platform.name in taken
    assert f"{1e-9 * device.rates.multiply_adds:.0f} G/s" in row
    assert row.endswith(taken)


def test_devices_are_listed_for_programs_too(
    device: Device, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, run_here: Script
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.delenv("PYOPENCL_CTX", raising=False)
    slow = replace(FAST, fused=5e10, plain=2e10, numpy=2e11)
    Machine(device.handle, monkeypatch, "broken", slow)
    said = json.loads(run_here("devices", "--json").stdout)
    assert said["why"] == "the only one"
    broken, works = said["devices"]
    assert (broken["device"], broken["is_taken"], broken["failure"], broken["rates"]) == ("0:0", False, "broken", None)
    assert (works["device"], works["is_taken"], works["failure"]) == ("0:1", True, None)
    assert works["rates"]["multiply_adds_per_second"] == 5e10
    assert "for a faster one" in works["note"]
    text = run_here("devices").stdout
    assert "  0:0       fails: broken" in text
    assert text.endswith(f"{works['note']}\n")


@pytest.mark.slow
def test_the_probe_of_a_device_prints_its_rates(device: Device) -> None:
    platform = cl.get_platforms().index(device.handle.platform)
    index = device.handle.platform.get_devices().index(device.handle)
    command = [sys.executable, "-m", "lightdome.probe", str(platform), str(index)]
    result = subprocess.run(command, capture_output=True, text=True)
    rates = Rates.from_json(json.loads(result.stdout))
    assert rates.multiply_adds > 1e8
    assert (rates.transfers is None) == device.shares_host_memory


FAST = Rates(fused=2e11, plain=1e11, copies=5e10, transfers=None, launches=1e5, numpy=1e11)


class Machine:
    """A machine with made-up devices, rates and failures; ``probed`` counts their probes."""

    def __init__(self, handle: cl.Device, monkeypatch: pytest.MonkeyPatch, *devices: Rates | str) -> None:
        self.devices = list(devices)
        self.probed = [0] * len(devices)

        class Numbered:
            def __init__(self, number: int) -> None:
                self.number = number
                self.driver_version = f"driver {number}"

            def __getattr__(self, name: str) -> object:
                return getattr(handle, name)

        handles = [Numbered(number) for number in range(len(devices))]
        monkeypatch.setattr(cl, "get_platforms", lambda: [SimpleNamespace(get_devices=lambda: handles)])
        monkeypatch.setattr(cl, "Context", lambda handles: None)
        monkeypatch.setattr(cl, "CommandQueue", lambda context, properties: None)
        monkeypatch.setattr(subprocess, "run", self.run)

    def run(self, command: list[str], **_: object) -> subprocess.CompletedProcess[str]:
        """Stands in for the probe's child process."""
        number = int(command[-1])
        self.probed[number] += 1
        does = self.devices[number]
        if isinstance(does, str):
            return subprocess.CompletedProcess(command, 1, "", f"probe: the device fails: {does}\n")
        return subprocess.CompletedProcess(command, 0, json.dumps(does.to_json()) + "\n", "")


def opened(asked: str | None = None) -> int:
    """The number of the device that is opened."""
    return open_device(asked).handle.number


def test_the_fastest_device_is_taken(device: Device, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.delenv("PYOPENCL_CTX", raising=False)
    slow = replace(FAST, fused=5e10, plain=5e10)
    far = replace(FAST, fused=1e13, plain=1e13, transfers=1e8)  # a fast GPU on a slow bus
    near = replace(FAST, fused=1e13, plain=1e13, transfers=2e10)
    for devices, taken in (
        ((slow, FAST, "broken"), 1),
        ((FAST, far), 0),
        ((FAST, near), 1),
        ((replace(FAST, launches=1e3), FAST), 1),
        ((replace(FAST, copies=1e9), FAST), 1),
    ):
        Machine(device.handle, monkeypatch, *devices)
        assert opened() == taken
        for record in tmp_path.rglob("*.json"):
            record.unlink()


@pytest.mark.parametrize("asked", [None, "driver"])
def test_the_order_of_devices_does_not_choose(
    device: Device, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, asked: str | None
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.delenv("PYOPENCL_CTX", raising=False)
    # An old implementation, a newer but slower one, the fastest, and one that does not work.
    kinds = (replace(FAST, fused=5e10, plain=5e10), replace(FAST, fused=4e10, plain=4e10), FAST, "broken")
    for devices in permutations(kinds):
        for record in tmp_path.rglob("*.json"):
            record.unlink()
        Machine(device.handle, monkeypatch, *devices)
        for _ in range(2):  # from new probes, then from remembered results
            assert opened(asked) == devices.index(FAST)
        for number, does in enumerate(devices):
            if does != "broken":
                assert opened(f"driver {number}") == number


def test_an_index_is_not_the_beginning_of_another(
    device: Device, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    slow = replace(FAST, fused=5e10, plain=5e10)
    Machine(device.handle, monkeypatch, *[slow] * 10, FAST)
    assert [opened("0:1"), opened("0:01"), opened("0:10")] == [1, 1, 10]


def test_a_failure_is_remembered_for_a_day_where_another_device_works(
    device: Device, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.delenv("PYOPENCL_CTX", raising=False)
    machine = Machine(device.handle, monkeypatch, "broken", FAST)
    assert [opened(), opened()] == [1, 1]
    assert machine.probed == [1, 1]
    for record in tmp_path.rglob("*.json"):
        if "broken" in record.read_text():
            os.utime(record, (0, 0))
    opened()
    assert machine.probed == [2, 1]
    # A device that is asked for by name is tried again.
    machine.devices[0] = FAST
    assert opened("0:0") == 0


def test_kernels_fuse_multiply_adds_where_that_is_not_slower() -> None:
    assert FAST.is_fused
    assert FAST.multiply_adds == FAST.fused
    emulated = replace(FAST, fused=1.3e10, plain=6.5e10)
    assert not emulated.is_fused
    assert emulated.multiply_adds == emulated.plain


def test_both_spellings_of_a_multiply_add_give_the_same_samples_and_nearly_the_same_image(device: Device) -> None:
    images, pixels = [], []
    for fused in (0, 1):
        other = replace(device, programs=Programs(device.context, FUSED=fused, CPU=int(not device.is_gpu)))
        distribution = build_distribution(other, EnvironmentMap(stiff_radiance(21, 43)))
        samples = distribution.sample(1000, sequence="sobol")
        pixels.append(samples.pixel)
        images.append(shade_samples(other, samples, 33))
    np.testing.assert_array_equal(*pixels)
    np.testing.assert_allclose(*images, atol=1e-5 * images[0].max())
    assert not np.array_equal(*images)


@pytest.mark.parametrize("fused", [0, 1])
def test_kernels_are_built_for_the_measured_spelling(
    device: Device, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, fused: int
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    answer = json.dumps((FAST if fused else replace(FAST, fused=1e10)).to_json())
    monkeypatch.setattr(
        subprocess, "run", lambda command, **_: subprocess.CompletedProcess(command, 0, answer, stderr="")
    )
    opened = open_device(device.description)
    samples = build_distribution(device, EnvironmentMap(stiff_radiance(21, 43))).sample(1000)
    expected = replace(device, programs=Programs(device.context, FUSED=fused, CPU=int(not device.is_gpu)))
    np.testing.assert_array_equal(shade_samples(opened, samples, 33), shade_samples(expected, samples, 33))


def test_kernels_ask_only_a_cpu_for_functions_that_are_not_in_opencl(gpu_shaped: Device) -> None:
    """Some GPUs' compilers list Clang's functions, and refuse them for global memory."""
    absent = {"__builtin_prefetch": "not_here", "__builtin_nontemporal_store": "not_here"}
    context, built = gpu_shaped.context, []

    class Built(type(gpu_shaped.programs)):  # type: ignore[misc]
        def kernel(self, name: str, **defines: int) -> Callable[..., cl.Event]:
            built.append((name, defines))
            return super().kernel(name, **defines)

    recorded = replace(gpu_shaped, programs=Built(context, FUSED=1))
    distribution = build_distribution(recorded, EnvironmentMap(stiff_radiance(21, 43)))
    distribution.sample(1000)
    for estimator in ESTIMATORS:
        list(render(distribution, [2], 17, estimator=estimator))
    assert built
    programs = Programs(context, FUSED=1, **absent)
    for name, defines in built:
        programs.kernel(name, **defines)
    with pytest.raises(LightdomeError, match="refuses"):
        Programs(context, FUSED=1, CPU=1, **absent).kernel("sampling/row_cdf")


def test_a_slow_device_has_a_note_that_says_what_to_install(device: Device) -> None:
    assert replace(device, rates=FAST).note is None
    note = replace(device, rates=replace(FAST, fused=1e10, plain=2e10)).note
    assert "does 20 G multiply-adds per second, less than a third of numpy's 100 G" in note
    assert "apt-get install pocl-opencl-icd" in note


@pytest.mark.parametrize(
    "record",
    ["", "{", "[]", "{}", '{"rates": {"fused": 1}}', json.dumps({"rates": FAST.to_json() | {"plain": -1}})],
)
def test_a_damaged_record_of_a_device_is_made_again(
    device: Device, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, record: str
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.delenv("PYOPENCL_CTX", raising=False)
    machine = Machine(device.handle, monkeypatch, FAST)
    opened()
    (path,) = tmp_path.rglob("*.json")
    whole = path.read_text()
    path.write_text(record)
    assert opened() == 0
    assert machine.probed == [2]
    assert path.read_text() == whole


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "status", "said"),
    [
        ("--help", 0, "usage: python -m lightdome.probe"),
        ("", 2, "PLATFORM"),
        ("0", 2, "DEVICE"),
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
    build = cl.Program
    monkeypatch.setattr(cl, "Program", lambda context, text: build(context, text.replace("{", "{ undeclared;")))
    with pytest.raises(LightdomeError, match="undeclared") as error:
        probe.probe(platform, device.handle.platform.get_devices().index(device.handle))
    assert "\n" not in str(error.value)


def test_a_kernel_is_built_once_per_set_of_defines(device: Device) -> None:
    programs = Programs(device.context)
    kernel = programs.kernel("lighting/shade", WIDTH=1, ROWS=1)
    assert programs.kernel("lighting/shade", ROWS=1, WIDTH=1) is kernel
    assert programs.kernel("lighting/shade", WIDTH=1, ROWS=2) is not kernel


def test_a_build_that_fails_gives_one_line(device: Device) -> None:
    with pytest.raises(LightdomeError, match=r"refuses clkernels/lighting/shade\.cl") as error:
        Programs(device.context).kernel("lighting/shade", WIDTH=3, ROWS=1)
    assert "\n" not in str(error.value)


def test_a_header_is_inlined_once() -> None:
    text = source("sampling/row_cdf.cl")
    assert '#include "' not in text
    assert text.count("#define TWO_SUM") == 1
    # PoCL's compiler cannot handle an include path with a space in it, as for a clone in such a folder.
    assert "#include <pyopencl" not in source("sampling/sample.cl")
    assert source("sampling/sample.cl").count("#define PHILOX_M4x32_0") == 1


def test_stages_are_timed_by_name(device: Device) -> None:
    device.profile.clear()
    array = memory.zeros(device, (64, 1024), np.float32)
    assert not memory.download(device, array).any()
    seconds = device.profile.seconds()
    assert set(seconds) == {"clear", "download"}
    assert seconds["clear"] > 0
    device.profile.clear()
    assert device.profile.seconds() == {}
