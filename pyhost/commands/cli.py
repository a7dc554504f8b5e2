"""What all commands share: argument types, output folders, and errors in one line.

A command parses its arguments, calls the library and prints what it wrote. Its ``main`` runs under
:func:`lightdome.console.run`, which turns a user's mistake into one line and exit status 1; argparse itself exits with
2 for a wrong command line. Defects of lightdome keep their traceback.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import os
import sys
import tempfile
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import LightdomeError, exactly
from ..files import utf8_name
from ..maps.default_map import default_map
from ..names import COMMANDS, CONVENTIONS, PROJECTIONS

if TYPE_CHECKING:
    import numpy as np

    from ..decisions import Decision
    from ..maps.envmap import EnvironmentMap
    from ..opencl.device import Device

LINEAR, DISPLAYED = ["pfm", "exr"], ["ppm", "png"]  # image formats for radiance and for 8-bit values
FORMATS = ["pfm", "ppm", "png"]


class _Help(argparse.HelpFormatter):
    """Keeps paragraphs, and shows the default of each option that has one, as the user would type it."""

    def _get_help_string(self, action: argparse.Action) -> str | None:
        default = action.default
        if default is None or default is False or default in ([], argparse.SUPPRESS):
            return action.help
        typed = " ".join(map(str, default)) if isinstance(default, list) else str(default)
        return f"{action.help} (default: {typed.replace('%', '%%')})"

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        return "\n\n".join(super(_Help, self)._fill_text(part, width, indent) for part in text.split("\n\n"))


class Parser(argparse.ArgumentParser):
    """Lets ``--rotate`` take only the numbers that follow it, and completes command lines for a shell."""

    def parse_args(self, *arguments: Any, **options: Any) -> argparse.Namespace:  # type: ignore[override]
        """As usual, unless a shell asks for completions and argcomplete is installed: print them and exit."""
        if "_ARGCOMPLETE" in os.environ:
            with contextlib.suppress(ImportError):
                import argcomplete

                argcomplete.autocomplete(self)
        return super().parse_args(*arguments, **options)

    def parse_known_args(self, args=None, namespace=None):  # type: ignore[no-untyped-def]
        """As usual, except that ``--rotate 1 2 3`` becomes one word, which :func:`_angles` splits."""
        words: list[str] = []
        for word in sys.argv[1:] if args is None else args:
            if words and words[-1].partition("=")[0] == "--rotate" and _is_number(word):
                words[-1] += f" {word}" if "=" in words[-1] else f"={word}"
            else:
                words.append(word)
        return super().parse_known_args(words, namespace)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def parser(description: str, example: str, out: str | None = None) -> argparse.ArgumentParser:
    """An argument parser in the style that all commands share, with the option ``--out`` if ``out`` is its default.

    The first paragraph of ``description`` is the purpose in one line; ``example`` holds the arguments of an example.
    """
    result = Parser(
        prog=Path(sys.argv[0]).name,
        description=description,
        epilog=f"example: {program()} {example}".rstrip(),
        formatter_class=_Help,
    )
    if out:
        result.add_argument("--out", type=Path, default=Path(out), metavar="DIR", help="folder to write into")
    return result


def program(command: str | None = None) -> str:
    """How a user types this command or another: as a command of ``lightdome``, or as a script."""
    if command is None:
        return f"scripts/{Path(sys.argv[0]).name}" if _is_script() else sys.argv[0]
    return f"scripts/{COMMANDS[command].module}.py" if _is_script() else f"lightdome {command}"


def _is_script() -> bool:
    """Whether a script runs the command, rather than the console program."""
    return Path(sys.argv[0]).suffix == ".py"


def _data_folder() -> Path:
    """``data/`` next to the folder of the running script, else the folder of the default map."""
    of_script = Path(sys.argv[0]).resolve().parent.parent / "data"
    return of_script if _is_script() and of_script.is_dir() else default_map().parent


def map_options(parser: argparse.ArgumentParser, positional: bool = False) -> None:
    """Add ``--map`` and the options for reading it, for :func:`load_map`.

    The default is Grace if it is in the folder of :func:`_data_folder`, else the map that comes with lightdome. With
    ``positional``, the map is a required positional argument.
    """
    data = _data_folder()
    grace = data / "grace_latlong.exr"
    parser.add_argument(
        "map" if positional else "--map",
        type=Path,
        metavar="MAP" if positional else "FILE",
        default=None if positional else (grace if grace.exists() else data / "default.exr"),
        help="environment map: .exr, .hdr or .pfm",
    )
    projection_option(parser)
    parser.add_argument(
        "--layer",
        metavar="NAME",
        help="layer or part of an .exr file that is the map (default: R, G, B or Y, else the only possible one)",
    )
    parser.add_argument(
        "--sanitize",
        nargs="?",
        choices=["black", "clamp"],
        const="black",
        help="replace NaN, infinite and negative pixels by black; with clamp, infinite ones by the largest finite value"
        " of the file's format (default: refuse the map)",
    )
    parser.add_argument("--flip", action="store_true", help="reverse the rows, for a file that was written upside down")
    orientation_options(parser)


def projection_option(parser: argparse.ArgumentParser) -> None:
    """Add ``--projection``."""
    parser.add_argument(
        "--projection",
        choices=PROJECTIONS,
        metavar="NAME",
        help=f"projection of the file: {', '.join(PROJECTIONS)} (default: detected from its header, its sides and black"
        " corners)",
    )


def orientation_options(parser: argparse.ArgumentParser) -> None:
    """Add ``--convention``, which is applied first, ``--mirror``, and ``--rotate``, which is applied last."""
    parser.add_argument(
        "--convention",
        choices=CONVENTIONS,
        default=CONVENTIONS[0],
        metavar="NAME",
        help=f"program for which the map was made: {', '.join(CONVENTIONS)}",
    )
    parser.add_argument("--mirror", action="store_true", help="reverse the columns, for a map that is mirrored")
    parser.add_argument(
        "--rotate",
        type=_angles,
        metavar="YAW [PITCH ROLL]",
        help="rotate the map by degrees about +y (counter-clockwise from above), +x and +z, after --convention and"
        " --mirror (default: 0 0 0)",
    )


def _angles(text: str) -> list[float]:
    """Argument type: a yaw, or a yaw, a pitch and a roll, separated by spaces."""
    values = [finite_float(word) for word in text.split()]
    if len(values) not in (1, 3):
        raise argparse.ArgumentTypeError(f"expected YAW or YAW PITCH ROLL, got {len(values)} numbers")
    return values


def map_arguments(args: argparse.Namespace) -> list[object]:
    """The options of :func:`map_options` as typed for another command."""
    result: list[object] = ["--map", args.map]
    if args.layer is not None:
        result.append(f"--layer={args.layer}")
    if args.sanitize:
        result += ["--sanitize", args.sanitize]
    result += [f"--{name}" for name in ("flip", "mirror") if getattr(args, name)]
    if args.projection:
        result += ["--projection", args.projection]
    if args.convention != CONVENTIONS[0]:
        result += ["--convention", args.convention]
    return result + (["--rotate", *args.rotate] if args.rotate else [])


def quicken(parser: argparse.ArgumentParser, args: argparse.Namespace, **values: object) -> None:
    """Set the options that ``--quick`` reduces to ``values``, except those given on the command line."""
    for name, value in values.items():
        if getattr(args, name) == parser.get_default(name):
            setattr(args, name, value)


def load_map(args: argparse.Namespace) -> EnvironmentMap:
    """The map that the options of :func:`map_options` name; remarks on it go to standard error."""
    from ..maps.envmap import EnvironmentMap  # imported here, since a script without a map needs no image library

    envmap = EnvironmentMap.read(
        args.map,
        sanitize=args.sanitize,
        layer=args.layer,
        flip=args.flip,
        projection=args.projection,
        convention=args.convention,
    )
    envmap = turned(args, envmap)
    for note in (*envmap.notes, envmap.shape_note, envmap.replaced and envmap.replaced.note):
        if note:
            print(note, file=sys.stderr)
    return envmap


def turned(args: argparse.Namespace, envmap: EnvironmentMap) -> EnvironmentMap:
    """The map after ``--mirror`` and ``--rotate``."""
    envmap = envmap.mirrored() if args.mirror else envmap
    return envmap.rotated(*args.rotate) if args.rotate else envmap


def map_columns(args: argparse.Namespace, width: int, advice: str = "") -> np.ndarray:
    """The columns of a file in the order that :func:`orientation_options` asks for, for a map read in bands.

    Raises :class:`LightdomeError`, with ``advice``, if pixels would have to be resampled.
    """
    import numpy as np

    from ..maps.conventions import yaw_between
    from ..maps.rotation import rotation_matrix, whole_columns

    first = whole_columns(width, rotation_matrix(yaw_between(args.convention, "lightdome")))
    last = whole_columns(width, rotation_matrix(*args.rotate or [0.0]))
    if first is None or last is None:
        raise LightdomeError(
            f"a map that is read in bands can only turn by whole columns, of which it has {width}; change --rotate or"
            f" --convention{advice}"
        )
    columns = np.roll(np.arange(width), first)
    return np.roll(columns[::-1] if args.mirror else columns, last)


def device_option(parser: argparse.ArgumentParser) -> None:
    """Add ``--device``, for :func:`open_device`."""
    parser.add_argument(
        "--device",
        metavar="NAME",
        help="OpenCL device: PLATFORM[:DEVICE], each an index or part of a name that lightdome devices shows"
        " (default: $PYOPENCL_CTX, else the fastest that works)",
    )


def open_device(args: argparse.Namespace) -> Device:
    """Open the device named by ``--device``, or the fastest, and print which; remarks go to standard error."""
    from ..opencl import device  # imported here, since a script without a device needs no OpenCL

    opened = device.open_device(args.device)
    print(f"device: {opened.description}")
    if opened.note:
        print(opened.note, file=sys.stderr)
    return opened


def explain_option(parser: argparse.ArgumentParser) -> None:
    """Add ``--explain``, for :func:`explain` and :func:`explain_kernels`."""
    parser.add_argument(
        "--explain", action="store_true", help="say for each result what was used, what was skipped, and why"
    )


def explain(args: argparse.Namespace, result: str, decisions: Iterable[Decision]) -> None:
    """Print the ``decisions`` made for a ``result``, with ``--explain``."""
    if args.explain:
        for decision in decisions:
            print(f"{result}: {decision}")


def explain_kernels(args: argparse.Namespace, device: Device) -> None:
    """Print which kernels were built, with ``--explain``."""
    if args.explain:
        built, there = device.programs.built, device.programs.available
        kernels = {kernel.partition(" ")[0] for kernel in built}  # one may be built with several defines
        print(f"built {len(kernels)} of {there} kernels: {', '.join(built) or 'none'}")


def sphere_options(parser: argparse.ArgumentParser) -> None:
    """Add ``--resolution`` and ``--albedo``."""
    parser.add_argument(
        "--resolution",
        type=positive_int,
        default=511,
        metavar="R",
        help="width and height of the images in pixels",
    )
    parser.add_argument(
        "--albedo",
        type=non_negative_float,
        default=1.0,
        metavar="RHO",
        help="share of the light that the sphere reflects, 0 black to 1 white; above 1 for experiments",
    )


def image_options(parser: argparse.ArgumentParser) -> None:
    """Add ``--format``, and ``--gamma`` and ``--exposure``, which affect only display images."""
    parser.add_argument(
        "--format",
        nargs="+",
        choices=LINEAR + DISPLAYED,
        default=FORMATS,
        metavar="FORMAT",
        help=f"formats of the images: {' and '.join(LINEAR)} hold linear radiance, {' and '.join(DISPLAYED)} are for"
        " display",
    )
    parser.add_argument("--gamma", type=positive_float, default=2.2, help="gamma of the .ppm and .png files")
    parser.add_argument(
        "--exposure",
        type=exposure,
        default="auto",
        metavar="FACTOR",
        help="factor on the radiance for the .ppm and .png files; with auto, the 95th percentile becomes white, for"
        " a sphere that of its exact image",
    )


def display_option(parser: argparse.ArgumentParser) -> None:
    """Add ``--display``, for :func:`write_images`."""
    parser.add_argument(
        "--display",
        type=_display,
        metavar="HOST:PORT",
        help="also send the images, as linear radiance, to tev, which listens at 127.0.0.1:14158 (default: none)",
    )


def _display(text: str) -> tuple[str, int]:
    """Argument type: a host and a port, where there is something to speak to tev."""
    from ..viewer.display import check_display

    check_display()
    host, _, number = text.rpartition(":")
    if not host:
        raise argparse.ArgumentTypeError(f"{text!r} is not HOST:PORT")
    return host.strip("[]"), port(number)


def write_images(args: argparse.Namespace, path: Path, pixels: np.ndarray) -> list[str]:
    """Write ``pixels`` in those formats of ``--format`` that hold them, radiance or 8-bit; returns the file names.

    ``path`` has no suffix. Radiance is also sent to the ``--display``, if the command has one.
    """
    from ..maps.images import write_image

    formats = LINEAR if pixels.dtype.kind == "f" else DISPLAYED
    names = [f"{path.name}.{name}" for name in formats if name in args.format]
    for name in names:
        write_image(path.with_name(name), pixels)
    if formats is LINEAR and getattr(args, "display", None):
        from ..viewer.display import display

        host, port = args.display
        display(host, port, path.name, pixels)
    return names


def formats(args: argparse.Namespace) -> str:
    """The suffixes of ``--format``, to follow a file's name in a command's output."""
    return ", ".join(f".{name}" for name in dict.fromkeys(args.format))


def output_folder(path: Path, images: bool = False) -> Path:
    """Create the folder ``path``, and make sure that files, and with ``images`` also images, can be written there.

    Raises :class:`LightdomeError` if they cannot.
    """
    if images:
        utf8_name(path)
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):  # it has no name, so a killed process leaves nothing behind
            pass
    except OSError as error:
        raise LightdomeError(
            f"cannot write into the folder {path}: {error.strerror}; choose another with --out"
        ) from error
    return path


def output_file(path: Path) -> None:
    """Raise :class:`LightdomeError` if the file's folder does not exist, before any work is wasted."""
    if not path.parent.is_dir():
        raise LightdomeError(f"cannot write {path}: there is no folder {path.parent}; create it, or choose another")


def _number(convert: type, text: str, accept: Callable[[float], bool], wanted: str) -> float:
    try:
        value = convert(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not {wanted}") from None
    if not (accept(value) and value < math.inf):
        raise argparse.ArgumentTypeError(f"{text} is not {wanted}")
    return value


def port(text: str) -> int:
    """Argument type: a TCP port, 0 included."""
    return int(_number(int, text, lambda v: 0 <= v <= 65535, "a port from 0 to 65535"))


def positive_int(text: str) -> int:
    """Argument type: a whole number, 1 to 2^31 - 1."""
    return int(_number(int, text, lambda v: 1 <= v < 2**31, "a whole number from 1 to 2147483647"))


def times(text: str) -> int:
    """Argument type: a number of repetitions, 1 to 1000, since more would seem endless."""
    return int(_number(int, text, lambda v: 1 <= v <= 1000, "a whole number from 1 to 1000"))


def seed(text: str) -> int:
    """Argument type: a whole number, 0 to 2^64 - 1."""
    return int(_number(int, text, lambda v: 0 <= v < 2**64, "a whole number from 0 to 2^64 - 1"))


def positive_float(text: str) -> float:
    """Argument type: a finite number above 0."""
    return float(_number(float, text, lambda v: v > 0, "a finite number above 0"))


def finite_float(text: str) -> float:
    """Argument type: a finite number."""
    return float(_number(float, text, lambda v: v > -math.inf, "a finite number"))


def non_negative_float(text: str) -> float:
    """Argument type: a finite number, 0 or above."""
    return float(_number(float, text, lambda v: v >= 0, "a finite number, 0 or above"))


def error(text: str) -> float:
    """Argument type: a relative error from 0.001 % to 100 %, in percent (``1%``) or as a fraction (``0.01``)."""
    wanted = "an error such as 1% or 0.01, from 0.001% to 100%"
    value = _number(float, text.removesuffix("%"), lambda v: v > 0, wanted) / (100 if text.endswith("%") else 1)
    if value >= 1 and not text.endswith("%"):
        raise argparse.ArgumentTypeError(f"{text} is ambiguous; write {text}%, or a fraction below 1")
    if not 1e-5 <= value <= 1:
        raise argparse.ArgumentTypeError(f"{text} is not {wanted}")
    return value


def seconds(text: str) -> float:
    """Argument type: a time above 0, in seconds (``10s`` or ``10``) or milliseconds (``500ms``)."""
    number, factor = (text[:-2], 1e-3) if text.endswith("ms") else (text.removesuffix("s"), 1.0)
    return factor * _number(float, number, lambda v: v > 0, "a time above 0 such as 10s or 500ms")


def tone(args: argparse.Namespace, exposure: float) -> str:
    """The line with exposure and gamma; numbers from the command line are shown in full."""
    used = exactly(exposure) if args.exposure else f"{exposure:.4g}"
    return f"exposure {used}, gamma {exactly(args.gamma)}"


def exposure(text: str) -> float | None:
    """Argument type: ``auto`` (None) or a factor above 0 by which radiance is multiplied."""
    return None if text == "auto" else positive_float(text)
