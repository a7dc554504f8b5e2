"""The default map matches the script that makes it, and fetching Grace fails cleanly or not at all."""

from __future__ import annotations

import contextlib
import hashlib
import http.server
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import numpy as np
import OpenImageIO as oiio
import pytest
from helpers import GRACE, LONG, ROOT, Script, command_line, module_of, script_path

MAP = ROOT / "data" / "default.exr"


@pytest.fixture(autouse=True)
def without_proxies(monkeypatch: pytest.MonkeyPatch) -> None:
    """Avoid proxies, which would come between a test and its server."""
    for name in [name for name in os.environ if name.lower().endswith("_proxy")]:
        monkeypatch.delenv(name)


# --- the default map ------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def default_map() -> np.ndarray:
    source = oiio.ImageInput.open(str(MAP))
    pixels = np.asarray(source.read_image("half"))
    source.close()
    return pixels


def test_default_map_is_a_small_half_float_exr_without_a_date() -> None:
    source = oiio.ImageInput.open(str(MAP))
    spec = source.spec()
    assert (spec.width, spec.height, spec.nchannels) == (1024, 512, 3)
    assert str(spec.format) == "half"
    assert spec.getattribute("compression") == "zip"
    assert "DateTime" not in [attribute.name for attribute in spec.extra_attribs]
    assert MAP.stat().st_size < 1_500_000
    source.close()


def test_default_map_has_the_dynamic_range_of_a_dark_interior(default_map: np.ndarray) -> None:
    pixels = default_map.astype(np.float64)
    luminance = pixels.mean(axis=2)
    assert np.isfinite(pixels).all()
    assert pixels.min() > 0
    assert 100 < luminance.max() < 1000
    assert 1e-3 < np.median(luminance) < 3e-2
    assert luminance.max() > 1e4 * np.median(luminance)


def test_default_map_and_its_script_agree(default_map: np.ndarray) -> None:
    rows = [1, 158, 201, 333, 470, 511]
    again = module_of("make_default_map").render_rows(rows)
    # Neighbouring values of the file are four half-float steps apart (see render_rows).
    steps = np.abs(again.view(np.int16).astype(int) - default_map[rows].view(np.int16).astype(int))
    assert steps.max() <= 4
    assert np.count_nonzero(steps) <= 1e-3 * steps.size


def test_default_map_lights_warmly_from_the_upper_left_and_coolly_from_the_right(
    default_map: np.ndarray,
) -> None:
    pixels = default_map.astype(np.float64)
    height, width, _ = pixels.shape
    theta = np.pi * (np.arange(height)[:, None] + 0.5) / height
    phi = 2 * np.pi * (np.arange(width) + 0.5) / width
    direction = np.stack([np.sin(theta) * np.cos(phi), np.cos(theta) + 0 * phi, np.sin(theta) * np.sin(phi)], axis=2)
    weight = np.sin(theta) * 2 * np.pi**2 / (width * height)

    def irradiance(x: float, y: float, z: float) -> np.ndarray:
        normal = np.array([x, y, z]) / np.linalg.norm([x, y, z])
        cosine = np.maximum(direction @ normal, 0) * weight
        return np.einsum("yx,yxc->c", cosine, pixels)

    left, right, below = irradiance(-0.6, 0.5, 0.6), irradiance(0.95, 0.1, 0.3), irradiance(0.3, -0.9, 0.3)
    assert left[0] > 1.8 * left[2]
    assert right[2] > right[0]
    assert left.mean() > 1.5 * right.mean() > 1.5 * below.mean()
    row, column = np.unravel_index(np.argmax(pixels.mean(axis=2)), (height, width))
    assert direction[row, column] @ np.array([-0.6, 0.5, 0.6]) / np.sqrt(0.97) > 0.9


def test_making_the_map_refuses_a_bad_target_before_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    make = module_of("make_default_map")
    monkeypatch.setattr(make, "render", lambda: pytest.fail("the work was begun"))

    def refused(name: str) -> tuple[object, str]:
        monkeypatch.setattr(sys, "argv", ["make_default_map.py", "--out", str(tmp_path / name)])
        with pytest.raises(SystemExit) as exit_:
            make.run(make.main)
        return exit_.value.code, capsys.readouterr().err

    assert refused("map.png")[0] == 2
    status, errors = refused("missing/map.exr")
    assert status == 1
    assert errors.startswith("make_default_map: cannot write")
    assert errors.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


# --- fetching Grace -------------------------------------------------------------------------------

SIZE = 1_726_329
BODY = bytes(range(256)) * 40
GOOD = {"size": len(BODY), "sha256": hashlib.sha256(BODY).hexdigest()}


class Handler(http.server.BaseHTTPRequestHandler):
    stop: threading.Event  # set when the fixture ends, to release slow answers
    listened = threading.Event()  # set when half of an endless answer is sent

    def log_message(self, *_: object) -> None: ...

    def answer(self, body: bytes, length: int | None = None) -> None:
        self.send_response(200)
        if length != 0:
            self.send_header("Content-Length", str(length or len(body)))
        self.end_headers()
        self.wfile.write(body)
        self.wfile.flush()

    def do_GET(self) -> None:
        with contextlib.suppress(ConnectionError):
            self.route(self.path)

    def route(self, path: str) -> None:
        if path == "/good":
            self.answer(BODY)
        elif path == "/wrong":
            self.answer(bytes(SIZE))
        elif path == "/short":
            self.answer(bytes(1000))
        elif path == "/unlimited":
            self.answer(b"", 0)
            while not self.stop.is_set():
                self.wfile.write(bytes(1 << 16))
        elif path == "/broken":
            self.answer(bytes(SIZE // 2), SIZE)
        elif path == "/endless":  # never silent, so that only a signal ends the client
            self.answer(bytes(SIZE // 2), SIZE)
            self.listened.set()
            while not self.stop.wait(0.05):
                self.wfile.write(b".")
        elif path == "/garbage":
            self.wfile.write(b"\x1b[31mno\r\n\r\n")
        elif path.startswith("/to/"):
            self.send_response(302)
            self.send_header("Location", path.removeprefix("/to/"))
            self.end_headers()
        else:
            self.send_error(404)


@pytest.fixture(scope="module")
def server() -> Iterator[str]:
    Handler.stop = threading.Event()
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler) as listening:
        listening.daemon_threads = True
        thread = threading.Thread(target=listening.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{listening.server_port}"
        Handler.stop.set()
        listening.shutdown()
        thread.join()


@pytest.fixture
def get_grace() -> ModuleType:
    return module_of("get_grace")


def assert_failed(result: subprocess.CompletedProcess[str], folder: Path, *words: str) -> None:
    assert result.returncode == 1, result
    assert result.stdout == ""
    assert result.stderr.startswith("get_grace: ")
    assert result.stderr.count("\n") == 1
    assert "\x1b" not in result.stderr
    for word in words:
        assert word in result.stderr
    assert list(folder.iterdir()) == []


@pytest.mark.parametrize(
    ("path", "words"),
    [
        ("/wrong", ("not the Grace map", "SHA-256", "--from FILE")),
        ("/short", ("not the Grace map", "1,000 bytes instead of 1,726,329")),
        ("/unlimited", ("not the Grace map", "more than 1,726,329 bytes")),
        ("/broken", ("863,164 bytes instead of 1,726,329", "try again")),
        ("/missing", ("404", "--from FILE")),
        ("/garbage", ("cannot read", "--from FILE")),
        ("/to/short", ("not the Grace map",)),
        ("/to/file:///etc/hostname", ("file:///etc/hostname", "not allowed")),
    ],
)
def test_a_bad_answer_is_one_line_and_leaves_nothing(
    script: Script, server: str, tmp_path: Path, path: str, words: tuple[str, ...]
) -> None:
    path = path.replace("/to/short", f"/to/{server}/short")
    assert_failed(script("get_grace", "--from", server + path, "--out", tmp_path / "g.exr"), tmp_path, *words)


def test_a_refused_connection_gives_one_line(script: Script, tmp_path: Path) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"http://127.0.0.1:{free.getsockname()[1]}/g.exr"
    result = script("get_grace", "--from", address, "--out", tmp_path / "g.exr")
    assert_failed(result, tmp_path, "cannot read", "refused", "--from FILE")


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ("file:///etc/hostname", ("No such file",)),
        ("http://", ("cannot read",)),
        ("no/such/file.exr", ("No such file",)),
        ("x" * 5000, ("cannot read",)),
        ("/dev/zero", ("more than 1,726,329 bytes",)),
        (str(script_path("get_grace")), ("not the Grace map",)),
    ],
)
def test_a_bad_source_gives_one_line(script: Script, tmp_path: Path, source: str, words: tuple[str, ...]) -> None:
    assert_failed(script("get_grace", "--from", source, "--out", tmp_path / "g.exr"), tmp_path, *words)


def test_a_target_that_cannot_be_written_gives_one_line(server: str, tmp_path: Path, get_grace: ModuleType) -> None:
    for out in (tmp_path / "missing" / "g.exr", tmp_path, Path(os.devnull)):
        with pytest.raises(SystemExit, match=r"^get_grace: cannot write .* with --out$"):
            get_grace.fetch(server + "/good", out, **GOOD)
    assert not Path(os.devnull).is_file()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(os.name != "posix", reason="needs signals")
@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_leaves_nothing(server: str, tmp_path: Path, number: int, status: int) -> None:
    Handler.listened.clear()
    process = subprocess.Popen(
        command_line("get_grace", "--from", server + "/endless", "--out", tmp_path / "g.exr"),
        stderr=subprocess.PIPE,
        text=True,
    )
    while not Handler.listened.wait(0.02):
        assert process.poll() is None
    process.send_signal(number)
    _, errors = process.communicate(timeout=LONG)
    assert process.returncode == status, errors
    assert "Traceback" not in errors
    assert list(tmp_path.iterdir()) == []


def test_the_right_file_arrives_and_replaces_a_wrong_one(server: str, tmp_path: Path, get_grace: ModuleType) -> None:
    out = tmp_path / "g.exr"
    out.write_bytes(b"wrong")
    get_grace.fetch(f"{server}/to/{server}/good", out, **GOOD)
    assert out.read_bytes() == BODY
    get_grace.fetch(str(out), tmp_path / "copy.exr", **GOOD)
    assert sorted(file.name for file in tmp_path.iterdir()) == ["copy.exr", "g.exr"]


def test_a_failure_keeps_the_file_that_was_there(server: str, tmp_path: Path, get_grace: ModuleType) -> None:
    out = tmp_path / "g.exr"
    out.write_bytes(b"mine")
    with pytest.raises(SystemExit, match="not the Grace map"):
        get_grace.fetch(server + "/good", out)
    assert out.read_bytes() == b"mine"


def test_get_grace_needs_nothing_installed(tmp_path: Path) -> None:
    python, *command = command_line("get_grace", "--from", "missing.exr", "--out", tmp_path / "g.exr")
    result = subprocess.run([python, "-S", "-I", *command], capture_output=True, text=True, timeout=LONG)
    assert_failed(result, tmp_path, "No such file")


def test_wrong_command_line_exits_with_2(script: Script) -> None:
    assert script("get_grace", "--form", "x").returncode == 2


def test_the_real_grace_map_is_accepted_and_not_fetched_twice(script: Script, tmp_path: Path) -> None:
    if not GRACE.is_file():
        pytest.skip("needs the Grace map: run scripts/get_grace.py")
    out = tmp_path / "g.exr"
    first = script("get_grace", "--from", GRACE, "--out", out)
    assert (first.returncode, first.stderr) == (0, "")
    assert "Paul Debevec" in first.stdout
    again = script("get_grace", "--from", "http://127.0.0.1:1/never", "--out", out)
    assert again.returncode == 0
    assert "already exists" in again.stdout
    assert [file.name for file in tmp_path.iterdir()] == ["g.exr"]
