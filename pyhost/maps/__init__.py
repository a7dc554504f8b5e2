"""An environment map on the host: image files, the map, the geometry of its pixels, and what is in it."""

from __future__ import annotations

from importlib import import_module

TYPE_CHECKING = False

if TYPE_CHECKING:
    from .analysis import analyse as analyse
    from .analysis import split_sun as split_sun
else:

    def __getattr__(name: str) -> object:
        # When first used: the geometry alone needs no image library.
        if name in ("analyse", "split_sun"):
            return getattr(import_module(".analysis", __name__), name)
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
