#!/usr/bin/env python3
"""Stability: how samplers cope with maps that break samplers, measured against float64."""

import os
import sys

sys.path.insert(0, os.path.dirname(os.path.realpath(__file__)))  # noqa: PTH120 - missing under PYTHONSAFEPATH
import _start

if __name__ == "__main__":
    _start.command("stability")
