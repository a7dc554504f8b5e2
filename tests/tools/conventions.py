"""Show a labelled map to real programs: does each see the labels where lightdome's conventions say?

    python tests/tools/conventions.py

Prints, for every available program, how far off each of six coloured patches is seen, in degrees. The programs are
Mitsuba, skylibs and Blender, as Python packages, and PBRT. If this Python lacks a package, it is looked for in the
Pythons listed in the environment variable LIGHTDOME_PEERS, separated as on PATH. LIGHTDOME_PBRT names a PBRT.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from convention_views import ANGLE, SIZE
from lightdome.errors import LightdomeError
from lightdome.maps.conventions import to_axes
from lightdome.maps.envmap import EnvironmentMap
from lightdome.maps.images import read_image, write_image
from lightdome.pbrt.equal_area import to_equal_area
from lightdome.pbrt.run import Pbrt, find_pbrt
from lightdome.reference import directions

PACKAGES = {"mitsuba": "mitsuba", "skylibs": "envmap", "cycles": "bpy"}
AXES = {"+x": (1, 0, 0), "-x": (-1, 0, 0), "+y": (0, 1, 0), "-y": (0, -1, 0), "+z": (0, 0, 1), "-z": (0, 0, -1)}
COLOURS = np.array([[1, 0, 0], [0, 1, 1], [0, 1, 0], [1, 0, 1], [0, 0, 1], [1, 1, 0]])
RADIUS = 12.0  # degrees
LIMIT = 600.0  # seconds allowed for a program
# Level views see two patches each, one to the left and one to the right: a mirrored map would exchange them.
VIEWS = np.array(
    [
        *([[np.cos(phi), 0, np.sin(phi)], [0, 1, 0]] for phi in np.radians([45, 135, 225, 315])),
        [[0, 1, 0], [0, 0, 1]],
        [[0, -1, 0], [1, 0, 0]],
    ]
)
PBRT_SCENE = {
    3: """\
Film "image" "string filename" ["{image}"] "integer xresolution" [{size}] "integer yresolution" [{size}]
LookAt 0 0 0  {forward}  {up}
Camera "perspective" "float fov" [{angle}]
Sampler "halton" "integer pixelsamples" [16]
WorldBegin
LightSource "infinite" "string mapname" ["map.exr"]
Translate 0 0 1000
Shape "sphere" "float radius" [0.01]
WorldEnd
""",
    4: """\
Film "rgb" "string filename" ["{image}"] "integer xresolution" [{size}] "integer yresolution" [{size}]
LookAt 0 0 0  {forward}  {up}
Camera "perspective" "float fov" [{angle}]
Sampler "halton" "integer pixelsamples" [16]
WorldBegin
LightSource "infinite" "string filename" ["map.exr"]
Translate 0 0 1000
Shape "sphere" "float radius" [0.01]
""",
}


def labelled_map(height: int = 64) -> EnvironmentMap:
    """A black map with a patch of one of COLOURS around each of AXES."""
    radiance = np.zeros((height, 2 * height, 3), np.float32)
    for axis, colour in zip(AXES.values(), COLOURS, strict=True):
        radiance[directions(height, 2 * height) @ axis > np.cos(np.radians(RADIUS))] = colour
    return EnvironmentMap(radiance)


@cache
def python_with(package: str) -> str | None:
    """This Python, or the first of LIGHTDOME_PEERS that has ``package``; None if none has."""
    if find_spec(package):
        return sys.executable
    program = f"import sys, importlib.util; sys.exit(importlib.util.find_spec({package!r}) is None)"
    others = filter(None, os.environ.get("LIGHTDOME_PEERS", "").split(os.pathsep))
    return next((python for python in others if subprocess.run([python, "-c", program]).returncode == 0), None)


def seen_by_package(name: str, radiance: np.ndarray, views: np.ndarray) -> np.ndarray:
    """Images (N, S, S, 3) of ``views``, in the program's own axes; ``radiance`` is the map as the program reads it."""
    with tempfile.TemporaryDirectory() as folder:
        path, program = Path(folder) / "map.exr", Path(__file__).with_name("convention_views.py")
        write_image(path, radiance)
        np.save(path.with_suffix(".npy"), radiance)
        np.save(path.with_name("views.npy"), views)
        arguments = [name, path, path.with_name("views.npy"), path.with_name("images.npy")]
        result = subprocess.run(
            [str(python_with(PACKAGES[name])), program, *arguments], capture_output=True, text=True, timeout=LIMIT
        )
        if result.returncode:
            raise RuntimeError(result.stderr)
        return np.load(arguments[-1])


def seen_by_pbrt(pbrt: Pbrt, radiance: np.ndarray, views: np.ndarray) -> np.ndarray:
    """As :func:`seen_by_package`, by PBRT; version 4 is given the map as an equal-area square."""
    images = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_image(folder / "map.exr", to_equal_area(radiance) if pbrt.version == 4 else radiance)
        for view in views:
            forward, up = (" ".join(f"{value:.9g}" for value in vector) for vector in view)
            image = folder / f"image{pbrt.image_suffix}"
            scene = PBRT_SCENE[pbrt.version]
            scene = scene.format(image=image.name, size=SIZE, angle=ANGLE, forward=forward, up=up)
            (folder / "scene.pbrt").write_text(scene)
            command = [str(pbrt.path), "--outfile", str(image), "scene.pbrt"]
            subprocess.run(command, cwd=folder, capture_output=True, check=True, timeout=LIMIT)
            images.append(read_image(image))
    return np.array(images)


def patches(images: np.ndarray) -> np.ndarray:
    """Unit vectors (6, 3) to the centres of the patches in the images of VIEWS, in lightdome's axes; NaN if unseen."""
    step = np.tan(np.radians(ANGLE / 2)) * (2 * (np.arange(SIZE) + 0.5) / SIZE - 1)
    sums = np.zeros((len(COLOURS), 3))
    hue = COLOURS / COLOURS.sum(axis=1, keepdims=True)
    for (forward, up), image in zip(VIEWS, images, strict=True):
        towards = forward + step[None, :, None] * np.cross(forward, up) - step[:, None, None] * up
        length = np.linalg.norm(towards, axis=2)
        light = image.sum(axis=2)
        share = image / np.maximum(light, 1e-6)[..., None]
        patch = np.linalg.norm(share[..., None, :] - hue, axis=-1).argmin(axis=-1)
        for n in range(len(COLOURS)):
            # Weight each pixel by its solid angle.
            weight = np.where((patch == n) & (light > 0.05), light, 0) / length**3
            sums[n] += np.einsum("yx,yxc->c", weight / length, towards)
    with np.errstate(invalid="ignore"):
        return sums / np.linalg.norm(sums, axis=1, keepdims=True)


def differences(images: np.ndarray) -> np.ndarray:
    """How far from its axis each patch is seen, (6,) degrees; NaN if it is not seen."""
    cosine = np.einsum("nc,nc->n", patches(images), np.array(list(AXES.values())))
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))


def of_package(name: str) -> np.ndarray:
    """:func:`differences` for Mitsuba, skylibs or Blender."""
    return differences(seen_by_package(name, labelled_map().to_convention(name).radiance, to_axes(VIEWS, name)))


def of_pbrt(pbrt: Pbrt) -> np.ndarray:
    """:func:`differences` for PBRT."""
    return differences(seen_by_pbrt(pbrt, labelled_map().to_convention("pbrt").radiance, to_axes(VIEWS, "pbrt")))


def main() -> None:
    print(f"{'degrees':<12}" + "".join(f"{axis:>8}" for axis in AXES))
    found = {name: of_package(name) for name, package in PACKAGES.items() if python_with(package)}
    try:
        program = find_pbrt(os.environ.get("LIGHTDOME_PBRT"))
        found[program.name] = of_pbrt(program)
    except LightdomeError as error:
        print(error, file=sys.stderr)
    for name, angles in found.items():
        print(f"{name:<12}" + "".join(f"{angle:>8.2f}" for angle in angles))


if __name__ == "__main__":
    main()
