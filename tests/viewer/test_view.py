"""The command serves the page until it is stopped, and a notebook shows the same page in a frame."""

from __future__ import annotations

import http.client
import re
import signal
import subprocess
import sys
from pathlib import Path
from urllib.request import urlopen

import lightdome
import numpy as np
import pytest
from helpers import LONG
from lightdome.maps.images import write_image
from lightdome.viewer import notebook

pytest.importorskip("starlette", reason="needs the extra [view]")
pytest.importorskip("uvicorn", reason="needs the extra [view]")
pytest.importorskip("websockets", reason="needs the extra [view]")


@pytest.fixture
def map_file(tmp_path: Path) -> Path:
    path = tmp_path / "small.pfm"
    write_image(path, np.random.default_rng(0).random((8, 16, 3)).astype(np.float32))
    return path


@pytest.mark.slow
def test_the_command_prints_its_address_and_ends_on_ctrl_c(map_file: Path) -> None:
    words = [sys.executable, "-m", "lightdome", "view", str(map_file), "--no-browser"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        said = [process.stdout.readline() for _ in range(2)]
        address = re.fullmatch(r"open (http://127\.0\.0\.1:\d+/[\w-]{32}/)\n", said[1])
        assert address, said
        with urlopen(address[1], timeout=LONG) as answer:
            assert b"lightdome view" in answer.read()
        process.send_signal(signal.SIGINT)
        process.wait(LONG)
        assert process.returncode == 130
        assert "Traceback" not in process.stderr.read()


@pytest.mark.slow
def test_another_host_gives_a_warning_and_keeps_the_token(map_file: Path) -> None:
    words = [sys.executable, "-m", "lightdome", "view", str(map_file), "--no-browser", "--host", "0.0.0.0"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        said = [process.stdout.readline() for _ in range(2)]
        port = int(re.search(r":(\d+)/", said[1])[1])
        connection = http.client.HTTPConnection("127.0.0.1", port, timeout=LONG)
        connection.request("GET", "/")
        assert connection.getresponse().status == 403
        connection.close()
        process.send_signal(signal.SIGINT)
        process.wait(LONG)
        assert "can be reached from the network" in process.stderr.read()


def test_a_port_in_use_gives_a_one_line_error(device: lightdome.Device) -> None:
    from lightdome.viewer.server import Server

    envmap = lightdome.EnvironmentMap(np.ones((4, 8, 3), np.float32))
    server = Server(device, [("one", "one.exr", envmap)])
    with pytest.raises(lightdome.LightdomeError, match=f"cannot listen on 127.0.0.1 port {server.port}"):
        Server(device, [("one", "one.exr", envmap)], port=server.port)
    server.close()


def test_a_notebook_shows_the_page_in_a_frame(device: lightdome.Device) -> None:
    envmap = lightdome.EnvironmentMap(np.ones((4, 8, 3), np.float32))
    page = lightdome.view({"one": envmap, "two": envmap.mirrored()}, device)
    try:
        assert f'<iframe src="{page.url}"' in page._repr_html_()
        with urlopen(page.url, timeout=LONG) as answer:
            assert "frame-ancestors 'self' http://localhost:*" in answer.headers["Content-Security-Policy"]
    finally:
        page.close()
    with pytest.raises(OSError, match="refused"):
        urlopen(page.url, timeout=LONG)


@pytest.mark.parametrize(("wrong", "said"), [("map.exr", "must be of type EnvironmentMap"), ({}, "got none")])
def test_only_maps_can_be_viewed(wrong: object, said: str) -> None:
    with pytest.raises(lightdome.LightdomeError, match=said):
        lightdome.view(wrong)


def test_missing_packages_give_a_one_line_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "uvicorn", None)
    with pytest.raises(lightdome.LightdomeError, match=r"pip install 'lightdome\[view\]'"):
        notebook.server_class()
