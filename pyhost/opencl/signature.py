"""A kernel's signature, read from its source, and arguments cast to its types.

Arguments are named. A missing, superfluous or mistyped one is a bug in the caller, and raises a ``TypeError`` that
names the kernel and the argument. OpenCL itself accepts any buffer for any pointer argument.
"""

from __future__ import annotations

import operator
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import SupportsFloat, SupportsIndex

import numpy as np
import pyopencl as cl

from .memory import DeviceArray

Argument = DeviceArray | SupportsFloat | SupportsIndex | Sequence[float] | np.ndarray | None
# None is a null pointer, for an array that the kernel does not read with these defines.

_SIZES = {"char": 1, "short": 2, "int": 4, "long": 8}  # bytes
_INTEGERS = {
    f"{sign}{name}": np.dtype(f"{sign}int{8 * size}").type for name, size in _SIZES.items() for sign in ("", "u")
}
_TYPES: dict[str, type[np.generic]] = {"float": np.float32, "double": np.float64, **_INTEGERS}
_LIMITS = {np.dtype(kind): (int(np.iinfo(kind).min), int(np.iinfo(kind).max)) for kind in _INTEGERS.values()}
_TYPE = re.compile(r"([a-z]+?)(2|3|4|8|16)?")
_QUALIFIERS = {"const", "restrict", "volatile", "global", "constant", "__global", "__constant"}
_READ_ONLY = {"const", "constant", "__constant"}  # before the star of a pointer


@dataclass(frozen=True)
class Parameter:
    """One parameter of a kernel.

    - ``dtype``: the type of its elements, or None for a type that the kernel defines
    - ``is_writable``: whether it is a pointer through which the kernel may write
    """

    name: str
    type: str
    is_pointer: bool
    dtype: np.dtype | None
    lanes: int
    is_writable: bool = False

    def cast(self, value: Argument) -> cl.Buffer | np.generic | np.ndarray | None:
        """``value`` in the form that pyopencl takes. Raises ``TypeError`` if it does not fit this parameter."""
        if self.is_pointer:
            if value is None and not self.is_writable:
                return None
            if not isinstance(value, DeviceArray):
                raise TypeError(f"must be an array on the device, got {type(value).__name__}")
            if self.dtype is not None and self.dtype != value.dtype:
                raise TypeError(f"must hold {self.dtype}, got {value.dtype}")
            if self.is_writable and value.is_read_only:
                raise TypeError("must be an array that the kernel may write to, got an uploaded one")
            return value.buffer
        return self._vector(value) if self.lanes > 1 else self._scalar(value)

    def _scalar(self, value: Argument) -> np.generic:
        assert self.dtype is not None
        if self.dtype.kind == "f":
            return self.dtype.type(float(value))  # type: ignore[arg-type]
        number = operator.index(value)  # type: ignore[arg-type]
        least, most = _LIMITS[self.dtype]
        if not least <= number <= most:
            raise TypeError(f"must be {self.type}, got {number}")
        return self.dtype.type(number)

    def _vector(self, value: Argument) -> np.ndarray:
        numbers = list(value)  # type: ignore[arg-type]
        if len(numbers) != self.lanes:
            raise TypeError(f"must be {self.type}, got {len(numbers)} numbers")
        return np.array([self._scalar(number) for number in numbers], self.dtype)


@dataclass(frozen=True)
class Signature:
    """A kernel's name and parameters, in order."""

    kernel: str
    parameters: tuple[Parameter, ...]

    def bind(self, arguments: Mapping[str, Argument]) -> list[cl.Buffer | np.generic | np.ndarray | None]:
        """``arguments`` in order, each as its parameter's type. Raises ``TypeError`` where they do not fit."""
        bound = []
        for parameter in self.parameters:
            try:
                bound.append(parameter.cast(arguments[parameter.name]))
            except KeyError:
                raise TypeError(f"the kernel {self.kernel} lacks the argument {parameter.name!r}") from None
            except (TypeError, ValueError) as error:
                raise TypeError(f"the kernel {self.kernel}: the argument {parameter.name!r} {error}") from error
        if len(arguments) > len(bound):
            known = {parameter.name for parameter in self.parameters}
            unknown = next(name for name in arguments if name not in known)
            raise TypeError(f"the kernel {self.kernel} takes no argument {unknown!r}")
        return bound


def signature(name: str, text: str) -> Signature:
    """The signature of the kernel ``name``, such as ``sampling/row_cdf``, in its source ``text``.

    Raises ``ValueError`` if the text has no such kernel, or if its parameters are not understood.
    """
    found = re.search(rf"\bkernel\s+void\s+{name.rpartition('/')[2]}\s*\(([^)]*)\)", text)
    if not found:
        raise ValueError(f"clkernels/{name}.cl has no kernel of that name")
    if "#" in found[1]:
        raise ValueError(f"the parameters of {name} depend on the preprocessor, which is not supported")
    declarations = re.sub(r"//[^\n]*", "", found[1]).split(",")
    if len(declarations) == 1 and declarations[0].strip() in ("", "void"):
        return Signature(name, ())
    return Signature(name, tuple(map(_parameter, declarations)))


def _parameter(declaration: str) -> Parameter:
    words = [word for word in re.findall(r"\w+", declaration) if word not in _QUALIFIERS]
    if len(words) != 2:
        raise ValueError(f"the parameter {declaration.strip()!r} is not understood")
    kind, name = words
    pointed, star, _ = declaration.partition("*")
    parts, is_pointer = _TYPE.fullmatch(kind), bool(star)
    is_known = parts is not None and parts[1] in _TYPES
    if not (is_known or is_pointer):
        raise ValueError(f"the parameter {declaration.strip()!r} is of an unknown type")
    dtype, lanes = (np.dtype(_TYPES[parts[1]]), int(parts[2] or 1)) if is_known and parts else (None, 1)
    if lanes == 3 and not is_pointer:
        raise ValueError(f"the parameter {declaration.strip()!r} has 3 lanes, which OpenCL pads to 4; use 4")
    is_writable = is_pointer and not _READ_ONLY.intersection(re.findall(r"\w+", pointed))
    return Parameter(name, kind, is_pointer, dtype, lanes, is_writable)
