#!/usr/bin/env python3
"""Part 4: the same sphere by Monte Carlo, with fresh samples for every pixel, by PBRT or on an OpenCL device."""

import os
import sys

sys.path.insert(0, os.path.dirname(os.path.realpath(__file__)))  # noqa: PTH120 - missing under PYTHONSAFEPATH
import _start

if __name__ == "__main__":
    _start.command("part4_pbrt")
