"""Serves the page, and answers its requests over a WebSocket.

Of each kind of request, a page has at most one waiting: a newer one replaces it. The page asks for the next picture
only when it has its answer, so nothing piles up. One thread computes for all pages in turn.
"""

from __future__ import annotations

import asyncio
import contextlib
import ipaddress
import json
import secrets
import socket
import tempfile
import threading
import traceback
from collections.abc import Awaitable, Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, TypeVar

import uvicorn
from starlette.applications import Starlette
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from .. import checks
from ..errors import LightdomeError
from ..lighting.light_files import write_lights
from ..maps.envmap import EnvironmentMap
from ..names import LIGHT_FORMATS
from ..opencl.device import Device, open_device
from .engine import Engine, Sent
from .gate import Gate
from .messages import packed, parse_setting
from .reflectance import reflectance
from .shell import commands
from .upload import MOST_BYTES, Checker

T = TypeVar("T")

STATIC = Path(__file__).parent / "static"
FILES = {  # the only files that are served
    "": ("index.html", "text/html"),
    "style.css": ("style.css", "text/css"),
    **{f"{name}.js": (f"{name}.js", "text/javascript") for name in ("main", "state", "draw", "plots", "tabs")},
}
REST_SECONDS = 0.2  # without a new request before the exact image is started
MESSAGE_BYTES = 2**16  # largest message from a page
MOST_PAGES = 16
UPLOAD_SECONDS = 60.0


class Wishes:
    """A page's waiting requests ("wishes"): of each kind at most one, the newest."""

    def __init__(self) -> None:
        self._wishes: dict[str, dict[str, Any]] = {}
        self._event = asyncio.Event()

    def __len__(self) -> int:
        return len(self._wishes)

    def put(self, wish: dict[str, Any]) -> None:
        """Add a wish, in place of an older one of the same kind."""
        kind = wish.get("do")
        if isinstance(kind, str) and kind in DO:
            self._wishes[kind] = wish
            self._event.set()

    async def get(self, seconds: float | None = None) -> dict[str, Any] | None:
        """The next wish, or None if none comes within ``seconds``."""
        try:
            await asyncio.wait_for(self._event.wait(), seconds)
        except asyncio.TimeoutError:
            return None
        wish = self._wishes.pop(next(iter(self._wishes)))
        if not self._wishes:
            self._event.clear()
        return wish


class Server:
    """Serves the page for some maps at :attr:`url` until :meth:`close`, in its own threads."""

    def __init__(
        self,
        device: Device | None,
        maps: Sequence[tuple[str, str, EnvironmentMap]],
        host: str = "127.0.0.1",
        port: int = 0,
        frames: Sequence[str] = (),
    ) -> None:
        self.token = secrets.token_urlsafe(24)
        self._compute = ThreadPoolExecutor(1, "lightdome compute")
        self._checks = ThreadPoolExecutor(1, "lightdome check")  # checks take seconds, and must not hold up the pages
        self._checker: Checker | None = None
        self.engine = self._compute.submit(lambda: Engine(device or open_device(), list(maps))).result()
        self.pages = 0
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        listening = self._listening = socket.socket(family)
        try:
            listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listening.bind((host, port))
            listening.listen()  # connections wait until the server's loop runs
        except OSError as error:
            listening.close()
            raise LightdomeError(
                f"cannot listen on {host} port {port}: {error.strerror or error}; choose another --port or --host"
            ) from error
        self.host, self.port = listening.getsockname()[:2]
        routes = [
            WebSocketRoute("/talk", self._talk),
            Route("/check", self._check, methods=["POST"]),
            Route("/{name:path}", self._file, methods=["GET"]),
        ]
        names = [] if is_loopback(host) else [host, socket.gethostname()]
        config = uvicorn.Config(
            Gate(Starlette(routes=routes), self.token, names, frames),
            log_level="error",
            lifespan="off",
            access_log=False,
            server_header=False,
            ws="websockets-sansio",
            ws_max_size=MESSAGE_BYTES,
            ws_max_queue=4,
            ws_per_message_deflate=False,  # floats hardly compress, and trying takes longer than all the rest
            timeout_graceful_shutdown=1,
        )
        self._uvicorn = uvicorn.Server(config)
        self._thread = threading.Thread(
            target=self._uvicorn.run, kwargs={"sockets": [listening]}, name="lightdome view", daemon=True
        )
        self._thread.start()

    @property
    def url(self) -> str:
        """The address of the page; anyone who knows it can use the server."""
        host = socket.gethostname() if self.host in ("0.0.0.0", "::") else self.host
        host = f"[{host}]" if ":" in host else host
        return f"http://{host}:{self.port}/{self.token}/"

    def wait(self) -> None:
        """Wait until the server ends."""
        while self._thread.is_alive():
            self._thread.join(1.0)

    def close(self) -> None:
        """Stop the server and wait for it to end."""
        self._uvicorn.should_exit = True
        self._thread.join()
        self._listening.close()  # uvicorn leaves it open if it is stopped before it has started
        for threads in self._compute, self._checks:
            threads.shutdown(cancel_futures=True)

    # ---- the page's files ----

    async def _file(self, request: Request) -> Response:
        found = FILES.get(request.path_params["name"])
        if found is None:
            return PlainTextResponse("there is no such page", 404)
        name, kind = found
        return Response((STATIC / name).read_bytes(), media_type=kind)

    # ---- the page's requests ----

    async def _run(self, function: Callable[..., T], *arguments: object) -> T:
        """Run a function in the thread that owns the device."""
        return await asyncio.get_running_loop().run_in_executor(self._compute, function, *arguments)

    async def _talk(self, socket: WebSocket) -> None:
        if self.pages >= MOST_PAGES:
            await socket.close(1013)
            return
        self.pages += 1
        wishes = Wishes()
        try:
            await socket.accept()
            answering = asyncio.create_task(self._answers(socket, wishes))
            try:
                while True:
                    with contextlib.suppress(ValueError, AttributeError, RecursionError):
                        wishes.put(json.loads(await socket.receive_text()))
            finally:
                answering.cancel()
                with contextlib.suppress(asyncio.CancelledError, WebSocketDisconnect, RuntimeError):
                    await answering
        except (WebSocketDisconnect, KeyError):  # KeyError: the page sent bytes
            pass
        finally:
            self.pages -= 1

    async def _answers(self, socket: WebSocket, wishes: Wishes) -> None:
        """Answer until the page is gone; an unexpected error is printed and closes the connection."""
        try:
            await self._answer(socket, wishes)
        except (WebSocketDisconnect, asyncio.CancelledError):
            raise
        except Exception:
            traceback.print_exc()
            await socket.close(1011)

    async def _answer(self, socket: WebSocket, wishes: Wishes) -> None:
        """Answer wishes; while none waits, compute what the last picture still lacks."""
        sent, after = Sent(), None
        hello = {
            "kind": "hello",
            "maps": [scene.name for scene in self.engine.scenes],
            "device": self.engine.device.description,
        }
        await socket.send_bytes(packed(hello, {}))
        while True:
            wish = await wishes.get(REST_SECONDS if after is not None else None)
            try:
                if wish is None:
                    assert after is not None
                    steps = self.engine.rest(after, sent)
                    while not len(wishes):
                        answer = await self._run(next, steps, b"")
                        if answer == b"":
                            after = None
                            break
                        if answer:
                            await socket.send_bytes(answer)
                    steps.close()
                    continue
                if wish["do"] == "frame":
                    after = None
                    setting = parse_setting(wish, len(self.engine.scenes))
                    await socket.send_bytes(await self._run(self.engine.frame, setting, sent))
                    after = None if setting.is_moving else setting
                else:
                    await socket.send_bytes(await DO[wish["do"]](self, wish))
            except LightdomeError as error:
                await socket.send_bytes(packed({"kind": "error", "of": wish and wish["do"], "text": str(error)}, {}))

    async def _map(self, wish: dict[str, Any]) -> bytes:
        number = checks.whole("the map", wish.get("map"), 0, len(self.engine.scenes) - 1)
        return await self._run(self.engine.map, number)

    async def _fresnel(self, wish: dict[str, Any]) -> bytes:
        return packed({"kind": "fresnel", **reflectance(wish.get("eta"))}, {})

    async def _save(self, wish: dict[str, Any]) -> bytes:
        """The lights as a file for another program, which the page offers as a download."""
        form = checks.choice("format of lights", wish.get("format"), LIGHT_FORMATS)
        lights = await self._run(self.engine.lights, parse_setting(wish, len(self.engine.scenes)))
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, f"lights{LIGHT_FORMATS[form]}")
            write_lights(path, lights, form)
            return packed({"kind": "saved", "name": path.name, "text": path.read_text("ascii")}, {})

    async def _command(self, wish: dict[str, Any]) -> bytes:
        setting = parse_setting(wish, len(self.engine.scenes))
        lines, note = commands(setting, self.engine.scenes[setting.map].arguments)
        return packed({"kind": "command", "lines": lines, "note": note}, {})

    def _checked(self, options: dict[str, str], data: bytes) -> bytes:
        if self._checker is None:  # a device belongs to one thread, so this one needs its own
            device = open_device(self.engine.device.description)
            self._checker = Checker(device, [scene.envmap for scene in self.engine.scenes])
        return self._checker.checked(options, data)

    async def _check(self, request: Request) -> Response:
        """Check an uploaded image."""
        try:
            data = await asyncio.wait_for(_body(request), UPLOAD_SECONDS)
            if data is None:
                return JSONResponse({"error": f"a file may have at most {MOST_BYTES >> 20} MiB"}, 413)
            loop = asyncio.get_running_loop()
            answer = await loop.run_in_executor(self._checks, self._checked, dict(request.query_params), data)
        except LightdomeError as error:
            return JSONResponse({"error": str(error)}, 422)
        except (ClientDisconnect, asyncio.TimeoutError):
            return JSONResponse({"error": "the file did not arrive"}, 408)
        return Response(answer, media_type="application/octet-stream")


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach a server at ``host``."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


async def _body(request: Request) -> bytes | None:
    """The body of a request, or None if it is too large."""
    data = bytearray()
    async for part in request.stream():
        data += part
        if len(data) > MOST_BYTES:
            return None
    return bytes(data)


DO: dict[str, Callable[[Server, dict[str, Any]], Awaitable[bytes]]] = {
    "frame": Server._map,  # never called: _answer handles frames itself
    "map": Server._map,
    "fresnel": Server._fresnel,
    "save": Server._save,
    "command": Server._command,
}
