"""Mitsuba's process answers, and reports in one line what goes wrong; another object stands in for Mitsuba."""

from __future__ import annotations

import multiprocessing
import os
import signal
import time
from collections.abc import Iterator

import numpy as np
import pytest
from lightdome.errors import LightdomeError
from lightdome.evaluation.mitsuba_process import MitsubaProcess


class Adder:
    """Adds to an array that it keeps."""

    def __init__(self, kept: np.ndarray) -> None:
        if not kept.size:
            raise LightdomeError("needs numbers;\nand more of them")
        self.kept = kept
        self.about = {"sum": float(kept.sum())}

    def add(self, value: float) -> np.ndarray:
        for stream in (1, 2):  # as a library in C does
            os.write(stream, b"noise")
        return self.kept + value

    def fail(self) -> None:
        raise ValueError("no such map\nand more lines")

    def crash(self) -> None:
        os.abort()

    def leave(self) -> None:
        raise SystemExit(3)

    def sleep(self) -> None:
        time.sleep(600)


@pytest.fixture
def adder() -> Iterator[MitsubaProcess]:
    process = MitsubaProcess(Adder, np.arange(200_000.0))  # more than a pipe holds
    yield process
    process.stop()


def test_the_process_keeps_its_worker_and_survives_an_error(adder: MitsubaProcess) -> None:
    assert adder.about == {"sum": 199_999 * 100_000.0}
    for value in (1, 2):
        np.testing.assert_array_equal(adder.call("add", value, timeout=60), np.arange(200_000.0) + value)
        with pytest.raises(LightdomeError, match=r"^ValueError: no such map$"):
            adder.call("fail", timeout=60)


def test_the_process_writes_nothing_on_the_terminal(capfd: pytest.CaptureFixture[str]) -> None:
    process = MitsubaProcess(Adder, np.ones(1))  # only now that capfd has taken over the streams it inherits
    process.call("add", 1, timeout=60)
    process.stop()
    assert capfd.readouterr() == ("", "")


@pytest.mark.skipif(os.name != "posix", reason="crashes are told by signals")
@pytest.mark.parametrize(
    ("method", "timeout", "said"),
    [("crash", 60, rf"crashed \(signal {signal.SIGABRT:d}\)"), ("leave", 60, "exit status 3"), ("sleep", 0.1, "0 s")],
)
def test_a_process_that_ends_or_hangs_is_an_error_and_stays_one(
    adder: MitsubaProcess, method: str, timeout: float, said: str
) -> None:
    assert multiprocessing.active_children()
    with pytest.raises(LightdomeError, match=said):
        adder.call(method, timeout=timeout)
    with pytest.raises(LightdomeError, match="has ended"):
        adder.call("add", 1, timeout=60)
    assert not multiprocessing.active_children()


def test_a_worker_that_cannot_be_made_says_why() -> None:
    with pytest.raises(LightdomeError, match=r"^needs numbers;$"):
        MitsubaProcess(Adder, np.zeros(0))


def test_a_worker_that_does_not_start_in_time_is_stopped() -> None:
    with pytest.raises(LightdomeError, match="did not answer"):
        MitsubaProcess(Adder, np.ones(1), start_timeout=0.01)
    assert not multiprocessing.active_children()
