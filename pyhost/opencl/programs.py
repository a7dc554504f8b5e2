"""Build OpenCL programs once per device and options, and fetch each kernel once."""

from __future__ import annotations

import os
import re
import warnings
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

import pyopencl as cl

from ..errors import LightdomeError, one_line
from .signature import Argument, Signature, signature

if TYPE_CHECKING:
    from importlib.abc import Traversable  # in importlib.resources.abc from Python 3.11

_INCLUDE = re.compile(r'^#include ("[^"]+"|<pyopencl-random123/[^>]+>)\n', re.MULTILINE)
_SAVED = re.compile(r"\(source saved as (.+)\)")


def source(name: str) -> str:
    """The text of ``clkernels/name`` with its headers inlined, each once: ours, and Random123 from pyopencl.

    An include path would not work: PoCL's compiler cannot handle a folder with spaces in its name, and the binary cache
    would not notice that a header has changed.
    """
    seen: set[Traversable] = set()

    def read(folder: Traversable, file: str) -> str:
        path = folder.joinpath(*file.split("/"))
        if path in seen:
            return ""
        seen.add(path)

        def header(match: re.Match[str]) -> str:
            included = match[1][1:-1]
            if match[1][0] == '"':
                return read(folder, included)
            of_pyopencl, _, header_file = included.partition("/")
            return read(resources.files("pyopencl") / "cl" / of_pyopencl, header_file)

        return _INCLUDE.sub(header, path.read_text(encoding="utf-8"))

    return read(resources.files("lightdome.clkernels"), name)


def check_process(opened_by: int) -> None:
    """Raise :class:`LightdomeError` in any process but ``opened_by``: a forked child has none of OpenCL's threads."""
    if os.getpid() != opened_by:
        raise LightdomeError(
            "this process was forked from one that had opened an OpenCL device, and no device works in a fork; start"
            " processes with multiprocessing.get_context('spawn'), and open the device in each of them"
        )


def compiler_says(error: cl.Error) -> str:
    """The relevant line in the message of a failed build. Deletes the source that pyopencl leaves on disk."""
    said = str(error)
    if saved := _SAVED.search(said):
        Path(saved[1]).unlink(missing_ok=True)
    return one_line(next((line for line in said.splitlines() if "error" in line), said))


class Kernel:
    """A kernel that is called with named arguments, and only in the process that opened its device."""

    def __init__(self, kernel: cl.Kernel, signature: Signature) -> None:
        # With argument types declared, pyopencl takes half the time for a call.
        kernel.set_scalar_arg_dtypes([None if p.is_pointer or p.lanes > 1 else p.dtype for p in signature.parameters])
        self._kernel = kernel
        self._signature = signature
        self._process = os.getpid()

    def __call__(
        self,
        queue: cl.CommandQueue,
        size: tuple[int, ...],
        local: tuple[int, ...] | None,
        /,
        *,
        global_offset: tuple[int, ...] | None = None,
        **arguments: Argument,
    ) -> cl.Event:
        """Enqueue it with these global and local sizes; keep ``arguments`` alive until the event is complete.

        Raises ``TypeError`` for arguments that do not match its signature.
        """
        check_process(self._process)
        return self._kernel(queue, size, local, *self._signature.bind(arguments), global_offset=global_offset)


class Programs:
    """The kernels of one context, built on first use, all with ``-D`` for each of ``defines``."""

    def __init__(self, context: cl.Context, **defines: int) -> None:
        self._context = context
        self._defines = defines
        self._kernels: dict[tuple[str, tuple[tuple[str, int], ...]], Kernel] = {}
        self._signatures: dict[str, Signature] = {}
        self._process = os.getpid()

    @property
    def built(self) -> list[str]:
        """The kernels built so far, in order, each with the names of its defines."""
        names = ((name.rpartition("/")[2], defines) for name, defines in self._kernels)
        return [f"{name} ({', '.join(dict(defines))})" if defines else name for name, defines in names]

    @property
    def available(self) -> int:
        """The number of kernels in ``clkernels/``."""
        return sum(
            file.name.endswith(".cl")
            for folder in resources.files("lightdome.clkernels").iterdir()
            if folder.is_dir()
            for file in folder.iterdir()
        )

    def text(self, name: str) -> str:
        """The source of the kernel ``name``: ``clkernels/name.cl`` with all its headers."""
        return source(f"{name}.cl")

    def parameters(self, name: str) -> frozenset[str]:
        """The names of the arguments of the kernel ``name``."""
        return frozenset(parameter.name for parameter in self._signature(name).parameters)

    def _signature(self, name: str) -> Signature:
        if name not in self._signatures:
            self._signatures[name] = signature(name, self.text(name))
        return self._signatures[name]

    def check_process(self) -> None:
        """Raise :class:`LightdomeError` in a process that was forked from the one that opened the device."""
        check_process(self._process)

    def kernel(self, name: str, **defines: int) -> Kernel:
        """The kernel of ``clkernels/name.cl``, such as ``sampling/row_cdf``, with ``-D`` for each of ``defines``.

        Raises :class:`LightdomeError` if the device's compiler refuses it, or in a forked process.
        """
        self.check_process()
        key = (name, tuple(sorted(defines.items())))
        if key not in self._kernels:
            of_all = {**self._defines, **defines}
            options = ["-cl-std=CL1.2", *(f"-D{define}={value}" for define, value in sorted(of_all.items()))]
            program = cl.Program(self._context, self.text(name))
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", cl.CompilerWarning)  # remarks on a build that succeeded
                try:
                    program.build(options)
                except cl.RuntimeError as error:
                    raise LightdomeError(
                        f"the OpenCL compiler refuses clkernels/{name}.cl ({compiler_says(error)});"
                        " choose another device with --device"
                    ) from error
            self._kernels[key] = Kernel(getattr(program, name.rpartition("/")[2]), self._signature(name))
        return self._kernels[key]
