"""Shows the page in a notebook."""

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
    """The page for some maps. A notebook shows it in a frame; :attr:`url` is its address.

    Its server runs until :meth:`close`, or until the program ends.
    """

    def __init__(self, device: Device | None, maps: list[tuple[str, str, EnvironmentMap]], height: int) -> None:
        from .gate import NOTEBOOKS

        self._server = server_class()(device, maps, frames=NOTEBOOKS)
        self.height = height

    @property
    def url(self) -> str:
        """The address, for a browser on this machine. It contains a token: anyone who knows it can use the page."""
        return self._server.url

    def __repr__(self) -> str:
        return f"<View: {self.url}>"

    def _repr_html_(self) -> str:
        return (
            f'<iframe src="{escape(self.url)}" width="100%" height="{self.height}" style="border:0"'
            ' title="lightdome view" allow="clipboard-write"></iframe>'
        )

    def close(self) -> None:
        """Stop the server."""
        self._server.close()


def view(
    envmap: EnvironmentMap | Mapping[str, EnvironmentMap], device: Device | None = None, height: int = 900
) -> View:
    """Show a map, or several by name, on an interactive page with samples, the sphere and the error.

    - ``device``: by default, what :func:`lightdome.open_device` opens
    - ``height``: height of the frame in a notebook, in pixels

    The page is served only on this machine, and only to those who know its address. Raises :class:`LightdomeError` if
    the packages of the extra ``[view]`` are missing, and for anything but maps.
    """
    maps = dict(envmap) if isinstance(envmap, Mapping) else {"map": envmap}
    if not maps:
        raise LightdomeError("expected a map, or several by name, got none")
    for name, each in maps.items():
        checks.instance(f"the map {name}", each, EnvironmentMap)
    height = checks.whole("the height", height, 100, 10000)
    return View(device, [(str(name), "MAP", each) for name, each in maps.items()], height)


def server_class() -> type[Server]:
    """:class:`lightdome.viewer.server.Server`; raises :class:`LightdomeError` if its packages are missing."""
    try:
        import starlette  # noqa: F401
        import uvicorn  # noqa: F401
        import websockets  # noqa: F401
    except ImportError as error:
        raise LightdomeError(MISSING) from error
    from .server import Server

    return Server
