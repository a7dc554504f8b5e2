"""Sends images to a running tev, which listens for renderers.

The package tevclient implements tev's protocol: https://github.com/Tom94/tev
"""

from __future__ import annotations

from importlib.util import find_spec

import numpy as np

from ..errors import LightdomeError, one_line

PORT = 14158  # tev's default
MISSING = "--display needs tevclient, for Python 3.11 and newer: pip install tevclient"


def check_display() -> None:
    """Raise :class:`LightdomeError` if tevclient is missing, before an image is computed in vain."""
    if find_spec("tevclient") is None:
        raise LightdomeError(MISSING)


def display(host: str, port: int, name: str, image: np.ndarray) -> None:
    """Show ``image`` (H, W, 3), in radiance, in the tev that listens at ``host`` and ``port``.

    Raises :class:`LightdomeError` if tevclient is missing or no tev listens there.
    """
    check_display()
    import tevclient  # type: ignore[import-not-found, unused-ignore]

    height, width, _ = image.shape
    channels = ["R", "G", "B"]
    try:
        with tevclient.Ipc(host, port) as tev:
            tev.create_image(name, width, height, channels)
            tev.update_image(name, np.ascontiguousarray(image, np.float32), channels)
    except OSError as error:
        raise LightdomeError(
            f"no tev listens at {host}:{port} ({error.strerror or one_line(error)}); start it, or leave out --display"
        ) from error
