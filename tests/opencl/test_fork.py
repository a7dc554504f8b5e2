"""A forked process has none of OpenCL's threads: it reports that, instead of waiting for them."""

from __future__ import annotations

import subprocess
import sys

import pytest

pytestmark = pytest.mark.slow

SET_UP = """
import multiprocessing, os, sys
from concurrent.futures import ProcessPoolExecutor
import numpy as np
import lightdome
from lightdome.opencl import memory
from lightdome.rendering import render

def attempt(work):
    try:
        return f"returned {work()}"
    except lightdome.LightdomeError as error:
        return str(error)

def in_a_fork(work):
    reading, writing = os.pipe()
    if os.fork() == 0:
        os.write(writing, attempt(work).encode())
        os._exit(0)
    os.close(writing)
    os.wait()
    return os.read(reading, 4096).decode()

def count():
    device = lightdome.open_device()
    envmap = lightdome.EnvironmentMap(np.ones((4, 8, 3), np.float32))
    return len(lightdome.build_distribution(device, envmap).sample(5))
"""
OPENED = """
device = lightdome.open_device()
envmap = lightdome.EnvironmentMap(np.ones((4, 8, 3), np.float32))
distribution = lightdome.build_distribution(device, envmap)
array = memory.zeros(device, 4, np.float32)
images = render(distribution, [1, 2], 8)
next(images)
kernel = device.kernel("limits/launch")
device.launch("limits/launch", (1,))
"""
SECONDS = 60  # a fork that waits for them waits forever


def run(program: str) -> list[str]:
    result = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", SET_UP + program], capture_output=True, text=True, timeout=SECONDS
    )
    assert result.returncode == 0, result.stderr
    return result.stdout.splitlines()


@pytest.mark.skipif(not hasattr(__import__("os"), "fork"), reason="needs fork")
def test_a_device_in_a_fork_is_one_line_that_says_spawn() -> None:
    ways = [
        "lambda: distribution.sample(5)",
        "lambda: next(images)",
        "lambda: lightdome.open_device()",
        "lambda: memory.upload(device, np.ones(4, np.float32))",
        "lambda: memory.download(device, array)",
        "lambda: device.kernel('lighting/exact', WIDTH=1)",
        "lambda: kernel(device.queue, (1,), (1,))",
        "lambda: device.launch('limits/launch', (1,))",
    ]
    program = OPENED + "".join(f"print(in_a_fork({way}))\n" for way in ways)
    program += "context = multiprocessing.get_context('fork')\n"
    program += "with context.Pool(1) as pool: print(pool.apply(attempt, [count]))\n"
    program += "with ProcessPoolExecutor(1, context) as pool: print(pool.submit(attempt, count).result())\n"
    program += "print('here', len(distribution.sample(5)))\n"
    *lines, here = run(program)
    assert len(lines) == len(ways) + 2
    for line in lines:
        assert "forked" in line, line
        assert "get_context('spawn')" in line
    assert here == "here 5"


@pytest.mark.skipif(not hasattr(__import__("os"), "fork"), reason="needs fork")
def test_a_fork_of_a_process_without_a_device_opens_its_own() -> None:
    assert run("print(in_a_fork(count))\nprint(in_a_fork(count))\nprint(count())") == ["returned 5", "returned 5", "5"]
