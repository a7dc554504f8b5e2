"""A run that is stopped at any moment ends at once, leaves no half file under a final name, and can be repeated.

    python tests/test_interrupted.py 50

stops every script at 50 random moments with each signal, and as often with empty caches; the tests do the same with
fewer. A signal goes to the whole group of processes, as a terminal's Ctrl-C does, compilers and linkers included.
"""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from helpers import LONG, ROOT, command_line
from lightdome.opencl.device import Device
from lightdome.sampling.samples import Samples

pytestmark = pytest.mark.slow

STOPPED = {
    "part1_fresnel": (),
    "part2_sample": ("--counts", "64", "256"),
    "part3_shade": ("samples_64.npz", "samples_256.npz", "--resolution", "255"),
    "part4_pbrt": ("--renderer", "opencl", "--spp", "4", "8", "--resolution", "255"),
    "bench": ("--quick", "--methods", "r2", "--counts", "16", "--seeds", "1", "--resolution", "63"),
}
OTHERS = {
    "roofline": ("--quick",),
    "stability": ("--quick",),
    "report": ("--quick",),
    "make_default_map": (),
    "get_grace": ("--from", "http://127.0.0.1:1/none"),
}
CLOCK = re.compile(rb"\d{4}:\d\d:\d\d \d\d:\d\d:\d\d")
PROMPT = 3.0  # seconds from a signal to the end, on a busy machine
HIDDEN = re.compile(r"\.\w+\.[0-9a-f]{8}\.\w+")


@dataclass
class Run:
    """A script in its own folder, with its own temporary folder and its own cache."""

    name: str
    folder: Path

    def start(self) -> subprocess.Popen[bytes]:
        (self.folder / "tmp").mkdir(exist_ok=True)
        (self.folder / "cache" / "pocl").mkdir(parents=True, exist_ok=True)
        out = "out.exr" if self.name in ("get_grace", "make_default_map") else "out"
        return subprocess.Popen(
            command_line(self.name, *(STOPPED | OTHERS)[self.name], "--out", out),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            cwd=self.folder,
            start_new_session=True,
            env={
                **os.environ,
                "TMPDIR": str(self.folder / "tmp"),
                "XDG_CACHE_HOME": str(self.folder / "cache"),
                "POCL_CACHE_DIR": str(self.folder / "cache" / "pocl"),
            },
        )

    def finish(self) -> float:
        """Run undisturbed; returns the seconds it took."""
        start = time.perf_counter()
        process = self.start()
        _, errors = process.communicate()
        assert process.returncode == 0, errors
        return time.perf_counter() - start

    def stop(self, number: signal.Signals, after: float, writing: bool = False) -> None:
        """Start, and send a signal after a while, and with ``writing`` only while a file is being written.

        Raises where the script does not say that it was stopped, promptly and without a traceback.
        """
        process = self.start()
        wait_for_first_line(process)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(after)
        while writing and process.poll() is None and not list((self.folder / "out").rglob(".*")):
            time.sleep(0.0005)
        self.send(process, number)

    def send(self, process: subprocess.Popen[bytes], number: signal.Signals) -> None:
        """Send a signal to the whole process group, and check that it ends the script."""
        sent = time.perf_counter()
        if process.poll() is None:
            os.killpg(process.pid, number)
        _, errors = process.communicate()
        assert time.perf_counter() - sent < PROMPT
        stopped = -number if number == signal.SIGKILL else 128 + number
        assert process.returncode in (0, stopped), errors  # 0 if it had finished
        assert b"Traceback" not in errors
        assert b"ignored" not in errors

    def files(self) -> dict[str, bytes]:
        """The files in the output folder, by path."""
        out = self.folder / "out"
        return {str(path.relative_to(out)): path.read_bytes() for path in out.rglob("*") if path.is_file()}

    def clear(self) -> None:
        """Empty the output folder."""
        for path in self.files():
            (self.folder / "out" / path).unlink()

    def content(self) -> dict[str, bytes]:
        """As :meth:`files`, without what differs between runs: times measured by the benchmark or stored in an EXR."""
        return {name: CLOCK.sub(b"", data) if self.name != "bench" else b"" for name, data in self.files().items()}


def wait_for_first_line(process: subprocess.Popen[bytes]) -> None:
    """Wait until a script handles SIGTERM; before that, Python itself starts, and cannot handle it."""
    status = Path(f"/proc/{process.pid}/status")
    while process.poll() is None and status.exists():
        caught = re.search(r"^SigCgt:\s*(\w+)", status.read_text(), re.MULTILINE)
        if caught is None or int(caught[1], 16) >> signal.SIGTERM - 1 & 1:
            return
        time.sleep(0.001)


def stop_with_empty_caches(name: str, number: signal.Signals, moments: Iterable[float], inputs: Path) -> None:
    """Stop a script after each of ``moments``, every time with nothing compiled; raises as :meth:`Run.stop` does."""
    for after in moments:
        # A linker still at work writes to the cache for a moment longer.
        with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
            run = Run(name, Path(folder))
            for path in inputs.glob("*.npz"):
                (run.folder / path.name).symlink_to(path)
            run.stop(number, after)
            assert not [path for path in run.files() if HIDDEN.fullmatch(Path(path).name)]
            assert not list((run.folder / "tmp").iterdir())


def stop_at_random(name: str, numbers: Iterable[signal.Signals], count: int, inputs: Path) -> int:
    """Stop a script ``count`` times by each signal; returns the hidden files left. Raises if anything else is left."""
    rng = np.random.default_rng(0)
    run = Run(name, inputs)
    run.clear()
    if name != "part2_sample":  # its run for the inputs has filled the caches
        run.finish()
    seconds = run.finish()
    whole = run.content()
    ends = {path: data[-8:] for path, data in run.files().items() if path.endswith((".png", ".svg", ".json"))}
    hidden = 0
    for moment, number in enumerate(number for number in numbers for _ in range(count)):
        run.clear()
        # Every other time, deliberately while a file is being written, since most moments are harmless.
        run.stop(number, seconds * rng.random(), writing=moment % 2 == 1)
        left = run.content()
        temporary = {path for path in left if HIDDEN.fullmatch(Path(path).name)}
        for path, data in left.items():
            assert path in temporary or data == whole[path], path
        for path, data in run.files().items():
            assert path in temporary or path not in ends or data.endswith(ends[path]), path
        if number != signal.SIGKILL:
            assert not temporary
            assert not list((run.folder / "tmp").iterdir())
        hidden += len(temporary)
    run.clear()
    run.finish()
    assert run.content() == whole
    return hidden


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("inputs")
    # The first runs probe, compile and fill the caches: everything in the caches is written during them.
    for after in (0.7, 1.1):
        Run("part2_sample", folder).stop(signal.SIGKILL, after)
    return make_inputs(folder)


def make_inputs(folder: Path) -> Path:
    """``folder`` with the samples that part 3 reads."""
    run = Run("part2_sample", folder)
    run.finish()
    for count in (64, 256):
        (folder / "out" / f"samples_{count}.npz").replace(folder / f"samples_{count}.npz")
    return folder


@pytest.mark.parametrize(
    ("name", "numbers"),
    [("part2_sample", (signal.SIGKILL, signal.SIGTERM)), ("part3_shade", (signal.SIGINT,))],
)
def test_a_run_that_is_stopped_leaves_no_half_file(name: str, numbers: tuple[signal.Signals], inputs: Path) -> None:
    stop_at_random(name, numbers, 2, inputs)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("name", [*STOPPED, *OTHERS])
def test_a_signal_is_handled_while_modules_load(name: str, number: signal.Signals, tmp_path: Path) -> None:
    # A module that all scripts load, and that is slow to load.
    (tmp_path / "argparse.py").write_text("print('loading', flush=True)\nimport time\ntime.sleep(600)\n")
    process = subprocess.Popen(
        command_line(name),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
    )
    assert process.stdout.readline() == b"loading\n"
    process.send_signal(number)
    _, errors = process.communicate(timeout=LONG)
    assert process.returncode == 128 + number
    assert b"Traceback" not in errors


def wait_for_a_linker(process: subprocess.Popen[bytes]) -> bool:
    """Wait until a compiler in the script runs a program; False if the script ends first."""
    while process.poll() is None:
        for thread in Path(f"/proc/{process.pid}/task").glob("*"):
            with contextlib.suppress(OSError):
                if thread.name != str(process.pid) and (thread / "children").read_text():
                    return True
        time.sleep(0.001)
    return False


@pytest.mark.parametrize(("name", "number"), [("part2_sample", signal.SIGINT), ("part3_shade", signal.SIGTERM)])
def test_a_signal_does_not_reach_a_compiler_s_children(
    device: Device, name: str, number: signal.Signals, inputs: Path, tmp_path: Path
) -> None:
    if "PoCL" not in device.description:
        pytest.skip("needs PoCL, which runs a linker")
    for path in inputs.glob("*.npz"):
        (tmp_path / path.name).symlink_to(path)
    run = Run(name, tmp_path)
    process = run.start()
    assert wait_for_a_linker(process)
    run.send(process, number)


LOOP = """
import time
from lightdome import console

def main():
    print("now")
    while True:
        time.sleep(0.01)

console.run(main)
"""


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_the_exit_status_says_which_signal_ended_a_script(number: signal.Signals, status: int, tmp_path: Path) -> None:
    script = tmp_path / "endless.py"
    script.write_text(LOOP)
    with subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout.readline() == b"now\n"
        process.send_signal(number)
        _, errors = process.communicate(timeout=LONG)
    assert process.returncode == status
    assert errors == (b"\nendless: interrupted\n" if number == signal.SIGINT else b"")


LONG_CALL = """
import sys, time
import numpy as np
from pathlib import Path
from lightdome import console
from lightdome.files import replacing

def main():
    with replacing(Path(sys.argv[1]) / "half.txt") as path:
        path.write_text("half")
        print("now")
        np.linalg.eig(np.random.default_rng(1).random((3000, 3000)))  # tens of seconds in one call

console.run(main)
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_is_handled_in_a_long_call_into_a_library(number: signal.Signals, tmp_path: Path) -> None:
    command = [sys.executable, "-c", LONG_CALL, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout.readline() == b"now\n"
        time.sleep(0.1)
        start = time.perf_counter()
        process.send_signal(number)
        _, errors = process.communicate()
    assert process.returncode == 128 + number
    assert time.perf_counter() - start < PROMPT
    assert b"Traceback" not in errors
    assert not list(tmp_path.iterdir())


def test_a_signal_that_a_shell_ignores_stays_ignored(tmp_path: Path) -> None:
    heard = "os.kill(os.getpid(), signal.SIGINT)"
    shutil.copy(ROOT / "scripts" / "_start.py", tmp_path)
    script = tmp_path / "script.py"
    for program in (
        f"import _start, os, signal; {heard}",
        f"import os, signal; from lightdome import console; console.run(lambda: {heard})",
    ):
        script.write_text(program)
        command = ["sh", "-c", 'trap "" INT; exec "$@"', "sh", sys.executable, script]
        assert subprocess.run(command).returncode == 0


def test_caches_whose_writing_was_stopped_are_used(inputs: Path) -> None:
    """The stops are in :func:`inputs`; samples drawn after them are right."""
    stopped, whole = (Samples.load(inputs / f"samples_{count}.npz") for count in (64, 256))
    np.testing.assert_array_equal(stopped.pixel, whole.pixel[:64])


if __name__ == "__main__":
    for script in STOPPED:
        for number in (signal.SIGKILL, signal.SIGTERM, signal.SIGINT):
            with tempfile.TemporaryDirectory() as folder:
                inputs = make_inputs(Path(folder))
                left = stop_at_random(script, [number], int(sys.argv[1]), inputs)
                stop_with_empty_caches(script, number, 3 * np.random.default_rng(1).random(int(sys.argv[1])), inputs)
                print(f"{script:<14}{number.name:<9}{sys.argv[1]} moments, {left} hidden files left", flush=True)
