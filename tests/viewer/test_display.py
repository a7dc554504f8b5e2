"""Images reach tev through tevclient; a plain socket takes tev's place."""

from __future__ import annotations

import socket
import struct
import threading

import numpy as np
import pytest
from helpers import Script
from lightdome.errors import LightdomeError
from lightdome.maps.images import read_image
from lightdome.viewer import display


def test_without_tevclient_one_line_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(display, "find_spec", lambda name: None)
    with pytest.raises(LightdomeError, match="pip install tevclient"):
        display.check_display()


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # tevclient leaves its socket open
def test_no_tev_gives_a_one_line_error() -> None:
    pytest.importorskip("tevclient", reason="needs tevclient")
    with socket.create_server(("127.0.0.1", 0)) as closed:
        port = closed.getsockname()[1]
    with pytest.raises(LightdomeError, match=f"no tev listens at 127.0.0.1:{port}"):
        display.display("127.0.0.1", port, "image", np.zeros((4, 4, 3), np.float32))


def test_a_command_sends_the_image_that_it_writes(run_here: Script, tmp_path: object) -> None:
    pytest.importorskip("tevclient", reason="needs tevclient")
    heard = bytearray()
    with socket.create_server(("127.0.0.1", 0)) as server:

        def listen() -> None:
            with server.accept()[0] as connection:
                while part := connection.recv(2**16):
                    heard.extend(part)

        listening = threading.Thread(target=listen)
        listening.start()
        port = server.getsockname()[1]
        run = run_here("exact", "--resolution", 15, "--out", tmp_path, "--display", f"127.0.0.1:{port}")
        assert run.returncode == 0, run.stderr
        listening.join(60)
    image = read_image(tmp_path / "exact_centres.pfm")
    assert b"exact_centres" in heard
    assert struct.pack("<f", image[7, 7, 0]) in heard
