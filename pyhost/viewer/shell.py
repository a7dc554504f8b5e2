"""The command lines that compute what a page shows."""

from __future__ import annotations

import math
import shlex

import numpy as np

from ..errors import exactly
from ..maps.rotation import rotation_matrix
from .messages import CUT, HARMONICS, SHARED, Setting

OTHER_SAMPLES = "These commands turn the map before they sample it, so they draw different samples of the same light."


def commands(setting: Setting, arguments: str) -> tuple[list[str], str]:
    """Commands that compute the image of a setting, and a note on how they differ from the page, or "".

    ``arguments`` is what follows ``--map``: the map's path, and options for reading it, with ``--rotate`` last.
    """
    path, *options = shlex.split(arguments)
    angles = setting.angles
    if "--rotate" in options:
        at = options.index("--rotate")
        first, options = [float(word) for word in options[at + 1 :]], options[:at]
        angles = together((first[0], *(first[1:] or (0.0, 0.0))), angles)
    turned = ["--rotate", *map(exactly, angles)] if any(angles) else []
    of_map: list[object] = ["--map", path, *options, *turned]
    sphere: list[object] = ["--resolution", setting.resolution, "--albedo", exactly(setting.albedo)]
    note = OTHER_SAMPLES if any(setting.angles) else ""
    if setting.method == SHARED:
        sample = ["sample", *of_map, "--counts", setting.count, "--sequence", setting.sequence, "--seed", setting.seed]
        return [_line(*sample), _line("shade", f"out/part2/samples_{setting.count}.npz", *sphere)], note
    if setting.method == CUT:
        note = "This writes the lights; in Python, lightdome.shade computes their image." + (f" {note}" if note else "")
        return [_line("lights", path, *options, *turned, "--count", setting.count, "--out", "lights.csv")], note
    if setting.method == HARMONICS:
        program = (
            "import lightdome as l; d = l.open_device();"
            f" h = l.project(d, l.EnvironmentMap.read({path!r}), {setting.count}).rotated{angles};"
            f" l.write_image('harmonics.pfm', l.shade_harmonics(d, h, {setting.resolution}, {setting.albedo}))"
        )
        return [shlex.join(["python", "-c", program])], f"Read the map with {shlex.join(options)}." if options else ""
    render = ["render", *of_map, "--renderer", "opencl", "--estimator", setting.method]
    render += ["--sequence", setting.sequence, "--spp", setting.count, "--seed", setting.seed]
    return [_line(*render, *sphere)], ""


def together(first: tuple[float, float, float], then: tuple[float, float, float]) -> tuple[float, float, float]:
    """Yaw, pitch and roll, in degrees, of two turns, one after the other."""
    matrix = rotation_matrix(*then) @ rotation_matrix(*first)
    sine = float(np.clip(-matrix[1, 2], -1, 1))
    if abs(sine) > 1 - 1e-7:  # yaw and roll turn about the same axis
        angles = math.atan2(-matrix[2, 0], matrix[0, 0]), math.copysign(math.pi / 2, sine), 0.0
    else:
        roll = math.atan2(matrix[1, 0], matrix[1, 1])
        angles = math.atan2(matrix[0, 2], matrix[2, 2]), math.asin(sine), roll
    yaw, pitch, roll = (round(math.degrees(angle), 6) + 0.0 for angle in angles)
    return yaw, pitch, roll


def _line(*words: object) -> str:
    return shlex.join(["lightdome", *map(str, words)])
