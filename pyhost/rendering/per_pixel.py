"""The diffuse sphere by Monte Carlo with fresh samples for every pixel: noise instead of bias.

There are four estimators, all unbiased. One sample per pixel means:

- ``light``: a direction sampled by the light: the least work, but about half of the directions lie below the horizon
- ``bsdf``: a direction sampled by the cosine: good only if the light is much the same from everywhere
- ``mis``: two directions for each sample. Of all of a pixel's directions, the light draws a share that suits the map,
  and the cosine the rest; they are weighted by the balance heuristic: never much worse than the better of the two
- ``product``: a direction sampled by light times cosine, approximately, with a control variate: by far the least noise.
  Its tables take a few milliseconds to build, and it is for diffuse surfaces only. Pixels with few samples, or that no
  light reaches, may be slightly negative

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
from dataclasses import dataclass
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
from .light_share import choose_share, light_samples
from .product import ProductCDFs, build_product_cdfs

if TYPE_CHECKING:
    from ..opencl.device import Device
    from ..opencl.memory import DeviceArray
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
    light_share: float | None = None,
) -> Iterator[tuple[int, np.ndarray]]:
    """Yield (spp, image) for each of ``spp`` in increasing order; images are (R, R, 3) float32 radiance.

    - ``estimator``: ``light``, ``bsdf``, ``mis`` or ``product``, see :mod:`lightdome.rendering.per_pixel`
    - ``sequence``: ``independent``; ``sobol``, with a separate Owen scramble for every pixel; or ``lattice``, with a
      separate shift. The last two are best at powers of two
    - ``mis_compensation``: with ``mis``, sample only the light above the map's mean, and leave the rest to the cosine's
      samples
    - ``light_share``: with ``mis``, the part of a pixel's 2 spp directions that the light samples, above 0 and below 1,
      where the light and the cosine each sample at least one; by default the part that suits the map, see
      :mod:`lightdome.rendering.light_share`
    - ``within``: where in a pixel of the map directions lie: at its ``centre``, the default of ``light`` and
      ``product``; or anywhere in the ``pixel``, uniform over its solid angle, where those of ``bsdf`` and ``mis``
      always lie

    An image with more samples continues one with fewer, so all of them together cost as much as the last. With ``mis``
    this holds only where both have the same part of light samples, as all multiples of four do by default. A black map
    gives a black image. Raises :class:`LightdomeError` for a resolution or a number of samples out of range, for an
    albedo that is negative or not finite, for unknown names, for compensation or a share without ``mis``, for a share
    that is not between 0 and 1, and for centres with ``bsdf`` or ``mis``.
    """
    plan = planned(distribution, resolution, albedo, estimator, sequence, mis_compensation, within, light_share)
    spp = sorted(set(checks.wholes("samples per pixel", spp, 1, 2**31 - 1)))
    return _images(plan, spp, philox_key(seed))


@dataclass(frozen=True)
class Plan:
    """The arguments of :func:`render` that decide what a sample adds, checked."""

    distribution: Distribution
    resolution: int
    albedo: float
    estimator: str
    areas: bool
    sequence: str
    mis_compensation: bool
    light_share: float | None


@dataclass(frozen=True)
class Sampler:
    """Adds samples to sums: double words (2, R, R, 3), as :func:`render` and :func:`render_to_error` need them."""

    launch: Callable[..., None]
    resolution: int
    step: int  # the most samples per pixel in a launch
    factor: float  # radiance is this times the mean of the samples; it may exceed float32's range
    share: float | None  # of the light's samples among the directions of ``mis``

    def add(self, key: np.ndarray, begin: int, end: int, spp: int, total: DeviceArray) -> None:
        """Add samples ``begin`` to ``end`` - 1 of every pixel, at most ``step``.

        The sum is for ``spp`` samples, or for any number with the same part of light samples (:meth:`continues`).
        """
        split = {} if self.share is None else {"spp": spp, "n_light": light_samples(spp, self.share)}
        self.launch(seed=key, begin=begin, end=end, resolution=self.resolution, sum=total, **split)

    def continues(self, done: int, spp: int) -> bool:
        """Whether a sum of ``done`` samples can go on to ``spp``: whether both weight them alike."""
        return self.share is None or light_samples(spp, self.share) * done == light_samples(done, self.share) * spp

    def image(self, device: Device, total: DeviceArray, spp: int) -> np.ndarray:
        """The image of a sum of ``spp`` samples per pixel."""
        # In float64: albedo F / pi can exceed float32's range even if no radiance does.
        image = np.add(*memory.download(device, total), dtype=np.float64)
        image *= self.factor / spp
        return to_float32(image)


def planned(
    distribution: Distribution,
    resolution: int,
    albedo: float,
    estimator: str,
    sequence: str,
    mis_compensation: bool,
    within: str | None,
    light_share: float | None = None,
) -> Plan:
    """Check the arguments of :func:`render`; raises :class:`LightdomeError` as it does."""
    checks.instance("the distribution", distribution, Distribution)
    resolution, albedo = check_resolution(resolution), checks.albedo(albedo)
    checks.choice("estimator", estimator, ESTIMATORS)
    checks.choice("sequence", sequence, SEQUENCES)
    if checks.flag("mis_compensation", mis_compensation) and estimator != "mis":
        raise LightdomeError(f"MIS compensation needs the estimator 'mis', got {estimator!r}")
    if light_share is not None:
        low, high = np.nextafter(0, 1), np.nextafter(1, 0)
        light_share = checks.real("the light's share", light_share, "a number above 0 and below 1", low, high)
        if estimator != "mis":
            raise LightdomeError(f"a light's share needs the estimator 'mis', got {estimator!r}")
    by_centres = ESTIMATORS[estimator].pixels == "centres"
    if within is not None and checks.choice("place within a pixel", within, WITHIN) == "centre" and not by_centres:
        raise LightdomeError(f"{estimator!r} sees pixels as areas; expected within='pixel', got 'centre'")
    areas = by_centres and within == "pixel"
    return Plan(distribution, resolution, albedo, estimator, areas, sequence, mis_compensation, light_share)


def _images(plan: Plan, spp: Sequence[int], key: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
    device, shape = plan.distribution.device, (plan.resolution, plan.resolution, 3)
    sampler = None
    if not is_black(plan):
        # Allocated first, as the largest: if the device has no room for it, this fails at once.
        total = memory.zeros(device, (2, *shape), np.float32)
        sampler = build_sampler(plan)
    if sampler is None:
        for target in spp:
            yield target, np.zeros(shape, np.float32)
        return
    done = 0
    with Progress("rendering") as progress:
        for target in spp:
            if done and not sampler.continues(done, target):
                del total
                total, done = memory.zeros(device, (2, *shape), np.float32), 0
            while done < target:
                end = min(done + sampler.step, target)
                sampler.add(key, done, end, target, total)
                device.wait()
                done = end
                progress.update(done / spp[-1])
            yield target, sampler.image(device, total, target)


def is_black(plan: Plan) -> bool:
    """Whether the map is black, and so the image."""
    if plan.distribution.total == 0:
        plan.distribution.device.decisions.skip("rendering", "the map is black, and so is the image")
        return True
    return False


def build_sampler(plan: Plan) -> Sampler | None:
    """Build what samples of a map that is not black need; None if none of its light falls on what the camera sees."""
    distribution, resolution = plan.distribution, plan.resolution
    device = distribution.device
    device.decisions.skip(
        "code of other estimators and sequences", f"only {plan.estimator} and {plan.sequence} are built"
    )
    disc = disc_tiles(resolution, 1, 1)
    note_tiles(device.decisions, disc, resolution, 1, 1)
    defines = {f"SEQUENCE_{plan.sequence.upper()}": 1}
    if distribution.map.is_grey:
        device.decisions.skip("separate channels", "the map is grey")
        defines["GREY"] = 1
    else:
        device.decisions.use("separate channels", "the map is in colour")
    kernel = f"rendering/render_{plan.estimator}{'_areas' if plan.areas else ''}"
    if plan.estimator == "product":
        cdfs = build_product_cdfs(distribution, resolution, plan.areas)
        disc = cdfs.lit(device, disc)
        device.decisions.skip("guide tables", "tables of light times cosine are searched instead")
        if len(disc) == 0:
            device.decisions.skip("rendering", "no light of the map falls on what the camera sees")
            return None
        launch = _product_launch(distribution, kernel, cdfs, disc, defines)
        flux, share = 3 * distribution.flux, None
    else:
        launch, flux, share = _launch(distribution, kernel, plan.mis_compensation, plan.light_share, disc, defines)
    step = min(device.items_per_launch(SAMPLES_PER_LAUNCH, len(disc)), SAMPLES_PER_SUM)
    return Sampler(launch, resolution, step, plan.albedo / np.pi * flux, share)


def _launch(
    distribution: Distribution,
    kernel: str,
    mis_compensation: bool,
    light_share: float | None,
    disc: np.ndarray,
    defines: dict[str, int],
) -> tuple[Callable[..., None], float, float | None]:
    """A function that launches ``kernel`` for a range of samples, the flux of R + G + B that it samples, and the share.

    The share is that of the light's samples among a pixel's directions; None for a kernel with light or cosine alone.
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
    share = light_share or (choose_share(distribution, offset, flux) if "n_light" in wanted else None)
    arguments = _of_map(distribution, wanted)
    if "row_cdf" in wanted:
        device.decisions.use("guide tables", "every sample of every pixel searches the map")
        arguments |= cdf.arguments | cdf.guide.arguments
    else:
        device.decisions.skip("guide tables", "directions of the cosine need no search")
    factors = {"offset": offset, "k": np.pi / (flux * of_map.scale)}
    arguments |= {factor: value for factor, value in factors.items() if factor in wanted}
    return _in_blocks(device, kernel, disc, defines, **arguments), flux, share


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
        tile_moments=cdfs.tile_moments,
        cell_cones=cdfs.cell_cones,
        cell_colours=cdfs.cell_colours,
        cells=cdfs.cells,
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
