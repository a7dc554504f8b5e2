"""Turn a map into a few lights, in a file for another program."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import LightdomeError
from ..names import LIGHT_FORMATS, LIGHT_METHODS, SEED
from . import cli

if TYPE_CHECKING:
    from ..lighting.lights import Lights
    from ..maps.envmap import EnvironmentMap
    from ..opencl.device import Device


def main() -> None:
    parser = cli.parser(
        "Turn a map into a few directional lights, as a file for another program.\n\n"
        "median-cut gives lights of equal energy and is best for small counts; sun+median-cut makes the sun one light"
        " and cuts the rest; the other methods draw samples. Together the lights have the map's flux. The head of the"
        " file states axes and units.",
        "map.exr --count 16 --out lights.py",
    )
    cli.map_options(parser, positional=True)
    parser.add_argument("--method", choices=LIGHT_METHODS, default="median-cut", help="how lights are made")
    parser.add_argument("--count", type=cli.positive_int, default=16, metavar="N", help="number of lights")
    parser.add_argument("--seed", type=cli.seed, default=SEED, help="seed of the methods that draw samples")
    parser.add_argument(
        "--format",
        choices=LIGHT_FORMATS,
        help="the program that will read the file"
        f" (default: by the suffix, {', '.join(f'{s} {n}' for n, s in LIGHT_FORMATS.items())})",
    )
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="file to write")
    cli.explain_option(parser)
    cli.device_option(parser)
    args = parser.parse_args()

    from ..lighting.light_files import light_format, write_lights

    name = light_format(args.out, args.format)
    cli.output_file(args.out)
    envmap = cli.load_map(args)
    device = cli.open_device(args)
    lights = make(device, envmap, args.method, args.count, args.seed)
    cli.explain(args, f"{len(lights)} lights", device.decisions.take())
    cli.explain_kernels(args, device)
    write_lights(args.out, lights, name)
    print(f"wrote {args.out}: {len(lights)} light{'s' if len(lights) > 1 else ''} by {args.method}, as {name}")


def make(device: Device, envmap: EnvironmentMap, method: str, count: int, seed: int) -> Lights:
    """``count`` lights from the map; raises :class:`LightdomeError` if fewer of its pixels have light."""
    from ..lighting.lights import Lights
    from ..sampling.distribution import build_distribution

    if method == "median-cut":
        return cut(device, envmap, count)
    if method == "sun+median-cut":
        return sun_and_cut(device, envmap, count)
    return Lights.of(build_distribution(device, envmap).sample(count, seed=seed, sequence=method))


def sun_and_cut(device: Device, envmap: EnvironmentMap, count: int) -> Lights:
    """The sun as the first light, and the rest of the map by median cut."""
    import numpy as np

    from ..lighting.lights import Lights
    from ..maps.analysis import split_sun

    if count == 1:
        raise LightdomeError("sun+median-cut needs a --count of at least 2: the sun and the rest of the map")
    split = split_sun(envmap)
    if split.rest.peak == 0:
        raise LightdomeError("the map has no light but the sun; use --method median-cut")
    rest = cut(device, split.rest, count - 1)
    direction = np.array([split.sun.direction_xyz, *rest.direction])
    return Lights(direction, np.array([split.sun.flux_rgb_radiance_sr, *rest.flux]))


def cut(device: Device, envmap: EnvironmentMap, count: int) -> Lights:
    """``count`` lights of equal energy."""
    from ..lighting.median_cut import median_cut
    from ..sampling.distribution import build_distribution

    lights = median_cut(build_distribution(device, envmap), count)
    if len(lights) < count:
        raise LightdomeError(
            f"only {len(lights)} of the map's pixels have light, too few for {count} lights; lower --count"
        )
    return lights
