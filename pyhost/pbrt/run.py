"""Find PBRT, or a port of it, and have it render a scene of :mod:`lightdome.pbrt.scenes`.

``pbrt-r4`` and ``pbrt-r3`` are Rust ports that read the same scenes. Like PBRT-v3, pbrt-r3 has no seed; with more than
one thread, its images differ from run to run.

A program that exits normally may still have rendered something else: PBRT-v3 renders white light if it cannot read its
map. So its output matters too: an error fails the run, and warnings are logged (:mod:`logging`, ``lightdome.pbrt``).
:mod:`lightdome.pbrt.check` compares the image with what the map should give.
"""

from __future__ import annotations

import atexit
import contextlib
import io
import logging
import os
import re
import shutil
import signal
import subprocess
import tempfile
import threading
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .. import checks
from ..cache import cache_folder
from ..decisions import Decision
from ..disc import disc_mask
from ..errors import LightdomeError
from ..maps.images import read_image
from ..progress import Progress
from .scenes import IMAGE_SUFFIX, VERSIONS, Scene, sampler_name

PORTS = {"pbrt-r4": 4, "pbrt-r3": 3}
NAMES = ("pbrt", *PORTS)  # in the order of the search
ELSE = "or render with --renderer opencl"
GET = "cargo install pbrt-r4 --locked --no-default-features"
# When to give up a render: once its progress bar has stood still for STILL seconds plus ten times its longest step so
# far; while there is no bar, after STILL seconds plus about ten times the expected time.
STILL = 60.0
SECONDS_PER_SAMPLE = 3e-5  # pbrt-r4 takes 3e-6 on one core
_log = logging.getLogger(__package__)


@dataclass(frozen=True)
class Pbrt:
    """A PBRT program that runs: its file, its scene version (3 or 4), and a port's own name and version."""

    path: Path
    version: int
    port: str | None = None

    @property
    def name(self) -> str:
        """Name and version, such as ``PBRT-v4`` or ``pbrt-r4 4.5.2``."""
        return self.port or f"PBRT-v{self.version}"

    @property
    def has_seed(self) -> bool:
        """Whether its samples depend on a seed."""
        return self.version > 3

    @property
    def is_random(self) -> bool:
        """Whether two runs can differ: by the seed, or for pbrt-r3, by the order of its threads."""
        return self.has_seed or self.port is not None

    @property
    def image_suffix(self) -> str:
        """The file format that stores its image without loss."""
        return ".exr" if self.port else IMAGE_SUFFIX[self.version]

    def __str__(self) -> str:
        return f"{self.name} ({self.path})"


def installed_port() -> Path:
    """Where scripts/get_pbrt.py installs ``pbrt-r4``, whether or not it is there."""
    return cache_folder("pbrt") / "bin" / "pbrt-r4"


def find_pbrt(path: str | Path | None = None, timeout: float = 20.0) -> Pbrt:
    """The program at ``path``, a file or its folder; None looks on PATH, then for the installed port.

    It looks for ``pbrt``, ``pbrt-r4`` and ``pbrt-r3``. Asks the program for its version, for at most ``timeout``
    seconds. Raises :class:`LightdomeError` if there is no such program, it does not start, or it is neither version 3
    nor 4.
    """
    checks.positive("the timeout", timeout)
    program = _locate(None if path is None else checks.path(path))
    # An empty scene makes PBRT print its banner; its versions share no option that does so. The ports print their
    # usage, and have such an option.
    said = []
    for options in ([], ["--version"]):
        try:
            code, text = _run([str(program), *options], timeout)
        except TimeoutError:
            raise LightdomeError(
                f"{program} did not say its version within {timeout:g} s; give another with --pbrt, {ELSE}"
            ) from None
        said.append((code, text))
        if re.search(r"\brs_pbrt\b", text):
            raise LightdomeError(
                f"{program} is rs_pbrt, which writes only 8-bit pictures; install a port that writes radiance: {GET}"
            )
        if port := re.search(r"^(pbrt-r[34]) (?:version )?(\d[\w.]*)", text, re.MULTILINE):
            return Pbrt(program, PORTS[port[1]], f"{port[1]} {port[2]}")
        if found := re.search(r"^\s*pbrt version (\d+)", text, re.MULTILINE | re.IGNORECASE):
            version = int(found[1])
            if version not in VERSIONS:
                raise LightdomeError(
                    f"{program} is PBRT version {version}, but the scenes are for 3 and 4;"
                    f" give another with --pbrt, {ELSE}"
                )
            return Pbrt(program, version)
    code, text = said[0]
    state = f"it {_ending(code)}; " if code < 0 else ""
    raise LightdomeError(
        f"{program} does not answer as PBRT does ({state}it said: {_gist(text)}); give another with --pbrt, {ELSE}"
    )


def _locate(path: Path | None) -> Path:
    if path is None:
        folders = os.environ.get("PATH", os.defpath)
        if found := _first_program(folders, NAMES):
            return found
        port = installed_port()
        if os.access(port, os.X_OK):
            return port
        if found := _unusable(folders):
            return found
        raise LightdomeError(f"no PBRT on PATH; install it ({GET}), name a program with --pbrt, {ELSE}")
    path = path.expanduser()
    if path.is_dir():
        folders = str(path.absolute())
        if found := _first_program(folders, NAMES) or _unusable(folders):
            return found
        raise LightdomeError(f"no program {', '.join(NAMES)} in the folder {path}; give the program with --pbrt")
    if not path.exists():
        raise LightdomeError(f"{path} does not exist; give the pbrt program or its folder with --pbrt")
    if not os.access(path, os.X_OK):
        raise _not_executable(path)
    return path.absolute()


def _first_program(folders: str, names: Sequence[str]) -> Path | None:
    """The first of ``names`` in ``folders``, a list such as PATH."""
    found = next(filter(None, (shutil.which(name, path=folders) for name in names)), None)
    return Path(found).absolute() if found else None


def _unusable(folders: str) -> Path | None:
    """rs_pbrt, to be refused when asked for its version; raises if PBRT is there but not executable."""
    for folder in filter(None, folders.split(os.pathsep)):
        for name in NAMES:
            if (file := Path(folder, name)).is_file():
                raise _not_executable(file)
    return _first_program(folders, ["rs_pbrt"])


def _not_executable(path: Path) -> LightdomeError:
    return LightdomeError(f"{path} is not executable; run chmod +x on it or give another with --pbrt, {ELSE}")


def decisions(pbrt: Pbrt, scene: Scene) -> list[Decision]:
    """What was used for the image of ``scene``, and what was skipped, with the reasons."""
    result = [Decision("OpenCL kernels", False, f"{pbrt} rendered")]
    if scene.version == 3:
        result.append(
            Decision("the sampler halton", True, f"{pbrt.name} has no other that samples pixels at their centres")
        )
    elif sampler_name(scene.spp) == "zsobol":
        result.append(Decision("the sampler zsobol", True, f"{scene.spp} is a power of two"))
    else:
        result.append(Decision("the sampler halton", True, f"{scene.spp} is not a power of two, which zsobol needs"))
    if scene.exponent:
        why = f"its largest value is far from 1; the image is multiplied by 2^{scene.exponent}"
        result.append(Decision("scaling of the map", True, why))
    else:
        result.append(Decision("scaling of the map", False, "its largest value is not far from 1"))
    return result


def render(pbrt: Pbrt, scenes: Iterable[Scene], timeout: float | None = None) -> Iterator[tuple[int, np.ndarray]]:
    """Yield (spp, image) for each of ``pbrt``'s scenes in increasing order: see :func:`render_scene`."""
    checks.instance("the program", pbrt, Pbrt)
    if not isinstance(scenes, Iterable):
        raise LightdomeError(f"scenes must be the list that write_scenes returns, got {checks.told(scenes)}")
    scenes = list(scenes)
    for scene in scenes:
        checks.instance("each of the scenes", scene, Scene)
    own = sorted((scene for scene in scenes if scene.version == pbrt.version), key=lambda scene: scene.spp)
    return ((scene.spp, render_scene(pbrt, scene, timeout)) for scene in own)


def render_scene(
    pbrt: Pbrt, scene: Scene, timeout: float | None = None, quiet: bool = False, _still: float = STILL
) -> np.ndarray:
    """Run ``pbrt`` on one scene; returns radiance (R, R, 3) float32, 0 outside the disc.

    ``timeout`` is in seconds; by default, a render is given up once it stands still. ``quiet`` skips the wait of up to
    a second for PBRT's progress bar, and hides warnings. Raises :class:`LightdomeError` if PBRT does not start, fails,
    reports an error, takes too long, stands still, or leaves no usable image.
    """
    checks.instance("the program", pbrt, Pbrt)
    checks.instance("the scene", scene, Scene)
    size = scene.resolution
    if timeout is not None:
        checks.positive("the timeout", timeout)
    by_hand = f"try the scene {scene.path} by hand, {ELSE}"
    with tempfile.TemporaryDirectory(prefix="lightdome-", ignore_cleanup_errors=True) as folder:
        target = Path(folder) / f"image{pbrt.image_suffix}"
        options = ["--quiet"] if quiet else []
        command = [str(pbrt.path), *options, "--outfile", str(target), str(scene.path.absolute())]
        watch = _Watch(scene.spp * size**2, _still)
        try:
            with Progress(f"{pbrt.name}, {scene.spp} spp") as progress:
                code, text = _run(command, timeout, watch, progress, terminal=pbrt.port is not None)
        except TimeoutError:
            how = f"took more than {timeout:g} s" if timeout else f"showed no progress for {watch.still():.0f} s"
            raise LightdomeError(f"{pbrt} was stopped: {scene.spp} spp {how}; {by_hand}") from None
        if code != 0:
            raise LightdomeError(f"{pbrt} {_ending(code)}; it said: {_gist(text)}; {by_hand}")
        lines = _lines(text)
        if wrong := next((line for line in lines if _ERROR.search(line)), None):
            raise LightdomeError(f"{pbrt} exited with status 0 but reported an error: {_short(wrong)}; {by_hand}")
        for warning in dict.fromkeys(line for line in lines if _WARNING.search(line)):
            _log.warning("note: %s says: %s", pbrt.name, _short(warning))
        if not target.exists():
            raise LightdomeError(f"{pbrt} exited with status 0 but wrote no image; it said: {_gist(text)}; {by_hand}")
        try:
            image = read_image(target)
        except LightdomeError as error:
            reason = str(error).replace(str(target), "it").partition(";")[0].partition(" (")[0]
            raise LightdomeError(f"{pbrt} wrote an image that cannot be read ({reason}); {by_hand}") from error
    if image.shape != (size, size, 3):
        raise LightdomeError(
            f"{pbrt} wrote {image.shape[1]} x {image.shape[0]} pixels instead of {size} x {size}; {by_hand}"
        )
    image[~disc_mask(size)] = 0
    with np.errstate(over="ignore"):
        image = np.ldexp(image, scene.exponent)
    bad = int((~np.isfinite(image)).any(axis=2).sum())
    if bad:
        raise LightdomeError(f"{pbrt} left {bad} pixels that are NaN or infinite; {by_hand}")
    return image


class _Watch:
    """Tells from the progress bar whether a render of ``samples`` stands still; ``patience`` is like STILL."""

    def __init__(self, samples: int, patience: float) -> None:
        self._patience = patience
        self._allowed = patience + SECONDS_PER_SAMPLE * samples
        self._fraction: float | None = None
        self._moved = time.monotonic()
        self._longest_step = 0.0

    def update(self, fraction: float | None) -> bool:
        """Note that the bar is at ``fraction``, None without a bar; returns whether it is time to give up."""
        now = time.monotonic()
        if fraction is not None and fraction != self._fraction:
            self._longest_step = max(self._longest_step, now - self._moved)
            self._allowed = self._patience + 10 * self._longest_step
            self._fraction, self._moved = fraction, now
        return now - self._moved > self._allowed

    def still(self) -> float:
        """Seconds since the bar last moved."""
        return time.monotonic() - self._moved


def _run(
    command: list[str],
    timeout: float | None,
    watch: _Watch | None = None,
    progress: Progress | None = None,
    terminal: bool = False,
) -> tuple[int, str]:
    """Run ``command`` without a shell; returns its exit status and the end of its output, colours removed.

    ``terminal`` gives it a pseudo-terminal for its output, if the system has them: the ports draw a bar on nothing
    else.

    Raises ``TimeoutError`` after ``timeout`` seconds, or if there is no timeout, when ``watch`` gives up. The program
    and its children are gone whenever this returns or raises.
    """
    with tempfile.TemporaryDirectory(prefix="lightdome-", ignore_cleanup_errors=True) as folder:
        ends = os.openpty() if terminal and hasattr(os, "openpty") else os.pipe()
        stream = os.fdopen(ends[0], "rb")  # closed by the thread that reads it
        try:
            process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=ends[1],
                stderr=subprocess.STDOUT,
                cwd=folder,
                # By default, version 3 logs to the system's temporary folder.
                env={**os.environ, "GLOG_log_dir": folder},
                start_new_session=True,
            )
        except OSError as error:
            stream.close()
            raise LightdomeError(
                f"cannot start {command[0]}: {error.strerror}; give another with --pbrt, {ELSE}"
            ) from error
        finally:
            os.close(ends[1])
        output = bytearray()
        reader = threading.Thread(target=_collect, args=(stream, output), daemon=True)
        reader.start()
        deadline = None if timeout is None else time.monotonic() + timeout
        atexit.register(kill_session, process)
        try:
            while True:
                left = 0.1 if deadline is None else min(0.1, max(0.0, deadline - time.monotonic()))
                try:
                    process.wait(left)
                    break
                except subprocess.TimeoutExpired:
                    fraction = _fraction_done(output)
                    if left == 0 or (deadline is None and watch is not None and watch.update(fraction)):
                        raise TimeoutError from None
                    if progress is not None:
                        progress.update(fraction or 0.0)
        finally:
            kill_session(process)
            atexit.unregister(kill_session)
        # A grandchild that left the session could hold the pipe open forever.
        reader.join(2.0)
        text = bytes(output).decode("utf-8", "replace")
        return process.returncode, _COLOUR.sub("", text)


def _collect(stream: io.BufferedReader, output: bytearray) -> None:
    with contextlib.suppress(OSError, ValueError), stream:
        while chunk := stream.read1(4096):
            output += chunk
            # The banner and the first message are at the start, the progress at the end; errors are anywhere.
            if len(output) > 2**16:
                middle = bytes(output[2**14 : -(2**14)]).decode("utf-8", "replace")
                loud = [
                    line for line in _lines(_COLOUR.sub("", middle)) if _ERROR.search(line) or _WARNING.search(line)
                ]
                output[2**14 : -(2**14)] = "\n".join(["", *loud, ""]).encode()[: 2**14] + b"\n"


def _fraction_done(output: bytearray) -> float | None:
    """How far PBRT's bar is: it redraws ``Rendering: [+++   ]``, a port ``x.exr: [███   ]``. None without a bar."""
    text = _COLOUR.sub("", output[-4096:].decode("utf-8", "replace"))
    bars = [bar for bar in re.findall(r"\[([+▁-▏]*)( *)\]", text) if bar != ("", "")]
    return len(bars[-1][0]) / sum(map(len, bars[-1])) if bars else None


def kill_session(process: subprocess.Popen[bytes] | subprocess.Popen[str]) -> None:
    """Kill ``process``, which was started in its own session, and everything that it started."""
    if process.poll() is not None:
        return
    # Kill the whole session: pbrt may be a script that starts the real program.
    with contextlib.suppress(OSError):
        if hasattr(os, "killpg"):
            os.killpg(process.pid, signal.SIGKILL)
        else:
            process.kill()
    process.wait()


def _ending(code: int) -> str:
    if code >= 0:
        return f"failed with exit status {code}"
    try:
        return f"crashed ({signal.Signals(-code).name})"
    except ValueError:
        return f"crashed (signal {-code})"


# PBRT-v3 and -v4 print `Error: ...`, before or after the place in the scene; the ports print a time and `ERROR] ...`;
# the logs have `E1231 ...` (version 3) or `[ ... ] ERROR ...` (version 4).
_ERROR = re.compile(r"(?:^|[\s:])(?:Error:|Fatal:|ERROR\]|FATAL\])|^[EF]\d{4} |^\[.*\] (?:ERROR|FATAL)\b")
_WARNING = re.compile(r"(?:^|[\s:])(?:Warning:|WARN ?\])|^W\d{4} |^\[.*\] WARN")
_COLOUR = re.compile(r"\x1b\[[0-9;]*[A-Za-z]")
_BANNER = re.compile(
    r"pbrt\S* version|copyright|this is an unofficial|the (?:source code|license)|see the file|-+$|\*+"
    r"|[^\[]*: \[[+▁-▏]* *\]",
    re.IGNORECASE,
)


def _lines(text: str) -> list[str]:
    """What a program printed, without its banner and its progress bar."""
    lines = (line.strip() for line in re.split(r"[\r\n]+", text))
    return [line for line in lines if line and not _BANNER.match(line)]


def _gist(text: str) -> str:
    """The line of a program's output that is most likely to say what went wrong."""
    lines = _lines(text)
    errors = [line for line in lines if re.search(r"\b(error|fatal|check failed)\b", line, re.IGNORECASE)]
    return _short((errors or lines[-1:] or ["nothing"])[0])


def _short(line: str) -> str:
    return line if len(line) <= 300 else line[:300] + "…"
