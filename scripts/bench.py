#!/usr/bin/env python3
"""Benchmark: how much error does a millisecond buy, and with which method?"""

import os
import sys

sys.path.insert(0, os.path.dirname(os.path.realpath(__file__)))  # noqa: PTH120 - missing under PYTHONSAFEPATH
import _start

if __name__ == "__main__":
    _start.command("bench")
