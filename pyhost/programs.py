"""Build OpenCL programs once per device and options, and fetch each kernel once."""

from __future__ import annotations

import re
import warnings
from importlib import resources

import pyopencl as cl

from .errors import LightdomeError

_INCLUDE = re.compile(r'^#include "([^"]+)"\n', re.MULTILINE)


def source(name: str) -> str:
    """The text of ``clkernels/name`` with our own headers written in, each once.

    Headers are inlined rather than found by an include path: that works from any folder, also one
    whose name has spaces, and keeps the text the only key of the binary cache.
    """
    seen: set[str] = set()

    def read(file: str) -> str:
        if file in seen:
            return ""
        seen.add(file)
        text = (resources.files("lightdome.clkernels") / file).read_text(encoding="utf-8")
        return _INCLUDE.sub(lambda match: read(match[1]), text)

    return read(name)


class Programs:
    """The kernels of one context, built when they are first asked for."""

    def __init__(self, context: cl.Context) -> None:
        self._context = context
        self._kernels: dict[tuple[str, tuple[tuple[str, int], ...]], cl.Kernel] = {}

    def kernel(self, name: str, **defines: int) -> cl.Kernel:
        """The kernel ``name`` of ``clkernels/name.cl``, compiled with ``-D`` for each of ``defines``.

        Raises :class:`LightdomeError` if the device's compiler refuses it.
        """
        key = (name, tuple(sorted(defines.items())))
        if key not in self._kernels:
            options = ["-cl-std=CL1.2", *(f"-D{define}={value}" for define, value in key[1])]
            program = cl.Program(self._context, source(f"{name}.cl"))
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", cl.CompilerWarning)  # chatter of a build that went well
                try:
                    program.build(options)
                except cl.RuntimeError as error:
                    first = next((line for line in str(error).splitlines() if "error" in line), str(error))
                    raise LightdomeError(
                        f"the OpenCL compiler refuses clkernels/{name}.cl ({first.strip()[:200]});"
                        " choose another device with --device"
                    ) from error
            self._kernels[key] = getattr(program, name)
        return self._kernels[key]
