"""What results were made with, stored next to them: machine, device, versions, map, options, and the files' checksums.

:func:`settings` gathers it, :func:`write` stores it as ``settings.json`` once all files are complete, :func:`read`
returns it only if those files are unchanged, and :func:`difference` tells whether the results are the ones wanted.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import platform
from collections.abc import Iterable, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

from .. import __version__
from ..files import write_json
from ..progress import Progress

if TYPE_CHECKING:  # a command without a map or a device does not need their libraries
    from ..maps.envmap import EnvironmentMap
    from ..opencl.device import Device

NAME = "settings.json"
BLOCK = 2**24  # bytes at a time


def settings(device: Device | None, envmap: EnvironmentMap | None, options: Mapping[str, object]) -> dict[str, object]:
    """What a result depends on: the machine, the versions, the options, and the device and map if any."""
    return {
        "machine": {
            "system": platform.platform(),
            "processor": _processor(),
            "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        },
        "device": device
        and {
            "name": device.handle.name.strip(),
            "implementation": device.handle.platform.version.strip(),
            "driver": device.handle.driver_version,
            "compute_units": device.handle.max_compute_units,
        },
        "versions": {
            "lightdome": __version__,
            "python": platform.python_version(),
            **{name: version(name) for name in ("numpy", "pyopencl", "OpenImageIO", "matplotlib")},
        },
        "map": envmap and {"width": envmap.width, "height": envmap.height, "sha256": map_sum(envmap)},
        "options": {name: _plain(value) for name, value in options.items()},
    }


def _plain(value: object) -> object:
    """The value in JSON types: paths become text, in lists too."""
    if isinstance(value, list):
        return [_plain(item) for item in value]
    return str(value) if isinstance(value, Path) else value


def _processor() -> str:
    """The processor's name, which Linux has only in /proc/cpuinfo."""
    with contextlib.suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor()


def map_sum(envmap: EnvironmentMap) -> str:
    """SHA-256 of the map's radiance, whatever file it came from."""
    return hashlib.sha256(envmap.radiance.data).hexdigest()


def file_sum(path: Path) -> str:
    """SHA-256 of a file, which may be larger than memory. Raises ``OSError`` if it cannot be read."""
    result, done = hashlib.sha256(), 0
    with path.open("rb") as file, Progress(f"checksum of {path.name}") as progress:
        size = os.fstat(file.fileno()).st_size
        while block := file.read(BLOCK):
            result.update(block)
            done += len(block)
            progress.update(done / max(size, done))
    return result.hexdigest()


def write(folder: Path, content: Mapping[str, object], names: Iterable[str]) -> None:
    """Write ``content`` and the checksums of the complete files ``names`` to ``settings.json`` in ``folder``."""
    sums = {name: file_sum(folder / name) for name in sorted(names)}
    write_json(folder / NAME, {**content, "files": sums})


def read(path: Path) -> dict[str, object] | None:
    """The settings in ``path``; None if there are none, or if the files next to it have changed since."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        sums = content.get("files", {})
        return content if all(file_sum(path.parent / name) == sums[name] for name in sums) else None
    except (OSError, ValueError, AttributeError, TypeError):
        return None


def difference(found: Mapping[str, object], wanted: Mapping[str, object]) -> str | None:
    """The first entry of ``wanted`` that ``found`` lacks or that differs, such as ``options.spp``; else None."""
    for name, value in wanted.items():
        there = found.get(name)
        if isinstance(value, Mapping) and isinstance(there, Mapping):
            inner = difference(there, value)
            if inner:
                return f"{name}.{inner}"
        elif name not in found or there != value:
            return name
    return None
