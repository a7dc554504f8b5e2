"""The names that command lines choose from, known without loading what they name."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

SEQUENCES = ("independent", "stratified", "sobol", "r2", "lattice")  # points of samples that all pixels share
WITHIN = ("centre", "pixel")  # where in its pixel the direction of a sample lies
PIXELS = ("centres", "areas")  # what exact images take the map's pixels for
PIXEL_SEQUENCES = ("independent", "sobol", "lattice")  # points of samples for every pixel
PROJECTIONS = (
    "latlong",
    "angular",
    "mirror",
    "cube-cross",
    "cube-cross-horizontal",
    "cube-strip",
    "cube-strip-horizontal",
    "cube-openexr",
    "octahedral",
)  # of maps, see lightdome.maps.projections
CONVENTIONS = ("lightdome", "pbrt", "mitsuba", "cycles", "gltf", "skylibs")  # of maps: lightdome.maps.conventions

LIGHT_METHODS = ("median-cut", "sun+median-cut", *SEQUENCES)  # how a map becomes a few lights
# Files of lights for other programs, and their suffixes.
LIGHT_FORMATS = {
    "csv": ".csv",
    "json": ".json",
    "pbrt": ".pbrt",
    "mitsuba": ".xml",
    "gltf": ".gltf",
    "usda": ".usda",
    "blender": ".py",
}


@dataclass(frozen=True)
class Command:
    """A command of the console program ``lightdome``."""

    module: str  # in lightdome.commands; a script of this name runs it too, if there is one
    purpose: str


COMMANDS = {
    "devices": Command("devices", "list OpenCL devices, their speed, and the one that is used"),
    "info": Command("info", "say what is in a map: clipping, sun, range, where its light comes from"),
    "sample": Command("part2_sample", "draw light samples from a map, and show where they fall"),
    "shade": Command("part3_shade", "shade a sphere with samples that all pixels share"),
    "render": Command("part4_pbrt", "render the sphere with fresh samples for every pixel"),
    "catalog": Command("catalog", "make a table of many maps, on one machine or on a Dask cluster"),
    "convert": Command("convert", "write a map in another projection"),
    "exact": Command("exact", "sum the sphere's image over every pixel of a map: what estimators converge to"),
    "lights": Command("lights", "turn a map into a few lights, as a file for another program"),
    "fresnel": Command("part1_fresnel", "plot the Fresnel reflectance of a dielectric"),
    "check": Command("check", "say whether another program's results are right, and if not, what is wrong"),
    "bench": Command("bench", "measure the error of each method against its run time"),
    "roofline": Command("roofline", "measure each stage against what the machine can do"),
    "stability": Command("stability", "try samplers on maps that break samplers"),
    "report": Command("report", "write a report as PDF, with all images"),
}


@dataclass(frozen=True)
class Estimator:
    """An estimator with fresh samples for every pixel; its kernel is ``rendering/render_NAME.cl``.

    - ``pixels``: what it takes the map's pixels for, and so which exact image it converges to. With ``centres`` there
      is also a kernel ``rendering/render_NAME_areas.cl``, for directions anywhere within a pixel
    - ``operations``: of one sample with a Sobol point, as :mod:`lightdome.evaluation.roofline_stages` counts them
    """

    pixels: Literal["centres", "areas"]
    operations: int


# Operations that all have in common: a Sobol point (two coordinates, each scrambled and its bits reversed), the cosine
# (3), its divisor (4) and the sum (3). The others are named behind each.
_SAMPLE = 2 * (8 + 23) + 10
_LIGHT = _SAMPLE + 2  # sin theta cos phi and sin theta sin phi
_BSDF = _SAMPLE + 2 + 12 + 12 + 24  # roots, sine and cosine, a frame about n, two arc tangents

ESTIMATORS = {
    "light": Estimator("centres", _LIGHT),
    "bsdf": Estimator("areas", _BSDF),
    "mis": Estimator("areas", _LIGHT + 12 + 8 + _BSDF + 4),  # a place in a pixel, its sine and cosine; both weights
    "product": Estimator("centres", _LIGHT),
}


def per_pixel(estimator: str, sequence: str) -> str:
    """The benchmark's name for an estimator with a sequence."""
    return estimator if sequence == "independent" else f"{estimator}-{sequence}"


# The benchmark's methods, in its order.
METHODS = (
    *SEQUENCES,
    "median-cut",
    *(per_pixel(estimator, sequence) for estimator in ESTIMATORS for sequence in PIXEL_SEQUENCES),
    "mis-compensated-sobol",
    "harmonics",
    "exact",
    "exact-areas",
)
