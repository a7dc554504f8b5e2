"""Maps behind URLs, read from servers on loopback, some of which misbehave."""

from __future__ import annotations

import base64
import os
import sys
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from helpers import LONG, stiff_radiance
from lightdome.errors import LightdomeError
from lightdome.maps.images import write_image

pytest.importorskip("distributed")
pytest.importorskip("pyarrow")

import fsspec
from lightdome.catalog.columns import columns
from lightdome.catalog.computing import Run, rows
from lightdome.catalog.journal import Journal
from lightdome.catalog.page import write_page
from lightdome.catalog.remote import Remote, name_of, reason, without_secrets
from lightdome.catalog.row import Options
from lightdome.catalog.sources import DEEPEST, find
from lightdome.catalog.table import write_csv, write_parquet

if TYPE_CHECKING:
    from distributed import Client

OPTIONS = Options(lights=2, harmonics=None, memory=1 << 20)
PASSWORD = "joe:se@cret"


class Handler(SimpleHTTPRequestHandler):
    """Serves files; some names make it misbehave."""

    server: Server

    def do_GET(self) -> None:
        self.server.asked[self.path] += 1
        name = self.path.rpartition("/")[2].partition("?")[0]
        content = (Path(self.directory) / "m1.exr").read_bytes()
        if self.path.startswith("/private/"):
            said = self.headers["Authorization"] == f"Basic {base64.b64encode(PASSWORD.encode()).decode()}"
            self.answer(200 if said else 401, content if said else b"")
        elif name == "truncated.exr":
            self.answer(200, content[:-100], length=len(content))
        elif name == "huge.exr":
            self.answer(200, content, length=10**15)
        elif name == "endless.exr":
            self.answer(200, b"", length=None)
            self.sent = 0
            while not self.server.closing.is_set():
                self.sent += self.wfile.write(bytes(1 << 16))
        elif name in ("silent.exr", "silent"):
            self.server.closing.wait(LONG)
        elif name == "stalling.exr":
            self.answer(200, content[:100], length=len(content))
            self.server.closing.wait(LONG)
        elif name == "moved.exr":
            self.answer(302, b"", to="/m1.exr")
        elif name == "local.exr":
            self.answer(302, b"", to=f"file://{self.directory}/m1.exr")
        elif name == "circle.exr":
            self.answer(302, b"", to="/circle.exr")
        elif name == "odd":
            links = ("file:///m1.exr", "http://localhost:1/m1.exr", "//localhost:1/m1.exr", "../../m1.exr", "m1.exr?x")
            self.answer(
                200, "".join(f'<a href="{link}">x</a>' for link in (*links, "fine.exr")).encode(), kind="text/html"
            )
        else:
            super().do_GET()

    def do_HEAD(self) -> None:
        if self.path.endswith(("huge.exr", "silent.exr", "moved.exr", "local.exr", "circle.exr")):
            self.do_GET()
        elif (Path(self.directory) / self.path[1:]).exists():
            super().do_HEAD()
        else:
            self.answer(405, b"")

    def answer(
        self, status: int, body: bytes, length: int | None = -1, to: str = "", kind: str = "image/x-exr"
    ) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        if length is not None:
            self.send_header("Content-Length", str(len(body) if length < 0 else length))
        if to:
            self.send_header("Location", to)
        self.end_headers()
        if self.command == "GET":
            self.wfile.write(body)

    def log_message(self, *_: object) -> None:
        pass


class Server(ThreadingHTTPServer):
    """Counts the bodies that were asked for, by path."""

    def __init__(self, folder: Path) -> None:
        super().__init__(("127.0.0.1", 0), partial(Handler, directory=str(folder)))
        self.asked: Counter[str] = Counter()
        self.closing = threading.Event()
        self.base = f"http://127.0.0.1:{self.server_port}"

    def handle_error(self, *_: object) -> None:
        pass  # clients hang up


@contextmanager
def serving(folder: Path) -> Iterator[Server]:
    with Server(folder) as server:
        threading.Thread(target=server.serve_forever, args=[0.01], daemon=True).start()
        yield server
        server.closing.set()
        server.shutdown()


@pytest.fixture
def server(tmp_path: Path) -> Iterator[Server]:
    pytest.importorskip("aiohttp")
    folder = tmp_path / "served"
    (folder / "with space").mkdir(parents=True)
    write_image(folder / "m1.exr", stiff_radiance(8, 16, 1))
    write_image(folder / "with space" / "m2.pfm", stiff_radiance(8, 16, 2))
    (folder / "notes.html").touch()
    with serving(folder) as server:
        yield server


def run(client: Client, paths: list[str], out: Path) -> tuple[int, list[dict[str, Any]]]:
    """How many rows were computed, and all rows; the table and the page lie in ``out``."""
    sources = find(paths)
    out.mkdir(exist_ok=True)
    with Journal(out, OPTIONS.key) as journal:
        work = Run(sources, OPTIONS, journal, out, LONG)
        work(client)
        write_parquet(out / "catalog.parquet", columns(OPTIONS), lambda: rows(journal, sources), len(sources))
        write_csv(out / "catalog.csv", columns(OPTIONS), lambda: rows(journal, sources))
        write_page(out / "index.html", OPTIONS, lambda: rows(journal, sources))
        return work.total - work.known, list(rows(journal, sources))


def test_a_folder_of_a_server_is_searched_like_one_on_disk(server: Server, tmp_path: Path) -> None:
    found = [f"{server.base}/m1.exr", f"{server.base}/with%20space/m2.pfm"]
    assert list(find([f"{server.base}/"])) == found
    assert list(find([f"{server.base}/*.exr"])) == found[:1]
    (tmp_path / "list.txt").write_text(f"{found[1]}\n{server.base}/with%20space\n\n{found[0]}?version=2\n")
    assert list(find([str(tmp_path / "list.txt")]).values()) == [f"{found[0]}?version=2", found[1]]


def test_a_listing_cannot_name_other_places_and_ends(server: Server, tmp_path: Path) -> None:
    """A page's links lead to nothing but the same server, and a link to its own folder not for ever."""
    assert all(name.startswith(f"{server.base}/odd/") for name in find([f"{server.base}/odd"]))
    (tmp_path / "served" / "again").symlink_to(tmp_path / "served")
    assert len(find([f"{server.base}/"])) <= 2 * DEEPEST


def test_each_url_costs_one_row_however_its_server_behaves(client: Client, server: Server, tmp_path: Path) -> None:
    bad = {
        "none": "404",
        "truncated": "payload is not completed",
        "huge": "larger than 1 MB; raise --limit-memory",
        "endless": "larger than 1 MB; raise --limit-memory",
        "local": "file:///",
        "circle": "TooManyRedirects",
    }
    names = ["m1", "moved", *bad]
    (tmp_path / "list.txt").write_text("".join(f"{server.base}/{name}.exr\n" for name in names))
    _, found = run(client, [str(tmp_path / "list.txt")], tmp_path / "out")
    by_name = {row["path"].rpartition("/")[2].removesuffix(".exr"): row for row in found}
    assert [name for name, row in by_name.items() if row["status"] == "failed"] == sorted(bad)
    for name, words in bad.items():
        error = by_name[name]["error"]
        assert error.startswith(f"cannot read {server.base}/{name}.exr: ")
        assert words in error
        assert "\n" not in error
    assert by_name["moved"]["lights"] == by_name["m1"]["lights"]


def test_a_silent_server_is_given_up_before_its_map_would_end_the_worker(server: Server) -> None:
    begin = time.monotonic()
    with pytest.raises(LightdomeError, match="Timeout"):
        Remote(f"{server.base}/silent.exr", 1.2)
    with pytest.raises(LightdomeError, match="Timeout"), Remote(f"{server.base}/stalling.exr", 1.2).copied(1 << 20):
        pass
    with pytest.raises(LightdomeError, match=r"cannot list .*Timeout"):
        find([f"{server.base}/silent"], 0.4)
    assert time.monotonic() - begin < 30


def test_a_url_is_read_again_only_if_its_version_is_another(client: Client, server: Server, tmp_path: Path) -> None:
    paths = [f"{server.base}/m1.exr", f"{server.base}/truncated.exr"]
    map_file, out = tmp_path / "served" / "m1.exr", tmp_path / "out"
    assert run(client, paths, out)[0] == 2
    count, before = run(client, paths, out)
    assert (count, server.asked["/m1.exr"]) == (1, 1)
    assert before[0]["status"] == "done"
    os.utime(map_file, (1e9, 1e9))  # another version, the same content: read, not computed
    count, same = run(client, paths, out)
    assert (count, server.asked["/m1.exr"]) == (1, 2)
    assert same[0] == before[0]
    write_image(map_file, stiff_radiance(8, 16, 3))
    count, after = run(client, paths, out)
    assert (count, server.asked["/m1.exr"]) == (2, 3)
    assert after[0]["sha256"] != before[0]["sha256"]


def test_secrets_in_a_url_are_used_and_never_written(
    client: Client, server: Server, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    base, out = server.base.replace("://", f"://{PASSWORD}@"), tmp_path / "out"
    urls = [f"{base}/private/{name}.exr?signature=secret{name}" for name in ("a", "b")]
    wrong = [url.replace("joe", "secretary") for url in urls[:1]]
    _, found = run(client, [*urls, f"{base}/none.exr?signature=secret"], out)
    assert [row["status"] for row in found] == ["failed", "done", "done"]
    assert found[1]["path"] == name_of(urls[0])
    assert found[1]["path"].startswith(f"{server.base}/private/a.exr?")
    assert found[1]["path"] != found[2]["path"].replace("b.exr", "a.exr")
    _, refused = run(client, wrong, tmp_path / "wrong")
    assert "401" in refused[0]["error"]
    with pytest.raises(LightdomeError) as error:
        find([f"http://{PASSWORD}@127.0.0.1:1/folder/?signature=secret"])
    written = [path.read_bytes() for path in (*out.iterdir(), *(tmp_path / "wrong").iterdir())]
    told = "".join([str(error.value), *capfd.readouterr()]).encode()
    assert len(written) == 8
    assert not [text for text in (*written, told) if b"cret" in text]


def test_messages_lose_only_secrets() -> None:
    text = "ClientError: 404, url='https://joe:x@y@host:80/a@b.exr?token=1', see /home/joe@work/m.exr?"
    assert without_secrets(text) == "ClientError: 404, url='https://host:80/a@b.exr?...', see /home/joe@work/m.exr?"
    assert "cret" not in reason(ValueError("x" * 180 + f" http://{PASSWORD}@host/"))
    assert name_of("/home/joe@work/what?.exr") == "/home/joe@work/what?.exr"


def test_what_a_url_needs_is_told_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules["fsspec.registry"]._registry, "s3", raising=False)
    for missing, url, words in (("aiohttp", "http://localhost/", "aiohttp"), ("s3fs", "s3://maps/", "Install s3fs")):
        monkeypatch.setitem(sys.modules, missing, None)
        with pytest.raises(LightdomeError, match=words) as error:
            find([url])
        assert "\n" not in str(error.value)
    with pytest.raises(LightdomeError, match="not known"):
        find(["nonsense://maps/"])


def test_file_urls_are_read_too(client: Client, tmp_path: Path) -> None:
    (tmp_path / "maps").mkdir()
    write_image(tmp_path / "maps" / "m1.exr", stiff_radiance(8, 16, 1))
    _, (first, second) = run(client, [f"file://{tmp_path}/maps", str(tmp_path / "maps")], tmp_path / "out")
    assert first["path"].startswith("/")
    assert first["lights"] == second["lights"]
    assert first["sha256"] == second["sha256"]


@pytest.mark.slow
def test_a_bucket_is_searched_and_read(client: Client, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("s3fs", reason="needs s3fs")
    moto = pytest.importorskip("moto.server", reason="needs moto[server], an S3 server")
    for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
        monkeypatch.setenv(name, "testing")
    server = moto.ThreadedMotoServer("127.0.0.1", port=0, verbose=False)
    server.start()
    try:
        monkeypatch.setenv("AWS_ENDPOINT_URL", "http://{}:{}".format(*server.get_host_and_port()))
        files = fsspec.filesystem("s3")
        files.mkdir("maps")
        for n in range(2):
            write_image(tmp_path / f"m{n}.exr", stiff_radiance(8, 16, n))
            files.put(str(tmp_path / f"m{n}.exr"), f"maps/below/m{n}.exr")
        paths, out = ["s3://maps", "s3://maps/m1.exr"], tmp_path / "out"
        _, found = run(client, paths, out)
        assert [row["path"] for row in found] == [
            "s3://maps/below/m0.exr",
            "s3://maps/below/m1.exr",
            "s3://maps/m1.exr",
        ]
        assert [row["status"] for row in found] == ["done", "done", "failed"]
        assert found[2]["error"].startswith("cannot read s3://maps/m1.exr: FileNotFoundError")
        assert run(client, paths, out)[0] == 1
        files.put(str(tmp_path / "m0.exr"), "maps/below/m1.exr")
        _, after = run(client, paths, out)
        assert after[1]["sha256"] == found[0]["sha256"]
    finally:
        server.stop()
