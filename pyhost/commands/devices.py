"""The OpenCL devices of this machine, and which one is used."""

from __future__ import annotations

from . import cli


def main() -> None:
    cli.parser("List all OpenCL devices, what they do, and the one that is used.", "").parse_args()

    from ..opencl.device import survey

    print(survey())
