"""The command lines that make what a page shows."""

from __future__ import annotations

import shlex

from ..errors import exactly
from .messages import CUT, HARMONICS, SHARED, Setting

OTHER_SAMPLES = "The map is turned before it is sampled there, so the samples are others of the same light."


def commands(setting: Setting, path: str) -> tuple[list[str], str]:
    """Commands that make the image of a setting, and a remark on where they differ from the page, or ""."""
    turned: list[object] = ["--rotate", *map(exactly, setting.angles)] if any(setting.angles) else []
    of_map: list[object] = ["--map", path, *turned]
    sphere: list[object] = ["--resolution", setting.resolution, "--albedo", exactly(setting.albedo)]
    note = OTHER_SAMPLES if turned else ""
    if setting.method == SHARED:
        sample = ["sample", *of_map, "--counts", setting.count, "--sequence", setting.sequence, "--seed", setting.seed]
        return [_line(*sample), _line("shade", f"out/part2/samples_{setting.count}.npz", *sphere)], note
    if setting.method == CUT:
        note = "The lights; lightdome.shade makes the image of them in Python." + (f" {note}" if note else "")
        return [_line("lights", path, *turned, "--count", setting.count, "--out", "lights.csv")], note
    if setting.method == HARMONICS:
        program = (
            "import lightdome as l; d = l.open_device();"
            f" h = l.project(d, l.EnvironmentMap.read({path!r}), {setting.count}).rotated{setting.angles};"
            f" l.write_image('harmonics.pfm', l.shade_harmonics(d, h, {setting.resolution}, {setting.albedo}))"
        )
        return [shlex.join(["python", "-c", program])], ""
    render = ["render", *of_map, "--renderer", "opencl", "--estimator", setting.method]
    render += ["--sequence", setting.sequence, "--spp", setting.count, "--seed", setting.seed]
    return [_line(*render, *sphere)], ""


def _line(*words: object) -> str:
    return shlex.join(["lightdome", *map(str, words)])
