"""A run that is stopped at any moment leaves no half file under a final name, and can be repeated.

    python tests/test_interrupted.py 50

stops every script at 50 random moments with each signal; the tests do the same with fewer.
"""

from __future__ import annotations

import contextlib
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT
from lightdome.samples import Samples

SCRIPTS = {
    "part1_fresnel": (),
    "part2_sample": ("--counts", "64", "256"),
    "part3_shade": ("samples_64.npz", "samples_256.npz", "--resolution", "255"),
    "part4_pbrt": ("--renderer", "opencl", "--spp", "4", "8", "--resolution", "255"),
    "bench": ("--quick", "--methods", "r2", "--counts", "16", "--seeds", "1", "--resolution", "63"),
}
CLOCK = re.compile(rb"\d{4}:\d\d:\d\d \d\d:\d\d:\d\d")
HIDDEN = re.compile(r"\.\w+\.[0-9a-f]{8}\.\w+")


@dataclass
class Run:
    """A script in a folder of its own, with its own folder for temporary files and its own cache."""

    name: str
    folder: Path

    def start(self) -> subprocess.Popen[bytes]:
        (self.folder / "tmp").mkdir(exist_ok=True)
        return subprocess.Popen(
            [sys.executable, str(ROOT / "scripts" / f"{self.name}.py"), *SCRIPTS[self.name], "--out", "out"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            cwd=self.folder,
            env={**os.environ, "TMPDIR": str(self.folder / "tmp"), "XDG_CACHE_HOME": str(self.folder / "cache")},
        )

    def finish(self) -> float:
        """Run undisturbed: the seconds that it took."""
        start = time.perf_counter()
        assert self.start().wait() == 0
        return time.perf_counter() - start

    def stop(self, number: signal.Signals, after: float, writing: bool = False) -> None:
        """Start, and send a signal after a while, and with ``writing`` only while a file is being written."""
        process = self.start()
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(after)
        while writing and process.poll() is None and not list((self.folder / "out").rglob(".*")):
            time.sleep(0.0005)
        process.send_signal(number)
        process.wait()

    def files(self) -> dict[str, bytes]:
        """What lies in the output folder, by path."""
        out = self.folder / "out"
        return {str(path.relative_to(out)): path.read_bytes() for path in out.rglob("*") if path.is_file()}

    def clear(self) -> None:
        """Empty the output folder."""
        for path in self.files():
            (self.folder / "out" / path).unlink()

    def content(self) -> dict[str, bytes]:
        """The same without what differs from run to run: times, which the benchmark measures and an EXR has in it."""
        return {name: CLOCK.sub(b"", data) if self.name != "bench" else b"" for name, data in self.files().items()}


def stop_at_random(name: str, number: signal.Signals, count: int, inputs: Path) -> int:
    """Stop a script ``count`` times; the number of hidden files that were left. Raises where anything else was."""
    rng = np.random.default_rng(0)
    run = Run(name, inputs)
    run.clear()
    if name != "part2_sample":  # whose run for the inputs has filled the caches
        run.finish()
    seconds = run.finish()
    whole = run.content()
    ends = {path: data[-8:] for path, data in run.files().items() if path.endswith((".png", ".svg", ".json"))}
    hidden = 0
    for moment in range(count):
        run.clear()
        # Every other time on purpose while a file is written: most moments are harmless.
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
    # The first runs probe, compile and keep: all that is written into caches is written in them.
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
    ("name", "number"),
    [("part2_sample", signal.SIGKILL), ("part2_sample", signal.SIGTERM), ("part3_shade", signal.SIGINT)],
)
def test_a_run_that_is_stopped_leaves_no_half_file(name: str, number: signal.Signals, inputs: Path) -> None:
    stop_at_random(name, number, 2, inputs)


def test_caches_whose_writing_was_stopped_are_used(inputs: Path) -> None:
    """The stops are in :func:`inputs`; what was sampled after them is right."""
    stopped, whole = (Samples.load(inputs / f"samples_{count}.npz") for count in (64, 256))
    np.testing.assert_array_equal(stopped.pixel, whole.pixel[:64])


if __name__ == "__main__":
    for script in SCRIPTS:
        for number in (signal.SIGKILL, signal.SIGTERM, signal.SIGINT):
            with tempfile.TemporaryDirectory() as folder:
                left = stop_at_random(script, number, int(sys.argv[1]), make_inputs(Path(folder)))
                print(f"{script:<14}{number.name:<9}{sys.argv[1]} moments, {left} hidden files left", flush=True)
