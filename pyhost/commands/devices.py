"""The OpenCL devices of this machine, and which one is used."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from typing import TYPE_CHECKING

from . import cli

if TYPE_CHECKING:
    from ..opencl.device import Surveyed


def main() -> None:
    parser = cli.parser("List all OpenCL devices with their speed, and which one is used.", "--json")
    parser.add_argument("--json", action="store_true", help="print a JSON object instead of text")
    args = parser.parse_args()

    from ..opencl.device import survey

    devices = survey()
    if args.json:
        content = {"why": why(devices), "devices": [device.to_dict() for device in devices]}
        print(json.dumps(content, indent=2, allow_nan=False))
    else:
        print("\n".join(lines(devices)))


def why(devices: list[Surveyed]) -> str:
    """Why the device in use was chosen."""
    if asked := os.environ.get("PYOPENCL_CTX"):
        return f"PYOPENCL_CTX={asked} names it"
    working = sum(device.rates is not None for device in devices)
    return "the only one" if working == 1 else f"the fastest of {working}"


def lines(devices: list[Surveyed]) -> Iterator[str]:
    """First the device in use, alone on its line; then why; then a table of all devices' rates."""
    (taken,) = (device for device in devices if device.is_taken)
    yield taken.description
    yield f"used (*): {why(devices)}"
    yield ""
    yield f"  {'device':<8}{'multiply-adds':>14}{'copies':>12}{'frame':>10}"
    for device in devices:
        rates = device.rates
        does = f"  fails: {device.failure}"
        if rates:
            does = (
                f"{1e-9 * rates.multiply_adds:>10.0f} G/s{1e-9 * rates.copies:>7.0f} GB/s"
                f"{1e3 * rates.frame_seconds:>7.1f} ms"
            )
        name = f"{'*' if device.is_taken else ' '} {device.choice}"
        yield f"{name:<10}{does}  {device.description}"
    if taken.rates:
        yield f"  {'numpy':<8}{1e-9 * taken.rates.numpy:>10.0f} G/s"
    if taken.note:
        yield taken.note
