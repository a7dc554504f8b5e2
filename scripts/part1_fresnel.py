#!/usr/bin/env python3
"""Part 1: Fresnel reflectance of a dielectric in air, and how close Schlick's approximation comes."""

import os
import sys

sys.path.insert(0, os.path.dirname(os.path.realpath(__file__)))  # noqa: PTH120 - missing under PYTHONSAFEPATH
import _start

if __name__ == "__main__":
    _start.command("part1_fresnel")
