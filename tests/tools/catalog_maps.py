"""Makes a library of maps of ten kinds, one of them damaged, for trying out ``lightdome catalog``.

    python tests/tools/catalog_maps.py FOLDER --count 2000 --height 32

The same count and height always give the same maps.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenImageIO as oiio

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from helpers import stiff_radiance
from lightdome.maps.conversion import convert
from lightdome.maps.geometry import column_angles, directions, row_angles
from lightdome.maps.images import write_image

Random = np.random.Generator


def _sky(rng: Random, height: int) -> np.ndarray:
    """Blue above, brown below, brighter towards the horizon."""
    up = np.cos(row_angles(height))[:, None, None]
    zenith, ground = rng.uniform(0.2, 1, 3) * (0.4, 0.7, 1.4), rng.uniform(0.05, 0.3, 3) * (1.2, 1, 0.7)
    values = np.where(up > 0, zenith * (1.5 - up), ground * (1 + 0.3 * up))
    return np.broadcast_to(values, (height, 2 * height, 3)) * rng.uniform(0.8, 1.2, (height, 2 * height, 1))


def _lamp(rng: Random, height: int, elevation: float, power: float, radius: float) -> np.ndarray:
    towards = rng.uniform(0, 2 * np.pi)
    sine, cosine = np.sin(elevation), np.cos(elevation)
    centre = np.array([cosine * np.cos(towards), sine, cosine * np.sin(towards)])
    near = directions(row_angles(height)[:, None], column_angles(2 * height)) @ centre
    return power * np.exp((near - 1) / radius**2)[..., None] * rng.uniform(0.7, 1, 3)


def _sun(rng: Random, height: int) -> np.ndarray:
    return _sky(rng, height) + _lamp(rng, height, rng.uniform(0.1, 1.4), 10 ** rng.uniform(2, 4.5), 0.06)


def _room(rng: Random, height: int) -> np.ndarray:
    values = np.full((height, 2 * height, 3), rng.uniform(0.01, 0.2))
    for _ in range(rng.integers(1, 6)):
        values = values + _lamp(rng, height, rng.uniform(-0.3, 1.5), 10 ** rng.uniform(0, 2), rng.uniform(0.05, 0.3))
    return values


def _clipped(rng: Random, height: int) -> np.ndarray:
    return np.minimum(_sun(rng, height), 1)


def _night(rng: Random, height: int) -> np.ndarray:
    return 0.001 * _sky(rng, height) + _lamp(rng, height, rng.uniform(0, 0.2), 5, 0.02)


def _stiff(rng: Random, height: int) -> np.ndarray:
    return stiff_radiance(height, 2 * height, int(rng.integers(2**31)))


def _broken(rng: Random, height: int) -> np.ndarray:
    values = _sun(rng, height).astype(np.float32)
    values[rng.integers(height), rng.integers(2 * height)] = rng.choice([np.nan, np.inf, -1])
    return values


# Name, suffix, and pixels.
KINDS: tuple[tuple[str, str, Callable[[Random, int], np.ndarray]], ...] = (
    ("sun", ".exr", _sun),
    ("overcast", ".hdr", _sky),
    ("room", ".exr", _room),
    ("clipped", ".hdr", _clipped),
    ("night", ".pfm", _night),
    ("noise", ".pfm", _stiff),
    ("bad_pixels", ".exr", _broken),
    ("probe", ".exr", lambda rng, height: convert(_room(rng, height).astype(np.float32), "latlong", "angular")),
    ("cross", ".hdr", lambda rng, height: convert(_sun(rng, height).astype(np.float32), "latlong", "cube-cross")),
    ("damaged", ".exr", _room),
)


def make(folder: Path, count: int, height: int) -> None:
    """Write ``count`` maps, evenly divided among the kinds, below ``folder``."""
    for n in range(count):
        name, suffix, pixels = KINDS[n % len(KINDS)]
        path = folder / name / f"{name}_{n:05}{suffix}"
        path.parent.mkdir(parents=True, exist_ok=True)
        values = pixels(np.random.default_rng(n), height).astype(np.float32)
        if suffix == ".hdr":
            file = oiio.ImageOutput.create(str(path))
            file.open(str(path), oiio.ImageSpec(values.shape[1], values.shape[0], 3, oiio.FLOAT))
            file.write_image(np.ascontiguousarray(values))
            file.close()
        else:
            write_image(path, values)
        if name == "damaged":
            content = path.read_bytes()
            path.write_bytes(content[: len(content) * (n % 89) // 100])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="folder for the maps, with a subfolder per kind")
    parser.add_argument("--count", type=int, default=2000, help="number of maps")
    parser.add_argument("--height", type=int, default=32, help="height of most maps, in pixels")
    args = parser.parse_args()
    make(args.folder, args.count, args.height)


if __name__ == "__main__":
    main()
