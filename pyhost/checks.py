"""Checks of the arguments of public functions; an error says in one line what was expected and what was given.

Each check returns the value in the one form that the rest of the code uses, or raises :class:`LightdomeError`.
"""

from __future__ import annotations

import math
import numbers
import operator
import os
from collections.abc import Iterable
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import DTypeLike

from .errors import LightdomeError, one_line
from .float_range import LARGEST

T = TypeVar("T")

SHOWN = 6  # list items that a message shows
BRIGHTEST = 1e200  # largest flux of a light: the sum of all lights, times an albedo, stays in float64's range
UNIT = 1e-4  # how far a unit vector's length may be from 1, after rounding or a few printed digits


def told(value: object) -> str:
    """Describe a value in a few words, however large it is."""
    if isinstance(value, np.ndarray):
        return f"an array of shape {value.shape} and type {value.dtype}"
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, list | tuple):
        more = ", ..." if len(value) > SHOWN else ""
        return f"[{', '.join(told(item) for item in value[:SHOWN])}{more}]"
    if isinstance(value, int) and value.bit_length() > 200:  # Python refuses to print 4300 digits or more
        return f"a number of {value.bit_length()} bits"
    if value is None or isinstance(value, bool | int | float | complex | os.PathLike):
        return one_line(str(value))
    if isinstance(value, str | bytes):
        return one_line(repr(value[:80]))
    if isinstance(value, type):
        return f"the class {value.__name__}"
    name = type(value).__name__
    return f"{'an' if name[0] in 'AEIOUaeiou' else 'a'} {name}"


def instance(what: str, value: object, kind: type) -> None:
    """Refuse a value that is not of type ``kind``, as when two arguments are swapped."""
    if not isinstance(value, kind):
        raise LightdomeError(
            f"{what} must be of type {kind.__name__}, got {told(value)}; check the order of the arguments"
        )


def whole(what: str, value: object, low: int, high: int) -> int:
    """A whole number from ``low`` to ``high``, of any integer type, but not a float or a bool."""
    try:
        number = None if isinstance(value, bool) else operator.index(value)  # type: ignore[arg-type]
    except TypeError:
        number = None
    if number is None or not low <= number <= high:
        raise LightdomeError(f"{what} must be a whole number from {low} to {high}, got {told(value)}")
    return number


def wholes(what: str, values: object, low: int, high: int) -> list[int]:
    """At least one whole number from ``low`` to ``high``, in a list or any other sequence."""
    try:
        is_list = not isinstance(values, str | bytes) and np.ndim(values) == 1  # type: ignore[arg-type]
    except ValueError:  # lists of different lengths
        is_list = False
    if not (is_list and isinstance(values, Iterable)):
        raise LightdomeError(f"{what} must be a list of whole numbers from {low} to {high}, got {told(values)}")
    result = [whole(f"each of the {what}", value, low, high) for value in values]
    if not result:
        raise LightdomeError(f"{what} must hold at least one whole number from {low} to {high}, got none")
    return result


def real(what: str, value: object, wanted: str, low: float, high: float = math.inf) -> float:
    """A finite number from ``low`` to ``high``; ``wanted`` is that range in words."""
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value.item()
    number = math.nan
    if isinstance(value, numbers.Real) and not isinstance(value, bool):
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
    if not (math.isfinite(number) and low <= number <= high):
        raise LightdomeError(f"{what} must be {wanted}, got {told(value)}")
    return number


def positive(what: str, value: object) -> float:
    """A finite number above 0."""
    return real(what, value, "a finite number above 0", math.ulp(0.0))


def albedo(value: object) -> float:
    """A surface's albedo; no real surface exceeds 1, but a larger albedo is useful as a scale."""
    return real("the albedo", value, f"a number from 0 to {LARGEST:.2g}", 0, LARGEST)


def choice(what: str, value: object, names: Iterable[str]) -> str:
    """One of ``names``."""
    if not (isinstance(value, str) and value in names):
        raise LightdomeError(f"unknown {what} {told(value)}; expected one of {', '.join(names)}")
    return value


def path(value: object) -> Path:
    """A file's path that Python can pass to the operating system."""
    if not isinstance(value, str | os.PathLike):
        raise LightdomeError(f"a file must be named by a path, got {told(value)}")
    result = Path(os.fsdecode(value))
    try:
        os.fsencode(result)
        possible = "\0" not in str(result)
    except UnicodeEncodeError:
        possible = False
    if not possible:
        raise LightdomeError(f"{told(str(result))} cannot be the name of a file")
    return result


def optional_text(what: str, value: object) -> str | None:
    """A string, or None."""
    if not (value is None or isinstance(value, str)):
        raise LightdomeError(f"{what} must be a string or None, got {told(value)}")
    return value


def flag(what: str, value: object) -> bool:
    """True or False; numbers and strings are refused, since 'no' would be true."""
    if not isinstance(value, bool | np.bool_):
        raise LightdomeError(f"{what} must be True or False, got {told(value)}")
    return bool(value)


def array(
    what: str,
    value: object,
    shape: tuple[int | str, ...] | None = None,
    dtype: DTypeLike | None = None,
    own: bool = False,
) -> np.ndarray:
    """An array of real numbers, converted to ``dtype``; a letter in ``shape`` stands for any length.

    This is ``value`` itself where nothing has to be converted. With ``own`` it is a read-only copy.
    """
    form = "given as real numbers"
    if shape is not None:
        form = f"an array of real numbers of shape ({', '.join(map(str, shape))}{',' * (len(shape) == 1)})"
    try:
        result = np.asarray(value)
    except (ValueError, TypeError):  # rows of different lengths
        result = np.empty(0, object)
    if result.dtype.kind not in "fiu":
        raise LightdomeError(f"{what} must be {form}, got {told(value)}")
    if shape is not None and (
        result.ndim != len(shape) or any(n != m for n, m in zip(shape, result.shape, strict=True) if isinstance(n, int))
    ):
        raise LightdomeError(f"{what} must be {form}, got shape {result.shape}")
    with np.errstate(over="ignore"):  # too large becomes infinite
        if not own:
            return result.astype(dtype or result.dtype, copy=False)
        result = np.array(result, dtype, order="C", copy=True)
    result.flags.writeable = False
    return result


def unit_vectors(what: str, value: object, dtype: DTypeLike, each: str = "number", own: bool = False) -> np.ndarray:
    """Unit vectors (N, 3), see :func:`array`; messages call one of them ``each``."""
    result = array(what, value, ("N", 3), dtype, own)
    with np.errstate(over="ignore"):
        unit = np.abs(np.einsum("nc,nc->n", result, result) - 1) <= 2 * UNIT
    if not unit.all():
        n = int(np.argmin(unit))
        raise LightdomeError(
            f"a direction must be a unit vector, got {told(result[n].tolist())} ({each} {n}); normalise it"
        )
    return result


def lights(direction: object, flux: object, own: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors (N, 3) float32 and their fluxes (N, 3) float64, from 0 to :data:`BRIGHTEST`."""
    direction = unit_vectors("direction", direction, np.float32, "light", own)
    flux = array("flux", flux, ("N", 3), np.float64, own)
    if len(direction) != len(flux):
        raise LightdomeError(f"direction and flux must have the same length, got {len(direction)} and {len(flux)}")
    if flux.size and not (flux.min() >= 0 and flux.max() <= BRIGHTEST):
        n = int(np.argmin(((flux >= 0) & (flux <= BRIGHTEST)).all(axis=1)))
        raise LightdomeError(f"a flux must be from 0 to {BRIGHTEST:g}, got {told(flux[n].tolist())} (light {n})")
    return direction, flux


def same(one: object, other: object) -> bool:
    """Whether two objects have the same type and equal attributes, comparing arrays by content."""
    return type(one) is type(other) and all(
        np.array_equal(value, vars(other)[name]) for name, value in vars(one).items()
    )


def made(kind: type[T], **values: object) -> T:
    """A frozen dataclass of values already checked and ours alone: arrays are made read-only, not copied."""
    result = object.__new__(kind)
    for name, value in values.items():
        if isinstance(value, np.ndarray):
            value.flags.writeable = False
        object.__setattr__(result, name, value)
    return result
