#!/usr/bin/env python3
"""Part 2: draw light directions from an environment map and show where they fall."""

import os
import sys

sys.path.insert(0, os.path.dirname(os.path.realpath(__file__)))  # noqa: PTH120 - missing under PYTHONSAFEPATH
import _start

if __name__ == "__main__":
    _start.command("part2_sample")
