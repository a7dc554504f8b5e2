"""The names that command lines choose from, here so that listing them loads nothing else."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

# The default seed of samples. One set of samples is chance; with this seed the errors of 64, 256 and 1024 samples, of
# Grace and of the default map, are near their means over seeds.
SEED = 159
SEQUENCES = ("independent", "stratified", "sobol", "r2", "lattice")  # for samples that all pixels share
WITHIN = ("centre", "pixel")  # where in its pixel a sample's direction lies: at the centre, or anywhere
PIXELS = ("centres", "areas")  # how exact images treat the map's pixels: as their centres, or as areas
PIXEL_SEQUENCES = ("independent", "sobol", "lattice")  # for fresh samples in every pixel
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
)  # of maps: lightdome.maps.projections
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
    "devices": Command("devices", "list OpenCL devices with their speed, and which one is used"),
    "info": Command("info", "say what is in a map: clipping, sun, range, where its light comes from"),
    "view": Command("view", "show a map, its samples, the sphere and the error in the browser"),
    "sample": Command("part2_sample", "draw light samples from a map, and show where they fall"),
    "shade": Command("part3_shade", "shade a sphere with one set of samples for all pixels"),
    "render": Command("part4_pbrt", "render the sphere with fresh samples for every pixel"),
    "catalog": Command("catalog", "make a table of many maps, on one machine or on a Dask cluster"),
    "convert": Command("convert", "write a map in another projection"),
    "exact": Command("exact", "compute the sphere's exact image, from every pixel of a map: the estimators' limit"),
    "lights": Command("lights", "turn a map into a few lights, as a file for another program"),
    "fresnel": Command("part1_fresnel", "plot the Fresnel reflectance of a dielectric"),
    "check": Command("check", "check another program's results, and say what is wrong with them"),
    "bench": Command("bench", "measure the error of each method against its run time"),
    "roofline": Command("roofline", "measure each stage against what the machine can do"),
    "stability": Command("stability", "try samplers on maps that break samplers"),
    "report": Command("report", "write a report as PDF, with all images"),
}


@dataclass(frozen=True)
class Estimator:
    """An estimator with fresh samples for every pixel; its kernel is ``rendering/render_NAME.cl``.

    - ``pixels``: how it treats the map's pixels, and so which exact image it converges to. With ``centres`` there is
      also a kernel ``rendering/render_NAME_areas.cl``, for directions anywhere within a pixel
    - ``operations``: per direction from a Sobol point that the light samples, and per one that the cosine samples, as
      :mod:`lightdome.evaluation.roofline_stages` counts them
    """

    pixels: Literal["centres", "areas"]
    operations: tuple[int, int]


# Operations common to all: a Sobol point (two coordinates, each scrambled and bit-reversed), the cosine (3), its
# divisor (4) and the sum (3). Comments name what each estimator adds.
_SAMPLE = 2 * (8 + 23) + 10
_LIGHT = _SAMPLE + 2  # sin(theta) cos(phi) and sin(theta) sin(phi)
_BSDF = _SAMPLE + 2 + 12 + 12 + 24  # square roots, sine and cosine, a frame around n, two arctangents

ESTIMATORS = {
    "light": Estimator("centres", (_LIGHT, 0)),
    "bsdf": Estimator("areas", (0, _BSDF)),
    # A place in the pixel, its sine and cosine; the weight.
    "mis": Estimator("areas", (_LIGHT + 12 + 7, _BSDF + 7)),
    # The cosine of the axes (5) and its guess (5); the control variate: a cosine (5), a line (9), three colours (6).
    "product": Estimator("centres", (_LIGHT + 30, 0)),
}


def per_pixel(estimator: str, sequence: str) -> str:
    """The benchmark's name for an estimator used with a sequence."""
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
