"""Where the map is that lightdome ships."""

from __future__ import annotations

from pathlib import Path


def default_map() -> Path:
    """The file of the environment map that ships, from any folder: a chapel at dusk, 1024 x 512.

    It is ``data/default.exr`` of the clone where the package is one, see ``data/README.md`` there.
    """
    package = Path(__file__).resolve().parents[1]
    of_wheel = package / "data"
    return (of_wheel if of_wheel.is_dir() else package.parent / "data") / "default.exr"
