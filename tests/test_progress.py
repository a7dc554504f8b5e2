"""Long work shows its progress: a bar on a terminal, occasional lines elsewhere, in order with other output."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from helpers import LONG, command_line, stiff_radiance
from lightdome import progress
from lightdome.maps.images import write_image
from lightdome.progress import Progress


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The seconds on the clock."""
    now = [1000.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(Progress, "_last_line", float("-inf"))
    return now


def work(clock: list[float], seconds: int) -> None:
    """Work with other work nested in it, which reports its progress every second."""
    with Progress("all") as whole:
        for second in range(seconds):
            with Progress("a part") as part:
                part.update(0.5)
            clock[0] += 1
            whole.update((second + 1) / seconds)


def test_without_a_terminal_lines_are_occasional(clock: list[float], capsys: pytest.CaptureFixture[str]) -> None:
    work(clock, 4)
    assert capsys.readouterr().err == ""
    work(clock, 100)
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "all: 5 %, 95 s left"
    assert 3 <= len(lines) <= 1 + 100 // 30
    work(clock, 20)  # less than half a minute after the last line
    assert capsys.readouterr().err == ""


def test_nested_work_reports_in_the_same_line(clock: list[float], capsys: pytest.CaptureFixture[str]) -> None:
    with Progress("all"):
        clock[0] += 10
        with Progress("a part") as part:
            clock[0] += 5
            part.update(0.25)
    assert capsys.readouterr().err == "all: 15 s so far; a part: 25 %, 15 s left\n"


def test_a_terminal_shows_a_bar_and_no_lines(clock: list[float], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", Terminal())
    work(clock, 100)
    assert "\n" not in sys.stderr.getvalue()
    assert "[####" in sys.stderr.getvalue()
    assert sys.stderr.getvalue().endswith("\r\x1b[K")


@pytest.mark.slow
def test_messages_keep_their_order_in_one_pipe(tmp_path: Path) -> None:
    write_image(tmp_path / "odd.pfm", stiff_radiance(9, 11))
    result = subprocess.run(
        command_line("part2_sample", "--map", tmp_path / "odd.pfm", "--counts", 4, "--out", tmp_path / "out"),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=LONG,
        env={**os.environ, "PYTHONUNBUFFERED": ""},
    )
    starts = [line.split()[0] for line in result.stdout.splitlines()]
    assert starts == ["device:", "map:", "note:", "wrote", "exposure"]


def test_short_work_prints_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    with Progress("short") as short:
        for fraction in np.linspace(0, 1, 5):
            short.update(fraction)
    assert capsys.readouterr().err == ""
