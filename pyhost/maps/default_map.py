"""The path of the map that comes with lightdome."""

from __future__ import annotations

from pathlib import Path


def default_map() -> Path:
    """The path of the environment map that comes with lightdome: a chapel at dusk, 1024 x 512 pixels.

    It works from any folder. In a clone, this is ``data/default.exr``; see ``data/README.md``.
    """
    package = Path(__file__).resolve().parents[1]
    of_wheel = package / "data"
    return (of_wheel if of_wheel.is_dir() else package.parent / "data") / "default.exr"
