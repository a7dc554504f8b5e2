"""Run every kernel under Oclgrind: no access out of bounds, no data race, no use of uninitialised memory.

    python tests/tools/oclgrind.py

Oclgrind (Debian's package `oclgrind`) interprets kernels and checks every access. Maps and images are small and of odd
sizes, so that vector loops have remainders; each kernel runs in its shape for a CPU and in its shape for a GPU. Exits
with 1 if Oclgrind reports anything, if it misses the faults of a kernel that is broken on purpose, or if a kernel in
clkernels/ did not run.

Uninitialised memory is searched for only in row_cdf, marginal_cdf, guide, choose_rows, sample with and without guides,
shade, harmonics, render_light, render_light_areas, render_bsdf and render_mis, in the shape for a GPU, because this
search in Oclgrind 21.10 cannot follow all vectors: it takes lane 11 of any vector for uninitialised where memory was
used before, and for an unused lane it reads outside its own memory. tests/opencl/test_device_agreement.py searches all
kernels in another way.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pyopencl as cl

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from helpers import ROOT, stiff_radiance
from lightdome import progress
from lightdome.evaluation import roofline
from lightdome.lighting.exact import PIXELS, exact
from lightdome.lighting.harmonics import Harmonics, project, shade_harmonics
from lightdome.lighting.median_cut import median_cut
from lightdome.lighting.shade import shade
from lightdome.maps.envmap import EnvironmentMap
from lightdome.maps.images import ImageRows, write_image
from lightdome.opencl import memory
from lightdome.opencl.device import Device
from lightdome.opencl.memory import DeviceArray
from lightdome.opencl.programs import Kernel, Programs
from lightdome.opencl.rates import Rates
from lightdome.rendering.per_pixel import ESTIMATORS, render
from lightdome.rendering.per_pixel import SEQUENCES as RENDER_SEQUENCES
from lightdome.sampling import draw as draw_module
from lightdome.sampling.distribution import Distribution, build_distribution
from lightdome.sampling.samples import SEQUENCES, WITHIN
from lightdome.sampling.streaming import sample_file

SHAPES = ((7, 5), (3, 33), (2, 150))
RESOLUTIONS = (1, 17)

# Without these, Oclgrind 21.10 misses a vstore16 into a private array, since its compiler optimises it away, and does
# not load Random123, which has functions that return structures and that Oclgrind cannot inline.
BUILD_OPTIONS = "-cl-opt-disable -DR123_FORCE_INLINE(declaration)=declaration"

BROKEN = """
kernel void broken(global int *a)
{
    int never_set[2];
    a[0] = get_global_id(0);
    a[1] = never_set[a[2] & 1];
    a[1024] = 1;
}
"""
FAULTS = ("data race", "Uninitialized value", "Invalid write")


@dataclass(frozen=True)
class Simulator(Device):
    """Oclgrind's device, which claims to be every type of device, used as a CPU or as a GPU."""

    as_gpu: bool = False
    ran: set[str] = field(default_factory=set)
    shares_host_memory = False  # it takes the host's memory for uninitialised

    @property
    def is_gpu(self) -> bool:
        return self.as_gpu

    def kernel(self, name: str, **defines: int) -> Kernel:
        self.ran.add(name)
        return super().kernel(name, **defines)


def main() -> None:
    """Run this program under Oclgrind: the broken kernel, all kernels, those without false reports."""
    if len(sys.argv) > 1:
        progress.LINE_PATIENCE = np.inf  # anything on stderr is a finding
        {"broken": run_broken, "all": run_all, "clean": run_clean}[sys.argv[1]]()
        return
    found = findings("broken", "--data-races", "--uninitialized")
    missed = [fault for fault in FAULTS if fault not in found]
    if missed:
        sys.exit(f"Oclgrind misses faults of the broken kernel: {', '.join(missed)}")
    found = findings("all", "--data-races") + findings("clean", "--uninitialized")
    if found:
        sys.exit(f"{found}\nOclgrind reports the above")
    print("Oclgrind reports nothing")


def findings(what: str, *watch: str) -> str:
    """What Oclgrind reports while this program runs ``what``: on stderr, since its log file can lack the end."""
    command = ["oclgrind", *watch, "--build-options", BUILD_OPTIONS, sys.executable, __file__, what]
    result = subprocess.run(command, stderr=subprocess.PIPE, text=True)
    if result.returncode != 0:
        sys.exit(f"{result.stderr}\nunder Oclgrind, this program ended with exit status {result.returncode}")
    return result.stderr.strip()


def simulator(as_gpu: bool) -> Simulator:
    (handle,) = cl.get_platforms()[0].get_devices()
    context = cl.Context([handle])
    queue = cl.CommandQueue(context, properties=cl.command_queue_properties.PROFILING_ENABLE)
    rates = Rates(fused=1, plain=1, copies=1, transfers=None, launches=1, numpy=1)  # a simulator's rates mean nothing
    return Simulator(handle, context, queue, Programs(context, FUSED=1), rates, as_gpu=as_gpu)


def zeros(device: Device, shape: int | tuple[int, ...], dtype: type) -> DeviceArray:
    """Replaces :func:`memory.zeros`, since Oclgrind takes a filled buffer for an uninitialised one."""
    array = memory.empty(device, shape, dtype)
    cl.enqueue_copy(device.queue, array.buffer, np.zeros(array.shape, dtype))
    return array


def keep_memory() -> None:
    """Free no buffer, since Oclgrind reports false faults in memory that was used before."""
    make, kept = memory._buffer, []

    def buffer(*arguments: object) -> cl.Buffer:
        kept.append(make(*arguments))
        return kept[-1]

    memory._buffer = buffer


def run_broken() -> None:
    device = simulator(as_gpu=True)
    kernel = cl.Program(device.context, BROKEN).build().broken
    kernel(device.queue, (4,), (4,), cl.Buffer(device.context, cl.mem_flags.READ_WRITE, 16))
    device.queue.finish()


def run_all() -> None:
    ran = set()
    for distribution in distributions():
        draw(distribution)
        draw_pixels(distribution)
        draw_from_file(distribution)
        median_cut(distribution, 5)
        grey = build_distribution(distribution.device, EnvironmentMap(np.ones((5, 7, 3))))
        for resolution in RESOLUTIONS:
            for any_colour in (distribution, grey):
                light(any_colour, resolution, brute_force=False)
                light(any_colour, resolution, brute_force=True)
                for pixels in PIXELS:
                    exact(any_colour.device, any_colour.envmap, resolution, pixels=pixels)
                draw_images(any_colour, resolution, ESTIMATORS)
                draw_images(any_colour, resolution, ("light", "product"), within="pixel")
            shade_harmonics(distribution.device, project(distribution.device, distribution.envmap, 3), resolution)
        list(render(distribution, [2], RESOLUTIONS[-1], estimator="mis", mis_compensation=True))
        touch_limits(distribution.device)
        ran |= distribution.device.ran
    kernels = ROOT / "clkernels"
    sources = {str(file.relative_to(kernels).with_suffix("")) for file in kernels.rglob("*.cl")}
    if ran != sources:
        sys.exit(f"not run: {', '.join(sorted(sources - ran))}")
    print(f"{len(ran)} kernels ran")


def run_clean() -> None:
    keep_memory()
    for distribution in list(distributions(shapes=(True,))):  # all CDFs first, in fresh memory
        draw(distribution)
        for resolution in RESOLUTIONS:
            light(distribution, resolution, brute_force=True)
            shade_harmonics(distribution.device, Harmonics(np.ones((16, 3))), resolution)
            draw_images(distribution, resolution, ("light", "bsdf", "mis"))
            draw_images(distribution, resolution, ("light",), within="pixel")


def distributions(shapes: tuple[bool, ...] = (False, True)) -> Iterator[Distribution]:
    """A distribution per map and shape, which is that for a CPU or (True) for a GPU."""
    memory.zeros = zeros
    for as_gpu in shapes:
        device = simulator(as_gpu)
        for height, width in SHAPES:
            radiance = stiff_radiance(height, width)
            radiance[0, 0] = 1
            yield build_distribution(device, EnvironmentMap(radiance))


def draw(distribution: Distribution) -> None:
    for guided_from in (0, np.inf):
        draw_module.SAMPLES_PER_PIXEL = guided_from
        for sequence in SEQUENCES:
            for within in WITHIN:
                distribution.sample(19, 1, sequence, within)
        for within in WITHIN:
            distribution.sample_at(np.array([(0, 0), (1 - 2.0**-32, 1 - 2.0**-32), (0.5, 0.25)]), within)


def draw_pixels(distribution: Distribution) -> None:
    for guided_from in (0, np.inf):
        draw_module.SAMPLES_PER_PIXEL = guided_from
        for sequence in SEQUENCES:
            distribution.sample_pixels(19, 1, sequence)


def draw_from_file(distribution: Distribution) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "map.pfm"
        write_image(path, distribution.envmap.radiance)
        for sequence in SEQUENCES:
            sample_file(distribution.device, ImageRows(path, batch=2), [19], 1, sequence)


def light(distribution: Distribution, resolution: int, brute_force: bool) -> None:
    samples = distribution.sample(19)
    shade(distribution.device, samples.direction, samples.flux, resolution, brute_force=brute_force)


def touch_limits(device: Device) -> None:
    roofline.copy(device, 2**15)
    roofline.multiply_add(device, 2)
    roofline.launch(device)


def draw_images(
    distribution: Distribution, resolution: int, estimators: Iterable[str], within: str | None = None
) -> None:
    for estimator in estimators:
        for sequence in RENDER_SEQUENCES:
            list(render(distribution, [2, 3], resolution, estimator=estimator, sequence=sequence, within=within))


if __name__ == "__main__":
    main()
