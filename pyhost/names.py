"""The names that command lines choose from, known without loading what they name."""

from __future__ import annotations

COMMANDS = (
    "part1_fresnel",
    "part2_sample",
    "part3_shade",
    "part4_pbrt",
    "bench",
    "roofline",
    "stability",
    "report",
)
SEQUENCES = ("independent", "stratified", "sobol", "r2")  # points of samples that all pixels share
ESTIMATORS = ("light", "bsdf", "mis", "product")
PIXEL_SEQUENCES = ("independent", "sobol")  # points of samples for every pixel


def per_pixel(estimator: str, sequence: str) -> str:
    """The benchmark's name for an estimator with a sequence."""
    return estimator if sequence == "independent" else f"{estimator}-{sequence}"


# The benchmark's, in its order.
METHODS = (
    *SEQUENCES,
    "median-cut",
    *(per_pixel(estimator, sequence) for estimator in ESTIMATORS for sequence in PIXEL_SEQUENCES),
    "mis-compensated-sobol",
    "harmonics",
    "exact",
    "exact-areas",
)
