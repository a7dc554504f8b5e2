#!/usr/bin/env python3
"""Part 3: shade a diffuse sphere with the samples of part 2."""

import os
import sys

sys.path.insert(0, os.path.dirname(os.path.realpath(__file__)))  # noqa: PTH120 - missing under PYTHONSAFEPATH
import _start

if __name__ == "__main__":
    _start.command("part3_shade")
