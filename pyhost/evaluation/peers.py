"""Other programs on the same sphere, as methods of the benchmark: numpy, Mitsuba 3 and PBRT.

    found = find(["numpy", "mitsuba", "pbrt"], envmap, resolution)
    found.methods   # the available peers, by name, for lightdome.evaluation.benchmark.measure_method
    found.absent    # the absent peers, by name, and why

All use the same map, resolution and error measure, and all cores. Each peer times its stages by its own clock, so that
start-up and compilation are kept separate; ``found.about`` says what each time includes. A peer that is not installed,
or fails when it is tried, is absent: nothing is estimated.

numpy shares samples among all pixels, like lightdome's own shared methods; Mitsuba and PBRT draw samples per pixel.
numpy takes each pixel of the map as the direction of its centre. PBRT-v4 has a square whose texels, areas of constant
radiance, share out the flux of the map's pixels; PBRT-v3 and Mitsuba interpolate between pixels. So none of the three
converges exactly to either exact image. The image of areas is closer, so they are measured against that. See
:mod:`lightdome.evaluation.peer_numpy`, :mod:`lightdome.evaluation.peer_mitsuba` and
:mod:`lightdome.evaluation.peer_pbrt`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np

from ..errors import LightdomeError, shown
from ..maps.envmap import EnvironmentMap
from . import peer_mitsuba, peer_numpy
from .benchmark import Method
from .mitsuba_process import INSTALL, installed
from .peer_pbrt import PbrtPeer

NAMES = ("numpy", "mitsuba", "pbrt")

Timed = Callable[[int, int, int], tuple[np.ndarray, dict[str, float]]]  # (resolution, count, seed) -> image, stages


@dataclass
class Peers:
    """Available ``methods``; what each is ``about``, in JSON types only; why others are ``absent``, in one line."""

    methods: dict[str, Method] = field(default_factory=dict)
    about: dict[str, dict[str, object]] = field(default_factory=dict)
    absent: dict[str, str] = field(default_factory=dict)


def find(names: Sequence[str], envmap: EnvironmentMap, resolution: int = 511, pbrt: Sequence[str | Path] = ()) -> Peers:
    """Start the peers ``names``, some of :data:`NAMES`; ``pbrt`` lists programs or their folders, by default from PATH.

    Raises ``ValueError`` for an unknown name. A peer that does not start is listed in ``absent``.
    """
    unknown = set(names) - set(NAMES)
    if unknown:
        raise ValueError(f"unknown peer {sorted(unknown)[0]!r}; expected one of {', '.join(NAMES)}")
    peers = Peers()
    if "numpy" in names:
        draw_and_shade = partial(peer_numpy.draw_and_shade, envmap.radiance)
        peers.methods["numpy"] = _method("numpy", "shared", draw_and_shade, resolution, areas=False)
        peers.about["numpy"] = {"numpy": np.__version__, "time": "from the map in memory to the image in memory"}
    if "mitsuba" in names:
        _find_mitsuba(peers, envmap, resolution)
    if "pbrt" in names:
        programs: Sequence[str | Path | None] = pbrt or [None]
        for path in programs:
            _find_pbrt(peers, envmap, resolution, path)
    return peers


def _method(name: str, kind: str, run: Timed, resolution: int, random: bool = True, areas: bool = True) -> Method:
    """A method whose clock is the stages of its last run."""
    stages: dict[str, float] = {}

    def timed(count: int, seed: int) -> np.ndarray:
        stages.clear()
        image, seconds = run(resolution, count, seed)
        stages.update(seconds)
        return image

    pixels: Literal["centres", "areas"] = "areas" if areas else "centres"
    return Method(name, kind, timed, random=random, pixels=pixels, peer=True, clock=lambda: dict(stages))


def _find_mitsuba(peers: Peers, envmap: EnvironmentMap, resolution: int) -> None:
    if not installed():
        peers.absent["mitsuba"] = INSTALL
        return
    for variant in peer_mitsuba.VARIANTS:
        name = f"mitsuba {variant}"
        try:
            mitsuba = peer_mitsuba.MitsubaRenderer(variant, envmap.radiance)
        except LightdomeError as error:
            peers.absent[name] = str(error)
            continue
        peers.methods[name] = _method(name, "per pixel", mitsuba.render, resolution)
        peers.about[name] = {
            **mitsuba.about,
            "time": "scene with the map's distribution, from the map in memory, and rendering, without start-up"
            " (process, import, first image with its compilation). Code for a new count or size is compiled in"
            " the first run, unless it is in Dr.Jit's cache on disk",
        }


def _find_pbrt(peers: Peers, envmap: EnvironmentMap, resolution: int, path: str | Path | None) -> None:
    try:
        pbrt = PbrtPeer(path, envmap)
    except LightdomeError as error:
        peers.absent["pbrt" if path is None else f"pbrt {path}"] = str(error)
        return
    name = pbrt.program.name.lower().split()[0]
    if name in peers.methods:
        name = f"{name} {shown(pbrt.program.path)}"
    # Version 3 has no seed: another run would repeat the first.
    peers.methods[name] = _method(name, "per pixel", pbrt.render, resolution, random=pbrt.program.is_random)
    peers.about[name] = {
        "program": str(pbrt.program.path),
        "name": pbrt.program.name,
        "start-up seconds": pbrt.startup_seconds,
        "time": "process and reading of its image, minus start-up (the process on an empty scene): scene, in which PBRT"
        " reads the map from a file and builds its distribution, and render, in which it renders and writes the image",
    }
