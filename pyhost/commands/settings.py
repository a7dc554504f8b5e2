"""What results were made with, kept beside them: machine, device, versions, map, options, and the files' sums.

:func:`settings` gathers it, :func:`write` leaves it as ``settings.json`` when all files are complete,
:func:`read` takes it only if those files are still the same, and :func:`difference` says whether they are what
somebody needs.
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

if TYPE_CHECKING:  # a script without a map or a device needs no libraries for them
    from ..maps.envmap import EnvironmentMap
    from ..opencl.device import Device

NAME = "settings.json"
BLOCK = 2**24  # bytes at a time


def settings(device: Device | None, envmap: EnvironmentMap | None, options: Mapping[str, object]) -> dict[str, object]:
    """What a result depends on: the machine, the versions, the options, and device and map if there are any."""
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
    """JSON's types only: paths become text, in lists too."""
    if isinstance(value, list):
        return [_plain(item) for item in value]
    return str(value) if isinstance(value, Path) else value


def _processor() -> str:
    """The processor's name: Linux keeps it in /proc/cpuinfo only."""
    with contextlib.suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor()


def map_sum(envmap: EnvironmentMap) -> str:
    """SHA-256 of the map's radiance, whatever file it came in."""
    return hashlib.sha256(envmap.radiance.data).hexdigest()


def file_sum(path: Path) -> str:
    """SHA-256 of a file, which may be larger than the memory. Raises ``OSError`` where it cannot be read."""
    result, done = hashlib.sha256(), 0
    with path.open("rb") as file, Progress(f"summing {path.name}") as progress:
        size = os.fstat(file.fileno()).st_size
        while block := file.read(BLOCK):
            result.update(block)
            done += len(block)
            progress.update(done / max(size, done))
    return result.hexdigest()


def write(folder: Path, content: Mapping[str, object], names: Iterable[str]) -> None:
    """Write ``content`` and the sums of the complete files ``names`` in ``folder`` to its ``settings.json``."""
    sums = {name: file_sum(folder / name) for name in sorted(names)}
    write_json(folder / NAME, {**content, "files": sums})


def read(path: Path) -> dict[str, object] | None:
    """The settings in ``path``; None if there are none, or if files beside it are not those that it was written for."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        sums = content.get("files", {})
        return content if all(file_sum(path.parent / name) == sums[name] for name in sums) else None
    except (OSError, ValueError, AttributeError, TypeError):
        return None


def difference(found: Mapping[str, object], wanted: Mapping[str, object]) -> str | None:
    """The first entry of ``wanted`` that ``found`` has not or has otherwise, as in ``options.spp``; else None."""
    for name, value in wanted.items():
        there = found.get(name)
        if isinstance(value, Mapping) and isinstance(there, Mapping):
            inner = difference(there, value)
            if inner:
                return f"{name}.{inner}"
        elif name not in found or there != value:
            return name
    return None
