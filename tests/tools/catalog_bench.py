"""Measures what ``lightdome catalog`` costs per map, compared with a plain loop, a pool of processes, and numpy.

    python tests/tools/catalog_bench.py FOLDER [--workers 1 2] [--peer PYTHON]

Each method runs in its own processes, once with a few of the maps and once with all. The difference, divided by the
number of additional maps, leaves out the cost of starting. Processor time is that of all processes together. ``--peer``
names a Python with ``skylibs`` and ``mitsuba``, which reads the maps; it does the same work as a loop in numpy.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

PEER = """
import hashlib, sys
import mitsuba
import numpy as np
from envmap import EnvironmentMap

def work(path):
    hashlib.sha256(open(path, "rb").read()).hexdigest()
    bitmap = mitsuba.Bitmap(path).convert(mitsuba.Bitmap.PixelFormat.RGB, mitsuba.Struct.Type.Float32, False)
    e = EnvironmentMap(np.array(bitmap), "latlong")
    L, omega = e.data.astype(np.float64), e.solidAngles()
    x, y, z, _ = e.worldCoordinates()
    n = np.stack([x, y, z], axis=-1)
    I = L.mean(axis=2)
    light = I * omega
    order = np.argsort(I, axis=None)
    at = np.searchsorted(np.cumsum(omega.ravel()[order]), np.array([0.5, 0.99, 0.999]) * omega.sum())
    I.ravel()[order[at]], I.min(), I.max(), light.max(), light.sum() ** 2 / (light**2).sum()
    flux = L * omega[..., None]
    for axis in range(3):
        for sign in (1, -1):
            np.einsum("yxc,yx->c", flux, np.maximum(sign * n[..., axis], 0))
    basis = [np.ones_like(x), x, y, z, x * y, y * z, 3 * z * z - 1, x * z, x * x - y * y]
    np.stack([np.einsum("yxc,yx->c", flux, b) for b in basis])
    regions = [(0, light.shape[0], 0, light.shape[1])]
    while len(regions) < 16:
        halves = []
        for y0, y1, x0, x1 in regions:
            part = light[y0:y1, x0:x1]
            wide = (x1 - x0) * np.sin(np.pi * (y0 + y1) / 2 / light.shape[0]) > y1 - y0
            sums = np.cumsum(part.sum(axis=0 if wide else 1))
            cut = 1 + min(int(np.searchsorted(sums, sums[-1] / 2)), len(sums) - 2)
            if wide:
                halves += [(y0, y1, x0, x0 + cut), (y0, y1, x0 + cut, x1)]
            else:
                halves += [(y0, y0 + cut, x0, x1), (y0 + cut, y1, x0, x1)]
        regions = halves
    [flux[a:b, c:d].sum((0, 1)) for a, b, c, d in regions]
    R = 127
    a = 2 * np.arange(R) + 1 - R
    inside = a**2 + a[:, None] ** 2 < R * R
    normal = np.stack(np.broadcast_arrays(a / R, -a[:, None] / R, 0.0), axis=-1)[inside]
    normal[:, 2] = np.sqrt(1 - (normal**2).sum(axis=1))
    n32, f32 = n.reshape(-1, 3).astype(np.float32), flux.reshape(-1, 3).astype(np.float32)
    image = np.zeros((len(normal), 3))
    for first in range(0, len(n32), 4096):
        part = slice(first, first + 4096)
        image += np.maximum(normal.astype(np.float32) @ n32[part].T, 0) @ f32[part]

for path in open(sys.argv[1]).read().split("\\n"):
    work(path)
"""


def worker(path: str) -> None:
    """Compute the row of a map, as a worker of the catalog does."""
    from lightdome.catalog.row import Options, Row, digest, fill, read
    from lightdome.opencl.device import open_device

    global DEVICE
    if "DEVICE" not in globals():
        DEVICE = open_device()
    row, options = Row({}), Options()
    digest(Path(path))
    found = read(Path(path), options.memory)
    fill(row, found, DEVICE, options, "name")


def run_way(way: str, workers: int, maps: list[str]) -> None:
    """Do the work by one method, in this process and its children."""
    if way == "loop":
        for path in maps:
            worker(path)
        return
    with multiprocessing.get_context("spawn").Pool(workers) as pool:
        for _ in pool.imap_unordered(worker, maps):
            pass
        pool.close()
        pool.join()


def cost(command: list[str]) -> tuple[float, float]:
    """Processor seconds and wall-clock seconds that a command takes, with all its children."""
    begin = time.monotonic()
    process = subprocess.Popen(command, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    if status:
        raise SystemExit(f"exit status {status}: {command}")
    return usage.ru_utime + usage.ru_stime, time.monotonic() - begin


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="maps of about the same size")
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2], help="numbers of processes")
    parser.add_argument("--peer", metavar="PYTHON", help="a Python with mitsuba and skylibs")
    parser.add_argument("--few", type=int, default=4, help="maps in the short run that is subtracted")
    parser.add_argument("--way", nargs=3, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.way:
        run_way(args.way[0], int(args.way[1]), Path(args.way[2]).read_text().split("\n"))
        return
    maps = sorted(str(path) for path in args.folder.rglob("*.*"))
    this = [sys.executable, __file__, str(args.folder), "--way"]
    catalog = [sys.executable, "-m", "lightdome", "catalog"]
    ways: dict[str, list[str]] = {"a plain loop": [*this, "loop", "1", "LIST"]}
    for n in map(str, args.workers):
        ways[f"multiprocessing, {n}"] = [*this, "pool", n, "LIST"]
        ways[f"catalog, {n}"] = [*catalog, "LIST", "--out", "OUT", "--workers", n]
    if args.peer:
        ways["numpy and skylibs"] = [args.peer, "-c", PEER, "LIST"]
    print(f"{len(maps)} maps; cost per map:")
    for name, command in ways.items():
        costs = []
        for some in (maps[: args.few], maps):
            with tempfile.TemporaryDirectory() as out:
                names = {"OUT": out, "LIST": f"{out}/maps.txt"}
                Path(names["LIST"]).write_text("\n".join(some), encoding="utf-8")
                costs.append(cost([names.get(word, word) for word in command]))
        cpu, wall = ((b - a) / (len(maps) - args.few) for a, b in zip(*costs, strict=True))
        print(f"  {name:<22} {cpu:.3f} s of processor time, {wall:.3f} s of wall-clock time", flush=True)


if __name__ == "__main__":
    main()
