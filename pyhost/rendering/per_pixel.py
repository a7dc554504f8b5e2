"""The diffuse sphere by Monte Carlo with fresh samples for every pixel: noise instead of bias.

There are four estimators, all unbiased. One sample per pixel means:

- ``light``: a direction sampled by the light: the least work, but about half of the directions lie below the horizon
- ``bsdf``: a direction sampled by the cosine: good only if the light is much the same from everywhere
- ``mis``: one of each, weighted by the power heuristic: never much worse than the better of the two
- ``product``: a direction sampled by light times cosine, approximately: by far the least noise. Its tables take a few
  milliseconds to build, and it is for diffuse surfaces only

The error of N independent points falls as 1 / sqrt(N), that of Sobol points and lattices faster. ``light`` and
``product`` see the centres of the map's pixels, as the samples of part 2 do, and converge to :func:`lightdome.exact`.
``bsdf`` and ``mis`` see pixels as areas of constant radiance, and converge to ``exact(..., pixels="areas")``; so do the
other two with ``within="pixel"``. The two images differ most at the edge of what a single bright pixel lights. The
difference has both signs, and is a fraction of the image's maximum that falls as 1 / H, where H is the map's height.

Kernels: ``render_light.cl``, ``render_light_areas.cl``, ``render_bsdf.cl``, ``render_mis.cl``, ``render_product.cl``,
``render_product_areas.cl``. Source: Veach, thesis (1997), chapter 9; Pharr, Jakob, Humphreys, Physically Based
Rendering, 4th ed., 2.2 and 13.2; Karlik et al., MIS Compensation (2019).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from .. import checks
from ..disc import check_resolution, disc_tiles, note_tiles
from ..errors import LightdomeError
from ..float_range import to_float32
from ..names import ESTIMATORS as ESTIMATORS
from ..names import PIXEL_SEQUENCES as SEQUENCES
from ..names import SEED, WITHIN
from ..opencl import memory
from ..progress import Progress
from ..sampling.cdf import build_cdf
from ..sampling.distribution import Distribution
from ..sampling.draw import philox_key
from .product import ProductCDFs, build_product_cdfs

if TYPE_CHECKING:
    from ..opencl.device import Device
    from ..opencl.signature import Argument

SAMPLES_PER_LAUNCH = 2**25  # pixels x spp between two updates of the progress line
PIXELS_PER_BLOCK = 128  # that a work-item on a CPU renders side by side
SAMPLES_PER_SUM = 128  # spp that a launch sums in single precision; the sum over launches is in double words
# Arguments of kernels that are attributes of a DeviceMap, under the same names.
OF_MAP = ("radiance", "theta", "phi", "edge", "width", "height", "scale")


def render(
    distribution: Distribution,
    spp: Sequence[int],
    resolution: int = 511,
    albedo: float = 1.0,
    seed: int = SEED,
    estimator: str = "light",
    sequence: str = "independent",
    mis_compensation: bool = False,
    within: Literal["centre", "pixel"] | None = None,
) -> Iterator[tuple[int, np.ndarray]]:
    """Yield (spp, image) for each of ``spp`` in increasing order; images are (R, R, 3) float32 radiance.

    - ``estimator``: ``light``, ``bsdf``, ``mis`` or ``product``, see :mod:`lightdome.rendering.per_pixel`
    - ``sequence``: ``independent``; ``sobol``, with a separate Owen scramble for every pixel; or ``lattice``, with a
      separate shift. The last two are best at powers of two
    - ``mis_compensation``: with ``mis``, sample only the light above the map's mean, and leave the rest to the cosine's
      samples
    - ``within``: where in a pixel of the map directions lie: at its ``centre``, the default of ``light`` and
      ``product``; or anywhere in the ``pixel``, uniform over its solid angle, where those of ``bsdf`` and ``mis``
      always lie

    An image with more samples continues one with fewer, so all of them together cost as much as the last. A black map
    gives a black image. Raises :class:`LightdomeError` for a resolution or a number of samples out of range, for an
    albedo that is negative or not finite, for unknown names, for compensation without ``mis``, and for centres with
    ``bsdf`` or ``mis``.
    """
    checks.instance("the distribution", distribution, Distribution)
    resolution, albedo = check_resolution(resolution), checks.albedo(albedo)
    spp = sorted(set(checks.wholes("samples per pixel", spp, 1, 2**31 - 1)))
    checks.choice("estimator", estimator, ESTIMATORS)
    checks.choice("sequence", sequence, SEQUENCES)
    if checks.flag("mis_compensation", mis_compensation) and estimator != "mis":
        raise LightdomeError(f"MIS compensation needs the estimator 'mis', got {estimator!r}")
    by_centres = ESTIMATORS[estimator].pixels == "centres"
    if within is not None and checks.choice("place within a pixel", within, WITHIN) == "centre" and not by_centres:
        raise LightdomeError(f"{estimator!r} sees pixels as areas; expected within='pixel', got 'centre'")
    areas = by_centres and within == "pixel"
    key = philox_key(seed)
    return _images(distribution, spp, resolution, albedo, key, estimator, areas, sequence, mis_compensation)


def _images(
    distribution: Distribution,
    spp: Sequence[int],
    resolution: int,
    albedo: float,
    key: np.ndarray,
    estimator: str,
    areas: bool,
    sequence: str,
    mis_compensation: bool,
) -> Iterator[tuple[int, np.ndarray]]:
    device = distribution.device
    if distribution.total == 0:
        device.decisions.skip("rendering", "the map is black, and so is the image")
        yield from _black(spp, resolution)
        return

    device.decisions.skip("code of other estimators and sequences", f"only {estimator} and {sequence} are built")
    # Allocated first, as the largest: if the device has no room for it, this fails at once.
    total = memory.zeros(device, (2, resolution, resolution, 3), np.float32)
    disc = disc_tiles(resolution, 1, 1)
    note_tiles(device.decisions, disc, resolution, 1, 1)
    defines = {f"SEQUENCE_{sequence.upper()}": 1}
    if distribution.map.is_grey:
        device.decisions.skip("separate channels", "the map is grey")
        defines["GREY"] = 1
    else:
        device.decisions.use("separate channels", "the map is in colour")
    kernel = f"rendering/render_{estimator}{'_areas' if areas else ''}"
    if estimator == "product":
        cdfs = build_product_cdfs(distribution, resolution, areas)
        disc = cdfs.lit(device, disc)
        device.decisions.skip("guide tables", "tables of light times cosine are searched instead")
        if len(disc) == 0:
            device.decisions.skip("rendering", "no light of the map falls on what the camera sees")
            yield from _black(spp, resolution)
            return
        launch = _product_launch(distribution, kernel, cdfs, disc, defines)
        flux = 3 * distribution.flux
    else:
        launch, flux = _launch(distribution, kernel, mis_compensation, disc, defines)
    step = min(device.items_per_launch(SAMPLES_PER_LAUNCH, len(disc)), SAMPLES_PER_SUM)
    done = 0
    with Progress("rendering") as progress:
        for target in spp:
            while done < target:
                end = min(done + step, target)
                launch(seed=key, begin=done, end=end, resolution=resolution, sum=total)
                device.wait()
                done = end
                progress.update(done / spp[-1])
            # In float64: albedo F / pi can exceed float32's range even if no radiance does.
            image = np.add(*memory.download(device, total), dtype=np.float64)
            image *= albedo / np.pi * flux / target
            yield target, to_float32(image)


def _black(spp: Sequence[int], resolution: int) -> Iterator[tuple[int, np.ndarray]]:
    for target in spp:
        yield target, np.zeros((resolution, resolution, 3), np.float32)


def _launch(
    distribution: Distribution, kernel: str, mis_compensation: bool, disc: np.ndarray, defines: dict[str, int]
) -> tuple[Callable[..., None], float]:
    """A function that launches ``kernel`` for a range of samples, and the flux of R + G + B that it samples.

    Of the map, the CDFs, their guide tables and the factors, it passes those that the kernel's signature names.
    """
    device, of_map, cdf = distribution.device, distribution.map, distribution.cdf
    offset = 0.0
    if mis_compensation:
        mean = float(np.float32(cdf.total / np.sin(of_map.row_angles).sum() / of_map.width))
        compensated = build_cdf(of_map, mean)
        if compensated.total > 0:  # else the map is uniform: nothing is above its mean
            cdf = compensated
            offset = mean
    flux = 3 * distribution.flux * (cdf.total / distribution.total)
    wanted = device.programs.parameters(kernel)
    arguments = _of_map(distribution, wanted)
    if "row_cdf" in wanted:
        device.decisions.use("guide tables", "every sample of every pixel searches the map")
        arguments |= cdf.arguments | cdf.guide.arguments
    else:
        device.decisions.skip("guide tables", "directions of the cosine need no search")
    factors = {"offset": offset, "k": np.pi / (flux * of_map.scale)}
    arguments |= {factor: value for factor, value in factors.items() if factor in wanted}
    return _in_blocks(device, kernel, disc, defines, **arguments), flux


def _of_map(distribution: Distribution, wanted: frozenset[str]) -> dict[str, Argument]:
    """Those of the ``wanted`` arguments that come from the map."""
    return {argument: getattr(distribution.map, argument) for argument in OF_MAP if argument in wanted}


def _product_launch(
    distribution: Distribution, kernel: str, cdfs: ProductCDFs, disc: np.ndarray, defines: dict[str, int]
) -> Callable[..., None]:
    """A function that launches ``kernel``, which samples by CDFs of its own, for a range of samples."""
    device = distribution.device
    return _in_blocks(
        device,
        kernel,
        disc,
        defines,
        tile_row_cdf=cdfs.tile_row_cdf,
        tile_marginal_cdf=cdfs.tile_marginal_cdf,
        tile_cones=cdfs.tile_cones,
        tile_total=cdfs.tile_total,
        tile_size=cdfs.tile_size,
        tiles_across=cdfs.tile_total.shape[1],
        cell_row_cdf=cdfs.cell_row_cdf,
        cell_marginal_cdf=cdfs.cell_marginal_cdf,
        cell_cones=cdfs.cell_cones,
        cells=cdfs.cell_cones.shape[1::-1],
        cell_size=cdfs.cell_size,
        inverse_total=1 / distribution.total,
        **_of_map(distribution, device.programs.parameters(kernel)),
    )


def _in_blocks(
    device: Device, name: str, disc: np.ndarray, defines: dict[str, int], **arguments: Any
) -> Callable[..., None]:
    """A function that launches the kernel ``name`` with ``arguments``, over the blocks of the disc's pixels."""
    block = 1 if device.is_gpu else PIXELS_PER_BLOCK
    return partial(
        device.launch,
        name,
        (-(-len(disc) // block),),
        stage="render",
        defines={"BLOCK": block, **defines},
        disc=memory.upload(device, disc),
        pixel_count=len(disc),
        **arguments,
    )
