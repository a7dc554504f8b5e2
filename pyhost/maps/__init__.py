"""Environment maps on the host: image files, maps, the geometry and projection of their pixels, and their content."""

from __future__ import annotations

from importlib import import_module

TYPE_CHECKING = False

if TYPE_CHECKING:
    from .analysis import analyse as analyse
    from .analysis import split_sun as split_sun
    from .conversion import convert as convert
else:

    def __getattr__(name: str) -> object:
        # Loaded on first use: the geometry alone needs no image library.
        home = {"analyse": "analysis", "split_sun": "analysis", "convert": "conversion"}.get(name)
        if home:
            return getattr(import_module(f".{home}", __name__), name)
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
