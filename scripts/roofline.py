#!/usr/bin/env python3
"""Roofline: the machine's limits, and how close each stage comes to them, at all sizes."""

import os
import sys

sys.path.insert(0, os.path.dirname(os.path.realpath(__file__)))  # noqa: PTH120 - missing under PYTHONSAFEPATH
import _start

if __name__ == "__main__":
    _start.command("roofline")
