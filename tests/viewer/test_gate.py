"""Nobody gets in without the address, and no other site's page can control the server."""

from __future__ import annotations

import http.client
import json
import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack

import numpy as np
import pytest
from lightdome.maps.envmap import EnvironmentMap
from lightdome.opencl.device import Device

pytest.importorskip("starlette", reason="needs the extra [view]")
pytest.importorskip("uvicorn", reason="needs the extra [view]")
pytest.importorskip("websockets", reason="needs the extra [view]")

from lightdome.viewer.server import FILES, MOST_PAGES, STATIC, Server, is_loopback
from lightdome.viewer.upload import MOST_BYTES
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect


@pytest.fixture(scope="module")
def server(device: Device) -> Iterator[Server]:
    radiance = np.random.default_rng(0).gamma(0.3, 1, (16, 32, 3)).astype(np.float32)
    opened = Server(device, [("small", "small.exr", EnvironmentMap(radiance))])
    yield opened
    opened.close()


def ask(
    server: Server, path: str | None = None, method: str = "GET", body: bytes | None = None, **headers: str
) -> tuple[int, bytes, dict[str, str]]:
    """Send a request with exactly these headers, and by default the right Host: status, body, headers of the answer."""
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=60)
    connection.putrequest(method, f"/{server.token}/" if path is None else path, skip_host=True)
    for name, value in {"Host": f"127.0.0.1:{server.port}", **headers}.items():
        connection.putheader(name, value)
    if body is not None:
        connection.putheader("Content-Length", str(len(body)))
    connection.endheaders(body)
    answer = connection.getresponse()
    result = answer.status, answer.read(), {name.lower(): value for name, value in answer.getheaders()}
    connection.close()
    return result


def test_it_listens_on_this_machine_alone(server: Server) -> None:
    assert server.host == "127.0.0.1"
    assert is_loopback(server.host)
    assert is_loopback("::1")
    assert is_loopback("localhost")
    assert not is_loopback("0.0.0.0")
    assert not is_loopback("192.168.1.2")
    with pytest.raises(ConnectionRefusedError):  # another loopback address of this machine
        socket.create_connection(("127.0.0.2", server.port), 5)


def test_a_server_closed_at_once_listens_no_more(device: Device, server: Server) -> None:
    other = Server(device, [("small", "small.exr", server.engine.scenes[0].envmap)])
    other.close()
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", other.port), 5)


def test_the_page_and_its_files_are_served_with_the_token(server: Server) -> None:
    for name in FILES:
        status, body, headers = ask(server, f"/{server.token}/{name}")
        assert status == 200
        assert body
        assert "default-src 'none'" in headers["content-security-policy"]
        assert headers["x-content-type-options"] == "nosniff"
        assert headers["referrer-policy"] == "no-referrer"
        assert headers["cache-control"] == "no-store"
    assert {name for name, _ in FILES.values()} == {path.name for path in STATIC.iterdir()}


def test_tokens_are_long_and_never_the_same(server: Server, device: Device) -> None:
    other = Server(device, [("small", "small.exr", server.engine.scenes[0].envmap)])
    other.close()
    assert other.token != server.token
    assert len(server.token) >= 32


@pytest.mark.parametrize("name", ["", "main.js", "check"])
@pytest.mark.parametrize("prefix", ["/", "/WRONG/", "/{token}x/", "/{half}/", "//{token}/", "/%00/", "/%C3%A9/"])
def test_without_the_token_nothing_is_served(server: Server, prefix: str, name: str) -> None:
    path = prefix.format(token=server.token, half=server.token[:16]) + name
    status, body, headers = ask(server, path)
    assert status == 403
    assert server.token.encode() not in body
    assert "default-src 'none'" in headers["content-security-policy"]


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:{port}", "127.0.0.1.evil.example:{port}", "", "[", "a:b:c"]
)
def test_another_name_that_points_at_this_machine_is_refused(server: Server, host: str) -> None:
    """DNS rebinding: another site's name points at this machine, so browsers take this server for that site."""
    status, body, _ = ask(server, Host=host.format(port=server.port))
    assert status == 403
    assert server.token.encode() not in body


def test_two_hosts_are_refused(server: Server) -> None:
    connection = socket.create_connection(("127.0.0.1", server.port), 10)
    here = f"Host: 127.0.0.1:{server.port}\r\n"
    connection.sendall(f"GET /{server.token}/ HTTP/1.1\r\n{here}Host: evil.example\r\n\r\n".encode())
    assert connection.recv(100).split()[1] in (b"400", b"403")
    connection.close()


def test_localhost_is_this_machine_too(server: Server) -> None:
    assert ask(server, Host=f"localhost:{server.port}")[0] == 200


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "http://127.0.0.1:1", "https://127.0.0.1:{port}", ""]
)
def test_pages_of_other_sites_are_refused(server: Server, origin: str) -> None:
    assert ask(server, Origin=origin.format(port=server.port))[0] == 403


def test_a_post_must_say_that_it_comes_from_the_page(server: Server) -> None:
    path = f"/{server.token}/check?suffix=.pfm"
    assert ask(server, path, "POST", b"x")[0] == 403
    assert ask(server, path, "POST", b"x", Origin="http://evil.example")[0] == 403
    assert ask(server, path, "POST", b"x", Origin=f"http://127.0.0.1:{server.port}")[0] == 422


def talk(server: Server, path: str | None = None, **headers: str) -> connect:
    """Open a WebSocket, by default as the page does."""
    origin = headers.pop("Origin", f"http://127.0.0.1:{server.port}")
    address = f"ws://127.0.0.1:{server.port}" + (f"/{server.token}/talk" if path is None else path)
    options = {"compression": None, "max_size": 2**26, "close_timeout": 0.5}
    return connect(address, origin=origin or None, additional_headers=headers, **options)


@pytest.mark.parametrize("origin", ["", "http://evil.example", "null", "http://localhost:{port}"])
def test_a_websocket_of_another_page_is_refused(server: Server, origin: str) -> None:
    with pytest.raises(InvalidStatus, match="403"), talk(server, Origin=origin.format(port=server.port)):
        pass


def test_a_websocket_without_the_token_is_refused(server: Server) -> None:
    for path in "/talk", "/wrong/talk", "/":
        with pytest.raises(InvalidStatus, match="403"), talk(server, path):
            pass


@pytest.mark.parametrize(
    "name",
    [
        "../names.py",
        "..%2fnames.py",
        "/etc/passwd",
        "%2fetc%2fpasswd",
        "static/main.js",
        "__init__.py",
        "index.html",
        "talk",
    ],
)
def test_no_path_of_a_client_leads_to_a_file(server: Server, name: str) -> None:
    assert ask(server, f"/{server.token}/{name}")[0] == 404


def test_only_the_given_maps_can_be_read(server: Server) -> None:
    with talk(server) as page:
        assert heard(page)["kind"] == "hello"
        for number in -1, 1, "small.exr", "../secret.exr", None, True, 0.0, [0]:
            page.send(json.dumps({"do": "map", "map": number}))
            assert heard(page)["kind"] == "error"
        page.send(json.dumps({"do": "map", "map": 0}))
        assert heard(page)["name"] == "small"


def heard(page: ClientConnection) -> dict[str, object]:
    """Receive the next answer, and return its header."""
    answer = page.recv(timeout=60)
    length = int.from_bytes(answer[:4], "little")
    return json.loads(answer[4 : 4 + length])


@pytest.mark.parametrize(
    "text", ["", "[]", "1", "{", '{"do": 1}', '{"do": "quit"}', '{"do": ["frame"]}', "[" * 5000, '"\\ud800"']
)
def test_unknown_requests_change_nothing(server: Server, text: str) -> None:
    with talk(server) as page:
        heard(page)
        page.send(text)
        page.send(json.dumps({"do": "fresnel", "eta": 1.4}))
        assert heard(page)["kind"] == "fresnel"


FRAME = {
    "do": "frame",
    "map": 0,
    "method": "shared",
    "sequence": "sobol",
    "count": 16,
    "seed": 0,
    "pitch": 0,
    "roll": 0,
    "albedo": 1,
    "resolution": 1023,
    "moving": True,
}


@pytest.mark.slow
def test_nothing_piles_up_for_a_client_that_does_not_read(server: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    computed, frame = [], server.engine.frame
    monkeypatch.setattr(server.engine, "frame", lambda *setting: computed.append(1) or frame(*setting))
    with talk(server) as slow:
        last = 0, time.monotonic()  # the client keeps 16 answers of 6 MB, and reads no more
        for yaw in range(3000):
            slow.send(json.dumps(FRAME | {"yaw": yaw % 360}))
            time.sleep(0.01)
            if len(computed) != last[0]:
                last = len(computed), time.monotonic()
            elif computed and time.monotonic() - last[1] > 1:
                break
        assert len(computed) <= 30 < yaw
        with talk(server) as quick:  # others do not wait
            assert heard(quick)["kind"] == "hello"
            quick.send(json.dumps(FRAME | {"yaw": 0, "resolution": 31}))
            assert heard(quick)["kind"] == "frame"


def test_messages_and_files_are_limited_in_size(server: Server) -> None:
    with talk(server) as page:
        heard(page)
        page.send("x" * 10**6)
        with pytest.raises(ConnectionClosed):
            page.recv(timeout=60)
    origin = f"http://127.0.0.1:{server.port}"
    path = f"/{server.token}/check?suffix=.pfm"
    status, body, _ = ask(server, path, "POST", bytes(MOST_BYTES + 1), Origin=origin)
    assert status == 413
    assert b"64 MiB" in body


def test_the_number_of_pages_is_limited(server: Server) -> None:
    with ExitStack() as open_pages:
        for _ in range(MOST_PAGES):
            heard(open_pages.enter_context(talk(server)))
        with pytest.raises(InvalidStatus, match="403"):
            open_pages.enter_context(talk(server))


@pytest.mark.parametrize("suffix", ["", ".png", ".npz", "/../../x.pfm", ".pfm/../y", "..", ".PFM\0"])
def test_a_file_s_name_is_never_used(server: Server, suffix: str) -> None:
    from urllib.parse import quote

    path = f"/{server.token}/check?suffix={quote(suffix)}&map=0"
    status, body, _ = ask(server, path, "POST", b"PF\n1 1\n-1\n" + bytes(12), Origin=f"http://127.0.0.1:{server.port}")
    assert status == 422
    assert "kind of file" in json.loads(body)["error"]
