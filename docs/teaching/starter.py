#!/usr/bin/env python3
"""The exercise: write the four functions that raise NotImplementedError, and run it. Usage: starter.py [MAP] [OUT]

The code that reads and writes files is already here. docs/teaching/README.md describes the exercise and what to hand
in. Angles are in radians. A map is linear radiance (H, W, 3), and an image is (R, R, 3); row 0 is at the top in both.
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import numpy as np

try:
    import lightdome  # only to read and write files
except ImportError:
    sys.exit("lightdome is not installed for this Python; run scripts/demo, then this with .venv/bin/python")

RESOLUTION = 255  # pixels
COUNTS = (64, 256, 1024)  # numbers of samples that all pixels share
SPP = (8, 16)  # samples per pixel
SEED = 1


# ---- Write these functions ----


def fresnel(angle: np.ndarray, eta_from: float, eta_to: float) -> tuple[np.ndarray, np.ndarray]:
    """Part 1: the reflectance of a dielectric at angles of incidence (N,), for p- and s-polarised light, (N,) each.

    Light comes from a medium with the index of refraction ``eta_from``; the medium behind the surface has ``eta_to``.
    """
    raise NotImplementedError


def sample(radiance: np.ndarray, count: int, random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Part 2: draw pixels of the map by their light: integers (N, 2), x and y, and their probabilities p(x, y), (N,).

    p(x, y) is proportional to I sin(theta) with I = (R + G + B) / 3. A CDF over rows picks y, the CDF of that row x.
    """
    raise NotImplementedError


def shade(radiance: np.ndarray, pixel: np.ndarray, probability: np.ndarray, resolution: int) -> np.ndarray:
    """Part 3: the diffuse sphere with albedo 1, lit by these samples, which all of the image's pixels share."""
    raise NotImplementedError


def render(radiance: np.ndarray, spp: int, resolution: int, random: np.random.Generator) -> np.ndarray:
    """Part 4: the same image with ``spp`` fresh samples for every pixel."""
    raise NotImplementedError


# ---- Already written ----


def write_fresnel(out: Path) -> None:
    degrees = np.arange(0, 90.5, 0.5)
    for name, eta_from, eta_to in (("entering", 1.0, 1.4), ("leaving", 1.4, 1.0)):
        p, s = fresnel(np.radians(degrees), eta_from, eta_to)
        with (out / f"fresnel_{name}.csv").open("w", newline="") as file:
            rows = csv.writer(file)
            rows.writerow(["angle_degrees", "p", "s"])
            rows.writerows(zip(degrees, p, s, strict=True))


def write_samples(out: Path, radiance: np.ndarray) -> None:
    for count in COUNTS:
        pixel, probability = sample(radiance, count, np.random.default_rng(SEED))
        height, width = radiance.shape[:2]
        theta, phi = np.pi * (pixel[:, 1] + 0.5) / height, 2 * np.pi * (pixel[:, 0] + 0.5) / width
        direction = np.stack([np.sin(theta) * np.cos(phi), np.cos(theta), np.sin(theta) * np.sin(phi)], axis=1)
        drawn = radiance[pixel[:, 1], pixel[:, 0]]
        np.savez(
            out / f"samples_{count}.npz", direction=direction, radiance=drawn, pixel=pixel, probability=probability
        )


def write_shaded(out: Path, radiance: np.ndarray) -> None:
    for count in COUNTS:
        pixel, probability = sample(radiance, count, np.random.default_rng(SEED))
        lightdome.write_image(out / f"shaded_{count}.pfm", shade(radiance, pixel, probability, RESOLUTION))


def write_rendered(out: Path, radiance: np.ndarray) -> None:
    for spp in SPP:
        image = render(radiance, spp, RESOLUTION, np.random.default_rng(SEED))
        lightdome.write_image(out / f"rendered_{spp}spp.pfm", image)


def main(path: Path, out: Path) -> None:
    out.mkdir(parents=True, exist_ok=True)
    radiance = lightdome.read_image(path).astype(np.float64)
    parts = {
        "1, Fresnel": lambda: write_fresnel(out),
        "2, samples": lambda: write_samples(out, radiance),
        "3, shared samples": lambda: write_shaded(out, radiance),
        "4, samples per pixel": lambda: write_rendered(out, radiance),
    }
    for name, write in parts.items():
        try:
            write()
            print(f"part {name}: written to {out}")
        except NotImplementedError:
            print(f"part {name}: still to do")


if __name__ == "__main__":
    clone = Path(__file__).resolve().parents[2]
    given = [Path(argument) for argument in sys.argv[1:]]
    main(given[0] if given else clone / "data" / "default.exr", given[1] if len(given) > 1 else Path("out/exercise"))
