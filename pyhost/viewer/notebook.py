"""The page in a notebook."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import TYPE_CHECKING

from .. import checks
from ..errors import LightdomeError
from ..maps.envmap import EnvironmentMap
from ..opencl.device import Device

if TYPE_CHECKING:
    from .server import Server

MISSING = "the page needs starlette, uvicorn and websockets: pip install 'lightdome[view]'"


class View:
    """The page of some maps: a notebook shows it in a frame, and :attr:`url` is its address.

    It runs until :meth:`close`, or until the program ends.
    """

    def __init__(self, device: Device | None, maps: list[tuple[str, str, EnvironmentMap]], height: int) -> None:
        from .gate import NOTEBOOKS

        self._server = server_class()(device, maps, frames=NOTEBOOKS)
        self.height = height

    @property
    def url(self) -> str:
        """The address, for a browser on this machine; it holds a token, and anyone who knows it may use the page."""
        return self._server.url

    def __repr__(self) -> str:
        return f"<View: {self.url}>"

    def _repr_html_(self) -> str:
        return (
            f'<iframe src="{escape(self.url)}" width="100%" height="{self.height}" style="border:0"'
            ' title="lightdome view" allow="clipboard-write"></iframe>'
        )

    def close(self) -> None:
        """End the server."""
        self._server.close()


def view(
    envmap: EnvironmentMap | Mapping[str, EnvironmentMap], device: Device | None = None, height: int = 900
) -> View:
    """Show a page with a map, or several by name, its samples, the sphere and the error as the user turns the light.

    - ``device``: by default the one of :func:`lightdome.open_device`
    - ``height``: of the frame in a notebook, in pixels

    The page is served to this machine only, and only to those who have its address. Raises :class:`LightdomeError` if
    the extra ``[view]`` is not installed, and for anything but maps.
    """
    maps = dict(envmap) if isinstance(envmap, Mapping) else {"map": envmap}
    if not maps:
        raise LightdomeError("expected a map, or several by name, got none")
    for name, each in maps.items():
        checks.instance(f"the map {name}", each, EnvironmentMap)
    height = checks.whole("the height", height, 100, 10000)
    return View(device, [(str(name), "MAP", each) for name, each in maps.items()], height)


def server_class() -> type[Server]:
    """:class:`lightdome.viewer.server.Server`; raises :class:`LightdomeError` where what it needs is not installed."""
    try:
        import starlette  # noqa: F401
        import uvicorn  # noqa: F401
        import websockets  # noqa: F401
    except ImportError as error:
        raise LightdomeError(MISSING) from error
    from .server import Server

    return Server
