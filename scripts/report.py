#!/usr/bin/env python3
"""The written report as PDF, and a zip of it and all images, from existing results or from fresh runs."""

import os
import sys

sys.path.insert(0, os.path.dirname(os.path.realpath(__file__)))  # noqa: PTH120 - missing under PYTHONSAFEPATH
import _start

if __name__ == "__main__":
    _start.command("report")
