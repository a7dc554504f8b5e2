"""Put small faults into the code, one at a time, and see whether the tests notice them.

    python tests/tools/mutate.py                     # all faults: half an hour
    python tests/tools/mutate.py cells.cl seed       # those in this file, and those with this word in their names
    python tests/tools/mutate.py --area scripts --out table.txt

The faults are in faults.py. Each is put into a copy of the clone that has its own environment, where the tests that
might notice it run until one fails. First, all of those tests run once without a fault, and must pass. Exits with 1 if
a fault goes unnoticed and is not marked as equivalent, or if a fault cannot be applied.
"""

from __future__ import annotations

import argparse
import configparser
import contextlib
import itertools
import os
import re
import shutil
import signal
import subprocess
import sys
import sysconfig
import tempfile
import time
import venv
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from dataclasses import dataclass
from pathlib import Path

from faults import FAULTS, Fault

ROOT = Path(__file__).resolve().parents[2]
# The folders of each area; the host does not include the commands.
AREAS = {"kernels": ("clkernels",), "host": ("pyhost",), "commands": ("pyhost/commands", "scripts", "data")}
LEFT_OUT = (".git", ".venv", "out", "build", "dist", "__pycache__", "*.egg-info", ".*_cache")  # not copied
LIMIT = 300.0  # seconds for the tests of a fault; a program that hangs counts as noticed

NOTICED, SURVIVED, EQUIVALENT, NOT_FOUND = "noticed", "SURVIVED", "equivalent", "NOT FOUND"

# Puts a copy's packages before those of the environment from which the copy's is derived.
FINDER = """\
import sys
from importlib.machinery import PathFinder
from importlib.util import spec_from_file_location

FOLDERS = {folders!r}


class Copy:
    __module__ = "__editable___lightdome_copy"  # stays first where setup.py's line sorts finders by this name

    @staticmethod
    def find_spec(name, path=None, target=None):
        if folder := FOLDERS.get(name):
            return spec_from_file_location(name, folder + "/__init__.py", submodule_search_locations=[folder])
        return PathFinder.find_spec(name, path) if name.partition(".")[0] in FOLDERS else None


sys.meta_path.insert(0, Copy)
"""


def faulty(root: Path, fault: Fault) -> tuple[Path, str]:
    """The file of a fault below ``root``, and its text with the fault in it.

    Raises ``LookupError`` if there is no such file, or if it does not contain the fault's text exactly once.
    """
    found: list[Path] = []
    for folder in AREAS[fault.area]:
        found = found or list((root / folder).rglob(fault.file))
    if fault.area == "host":
        # These files share their names with others, so a fault names them with their folder.
        others = {"commands", "checking"} - set(Path(fault.file).parts)
        found = [path for path in found if path.parent.name not in others]
    if len(found) != 1:
        raise LookupError(f"{len(found)} files of the area {fault.area} are called {fault.file}")
    (path,) = found
    text = path.read_text(encoding="utf-8")
    if (count := text.count(fault.text)) != 1:
        raise LookupError(f"its text must occur once in {fault.file}, but occurs {count} times")
    return path, text.replace(fault.text, fault.replacement)


def test_paths(root: Path, tests: Sequence[str]) -> list[str]:
    """Names such as ``test_pfm.py`` or ``test_pfm.py::test_values`` as paths, wherever the files are in tests/."""
    paths = []
    for name in tests:
        file, colons, test = name.partition("::")
        (path,) = (root / "tests").rglob(file)
        paths.append(f"{path.relative_to(root)}{colons}{test}")
    return paths


@dataclass(frozen=True)
class Verdict:
    """The result for a fault: one of the words above, which test noticed it or why not, and the seconds it took."""

    fault: Fault
    word: str
    by: str = ""
    seconds: float = 0.0


class Copy:
    """A copy of the clone, with an environment in which ``import lightdome`` finds the copy."""

    def __init__(self, folder: Path) -> None:
        self.root = folder / "lightdome"
        shutil.copytree(ROOT, self.root, ignore=shutil.ignore_patterns(*LEFT_OUT), symlinks=True)
        environment = self.root / ".venv"
        venv.create(environment, symlinks=True)
        self._python = environment / "bin" / "python"
        config = configparser.ConfigParser()
        config.read(self.root / "setup.cfg")
        lines = config["options"]["package_dir"].strip().splitlines()
        folders = {name.strip(): str(self.root / path.strip()) for name, _, path in (li.partition("=") for li in lines)}
        (packages,) = environment.glob("lib/python*/site-packages")
        parent = sysconfig.get_paths()["purelib"]
        (packages / "of_the_copy.py").write_text(FINDER.format(folders=folders))
        (packages / "of_the_copy.pth").write_text(f"import site; site.addsitedir({parent!r})\nimport of_the_copy\n")
        # A fault must not leave anything in a cache for the next one.
        self._cache = folder / "cache"
        self._environment = {**os.environ, "XDG_CACHE_HOME": str(self._cache)}
        fonts = [self._python, "-c", "import matplotlib.font_manager"]  # once, not in a test of a full disk
        subprocess.run(fonts, env=self._environment, check=True)
        self._process: subprocess.Popen[str] | None = None
        self._ended = False

    def run(self, tests: Sequence[str], limit: float | None) -> tuple[int, str]:
        """pytest's exit status and output; the status is -9 if it took longer than ``limit`` seconds."""
        for kept in (self._cache / "lightdome").glob("*"):
            if kept.name != "devices":  # keeps what the probe measured
                shutil.rmtree(kept)
        command = [self._python, "-m", "pytest", "--exitfirst", "--tb=line", "-p", "no:cacheprovider"]
        self._process = subprocess.Popen(
            [*command, *test_paths(self.root, tests)],
            cwd=self.root,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            env=self._environment,
            start_new_session=True,
        )
        if self._ended:
            self._kill()
        try:
            said, _ = self._process.communicate(timeout=limit)
        except subprocess.TimeoutExpired:
            self._kill()
            said, _ = self._process.communicate()
            return -signal.SIGKILL, said
        return self._process.returncode, said

    def end(self) -> None:
        """Stop the running tests, and start no more."""
        self._ended = True
        self._kill()

    def _kill(self) -> None:
        if self._process and self._process.poll() is None:
            with contextlib.suppress(OSError):
                os.killpg(self._process.pid, signal.SIGKILL)

    def judge(self, fault: Fault) -> Verdict:
        """Put the fault in, run its tests, and take the fault out."""
        start = time.monotonic()
        path, text = faulty(self.root, fault)
        before = path.read_text(encoding="utf-8")
        try:
            self._write(path, text)
            status, said = self.run(fault.tests, LIMIT)
        finally:
            self._write(path, before)
        word, by = (SURVIVED, "") if status == 0 else (NOTICED, _by(status, said))
        if status == 0 and fault.equivalent:
            word, by = EQUIVALENT, fault.equivalent
        return Verdict(fault, word, by, time.monotonic() - start)

    _time = itertools.count(int(time.time()))

    def _write(self, path: Path, text: str) -> None:
        """Write a source file with a new time, since Python reuses compiled code for the same time and size."""
        path.write_text(text, encoding="utf-8")
        now = next(self._time)
        os.utime(path, (now, now))


def _by(status: int, said: str) -> str:
    """The name of the test that failed."""
    if status == -signal.SIGKILL:
        return f"none finished in {LIMIT:.0f} s"
    found = re.search(r"^(?:FAILED|ERROR) \S*?([^/\s]+\.py\S*)", said, re.MULTILINE)
    return found[1] if found else f"pytest, which ended with {status}"


def judged(faults: Sequence[Fault], jobs: int, folder: Path) -> Iterator[Verdict]:
    """Yield each fault's result as soon as it is known. Raises ``RuntimeError`` if tests fail without a fault."""
    applicable = []
    for fault in faults:
        try:
            faulty(ROOT, fault)
            applicable.append(fault)
        except LookupError as error:
            yield Verdict(fault, NOT_FOUND, str(error))
    if not applicable:
        return
    copies = [Copy(folder / str(n)) for n in range(min(jobs, len(applicable)))]
    pool = ThreadPoolExecutor(len(copies))
    try:
        tests = sorted({test for fault in applicable for test in fault.tests})
        runs = [pool.submit(copy.run, tests, None) for copy in copies]  # this also fills each copy's cache
        wait(runs)
        for status, said in (run.result() for run in runs):
            if status:
                raise RuntimeError(f"without a fault the tests do not pass:\n{said}")
        idle, waiting, busy = list(copies), list(reversed(applicable)), {}
        while waiting or busy:
            while waiting and idle:
                copy = idle.pop()
                busy[pool.submit(copy.judge, waiting.pop())] = copy
            for run in wait(busy, return_when=FIRST_COMPLETED).done:
                idle.append(busy.pop(run))
                yield run.result()
    finally:
        for copy in copies:
            copy.end()
        pool.shutdown()


def line(verdict: Verdict) -> str:
    """A line of the table of results."""
    place = f"{verdict.fault.area:<9}{verdict.fault.file:<22}"
    return f"{place}{verdict.word:<11}{verdict.seconds:>5.0f} s  {verdict.fault.name:<58}{verdict.by}".rstrip()


def summary(verdicts: Sequence[Verdict]) -> list[str]:
    """By area, how many faults were noticed of those that are not equivalent, and which were not."""
    lines = []
    for area in AREAS:
        words = Counter(v.word for v in verdicts if v.fault.area == area)
        if count := words[NOTICED] + words[SURVIVED]:
            share = f"{words[NOTICED]} of {count} noticed, {100 * words[NOTICED] / count:.0f} %"
            lines.append(f"{area:<8} {share}; {words[EQUIVALENT]} equivalent")
    for verdict in verdicts:
        if verdict.word in (SURVIVED, NOT_FOUND):
            lines.append(f"{verdict.word}: {verdict.fault.name} ({verdict.by or verdict.fault.why})")
        elif verdict.word == NOTICED and verdict.fault.equivalent:
            lines.append(f"noticed, so not equivalent: {verdict.fault.name} (by {verdict.by})")
    return lines


def main() -> int:
    """Judge the faults chosen on the command line."""
    parser = argparse.ArgumentParser(
        description="Put small faults into a copy of the code, one at a time, and see whether the tests notice."
    )
    parser.add_argument(
        "names", nargs="*", metavar="NAME-PART", help="a part of a file's or a fault's name (default: all)"
    )
    parser.add_argument("--area", choices=AREAS, help="only faults of this area")
    parser.add_argument("--out", type=Path, metavar="FILE", help="also write the table to this file")
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="copies tested in parallel (default: 1)")
    parser.add_argument("--list", action="store_true", help="list the faults and run nothing")
    args = parser.parse_args()
    faults = [
        fault
        for fault in FAULTS
        if (not args.names or any(part in f"{fault.file}: {fault.name}" for part in args.names))
        and (not args.area or fault.area == args.area)
    ]
    if args.list:
        for fault in faults:
            print(f"{fault.file:<22}{fault.name:<58}{fault.why}")
        return 0
    if not faults:
        parser.error(f"no fault or file has {' or '.join(args.names)} in its name")
    verdicts: list[Verdict] = []
    with tempfile.TemporaryDirectory(prefix="lightdome-faults-", ignore_cleanup_errors=True) as folder:
        try:
            for verdict in judged(faults, max(1, args.jobs), Path(folder)):
                verdicts.append(verdict)
                print(line(verdict), flush=True)
        except RuntimeError as error:
            sys.exit(f"mutate: {error}")
        except KeyboardInterrupt:
            print("\nmutate: interrupted", file=sys.stderr)
            return 130
    print("\n" + "\n".join(summary(verdicts)))
    if args.out:
        order = [line(v) for v in sorted(verdicts, key=lambda v: FAULTS.index(v.fault))]
        args.out.write_text("\n".join([*order, "", *summary(verdicts)]) + "\n", encoding="utf-8")
    return int(any(verdict.word in (SURVIVED, NOT_FOUND) for verdict in verdicts))


if __name__ == "__main__":
    sys.exit(main())
