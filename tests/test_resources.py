"""Full disks, closed outputs, folders without permission, too little memory, failing builds: one line each."""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
import tempfile
from collections import namedtuple
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyopencl as cl
import pytest
from helpers import Script, command_line, fails_in_one_line, stiff_radiance
from lightdome import cache, console
from lightdome.errors import LightdomeError
from lightdome.files import replacing
from lightdome.maps.envmap import EnvironmentMap
from lightdome.maps.images import write_image
from lightdome.opencl.device import Device
from lightdome.opencl.programs import Programs
from lightdome.sampling.distribution import build_distribution

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def inputs(script: Script, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a small map and samples of it."""
    folder = tmp_path_factory.mktemp("inputs")
    write_image(folder / "map.pfm", stiff_radiance(16, 32))
    result = script("part2_sample", "--map", folder / "map.pfm", "--counts", 4, "--out", folder)
    assert result.returncode == 0, result.stderr
    return folder


def command(script_name: str, inputs: Path) -> list[object]:
    """A command line for every script that writes files."""
    return {
        "part1_fresnel": ["part1_fresnel"],
        "part2_sample": ["part2_sample", "--map", inputs / "map.pfm", "--counts", 4],
        "part3_shade": ["part3_shade", inputs / "samples_4.npz", "--resolution", 40],
        "part4_pbrt": ["part4_pbrt", "--map", inputs / "map.pfm", "--renderer", "opencl", "--resolution", 40],
        "bench": ["bench", "--quick", "--map", inputs / "map.pfm", "--methods", "r2", "--resolution", 20],
    }[script_name]


WRITERS = ("part1_fresnel", "part2_sample", "part3_shade", "part4_pbrt", "bench")


@pytest.fixture
def pocl(device: Device) -> Device:
    """PoCL, whose memory can be limited from outside; Intel's runtime prints its own line about file limits."""
    if "Portable" not in device.handle.platform.name:
        pytest.skip("needs PoCL as the device")
    return device


@pytest.mark.parametrize(
    ("arguments", "kept"),
    [
        (("part1_fresnel",), {"fresnel.json"}),
        (("part2_sample", "--counts", 4), {"samples_4.npz"}),
        (("part3_shade", "samples_4.npz", "--resolution", 800), set()),
        (("part4_pbrt", "--renderer", "opencl"), set()),
    ],
)
def test_a_full_disk_is_one_line_and_leaves_only_whole_files(
    pocl: Device, inputs: Path, arguments: tuple[object, ...], kept: set[str]
) -> None:
    """Simulated by a limit on file sizes, which needs no separate disk; PoCL's files are below it, images above."""
    name, *options = arguments
    limit = 4 << 20 if name != "part1_fresnel" else 20_000
    result = subprocess.run(
        command_line(name, *options, "--out", f"full {name}"),
        capture_output=True,
        text=True,
        cwd=inputs,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit)),
    )
    fails_in_one_line(result, "cannot write", "make room there or choose another folder")
    assert {path.name for path in (inputs / f"full {name}").rglob("*") if path.is_file()} == kept


@pytest.mark.parametrize("name", WRITERS)
def test_a_folder_that_cannot_be_made_gives_one_line(script: Script, inputs: Path, name: str) -> None:
    fails_in_one_line(script(*command(name, inputs), "--out", inputs / "map.pfm" / "below"), "--out")


def test_a_file_that_fails_on_the_way_leaves_nothing(tmp_path: Path) -> None:
    def fail(error: type[BaseException]) -> None:
        with replacing(tmp_path / "file.txt") as temporary:
            temporary.write_text("half")
            raise error(28, "No space left on device")

    for raised, seen in ((OSError, LightdomeError), (KeyboardInterrupt, KeyboardInterrupt), (SystemExit, SystemExit)):
        with pytest.raises(seen):
            fail(raised)
        assert not list(tmp_path.iterdir())


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is always full")
@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_output_that_cannot_be_printed_gives_one_line(inputs: Path, unbuffered: str) -> None:
    program = command_line(*command("part3_shade", inputs), "--out", inputs / "printed")
    with Path("/dev/full").open("w") as full:
        environment = {**os.environ, "PYTHONUNBUFFERED": unbuffered}
        result = subprocess.run(program, stdout=full, stderr=subprocess.PIPE, text=True, env=environment)
    fails_in_one_line(result, "No space left")


def test_closed_standard_streams_do_not_matter(inputs: Path) -> None:
    program = command_line(*command("part3_shade", inputs), "--out", inputs / "closed")
    result = subprocess.run(["sh", "-c", 'exec "$@" >&- 2>&-', "sh", *program])
    assert result.returncode == 0
    assert (inputs / "closed" / "sphere_4.png").exists()


def test_without_a_cache_folder_everything_works(script: Script, inputs: Path, tmp_path: Path) -> None:
    environment = {"XDG_CACHE_HOME": str(inputs / "map.pfm"), "TMPDIR": str(tmp_path)}
    environment["MPLCONFIGDIR"] = str(tmp_path / "matplotlib")  # or it complains that its folder is missing
    result = script(*command("part3_shade", inputs), "--out", inputs / "uncached", **environment)
    assert result.returncode == 0, result.stderr
    assert result.stderr == ""
    assert not list(tmp_path.glob("lightdome-*"))


Usage = namedtuple("Usage", "total used free")


def test_a_full_cache_is_replaced_by_a_temporary_one(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    full = tmp_path / "full"
    full.mkdir()
    monkeypatch.setenv("XDG_CACHE_HOME", str(full))
    cache.ensure_room()
    assert os.environ["XDG_CACHE_HOME"] == str(full)

    monkeypatch.setattr(shutil, "disk_usage", lambda path: Usage(100, 0, 0 if Path(path) == full else 2**30))
    cache.ensure_room()
    temporary = Path(os.environ["XDG_CACHE_HOME"])
    assert temporary.parent == Path(tempfile.gettempdir())

    monkeypatch.setenv("XDG_CACHE_HOME", str(full))
    monkeypatch.setattr(shutil, "disk_usage", lambda path: Usage(100, 100, 0))
    with pytest.raises(LightdomeError, match="XDG_CACHE_HOME"):
        cache.ensure_room()


def device_error(kind: type[cl.Error], status: int) -> cl.Error:
    """The error that pyopencl raises if a device refuses a command."""
    return kind(cl._cl._ErrorRecord(msg="", code=status, routine="clEnqueueNDRangeKernel"))


def raising(error: BaseException) -> Callable[[], None]:
    def main() -> None:
        raise error

    return main


class Tight:
    """A device that holds arrays of at most 1 MiB."""

    max_mem_alloc_size = 2**20

    def __init__(self, handle: cl.Device) -> None:
        self._handle = handle

    def __getattr__(self, name: str) -> object:
        return getattr(self._handle, name)


def test_an_array_larger_than_the_device_holds_is_refused(device: Device) -> None:
    distribution = build_distribution(replace(device, handle=Tight(device.handle)), EnvironmentMap(np.ones((8, 16, 3))))
    assert len(distribution.sample(2**20 // 12)) == 2**20 // 12
    with pytest.raises(LightdomeError, match="holds arrays of up to 1 MiB and this needs 2 MiB; use fewer samples"):
        distribution.sample(2**21 // 12 + 1)


@pytest.mark.parametrize(
    "main",
    [
        raising(device_error(cl.MemoryError, cl.status_code.MEM_OBJECT_ALLOCATION_FAILURE)),
        raising(device_error(cl.RuntimeError, cl.status_code.OUT_OF_RESOURCES)),
        raising(device_error(cl.RuntimeError, cl.status_code.OUT_OF_HOST_MEMORY)),
        lambda: np.empty(2**50),
    ],
)
def test_too_little_memory_gives_one_line(capsys: pytest.CaptureFixture[str], main: Callable[[], object]) -> None:
    with pytest.raises(SystemExit) as ended:
        console.run(main)
    assert ended.value.code == 1
    error = capsys.readouterr().err
    assert "not enough memory" in error
    assert "fewer samples" in error
    assert len(error.splitlines()) == 1


@pytest.mark.parametrize(
    "error", [ValueError("ours"), FileNotFoundError(2, "ours"), device_error(cl.LogicError, -30), ZeroDivisionError()]
)
def test_a_defect_keeps_its_traceback(error: Exception) -> None:
    with pytest.raises(type(error)):
        console.run(raising(error))


@pytest.mark.parametrize(
    "arguments",
    [
        ("part2_sample", "--counts", 2**31 - 1),
        ("part3_shade", "--resolution", 16384),
        ("part4_pbrt", "--renderer", "opencl", "--spp", 1, "--resolution", 16384),
    ],
)
def test_what_no_device_holds_gives_one_line(
    pocl: Device, script: Script, inputs: Path, arguments: tuple[object, ...]
) -> None:
    name, *options = arguments
    options += [inputs / "samples_4.npz"] if name == "part3_shade" else ["--map", inputs / "map.pfm"]
    out = inputs / f"large {name}"
    result = script(name, *options, "--out", out, POCL_MEMORY_LIMIT="1")
    fails_in_one_line(result, "use fewer samples")
    assert not [path for path in out.glob("*") if path.is_file()]


def test_a_build_that_fails_leaves_no_file(device: Device, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr("pyopencl.characterize.has_src_build_cache", lambda device: False)  # then it saves the source

    class Broken(Programs):
        def text(self, name: str) -> str:
            return "kernel void broken(global float *a) { a[0] = ; }"

    with pytest.raises(LightdomeError, match=r"refuses clkernels/broken\.cl") as error:
        Broken(device.context).kernel("broken")
    assert len(str(error.value).splitlines()) == 1
    assert not list(tmp_path.iterdir())
