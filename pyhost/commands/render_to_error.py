"""The options ``--error``, ``--time`` and ``--auto`` of ``lightdome render``: until the error is small enough."""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from . import cli

if TYPE_CHECKING:
    from ..evaluation.choice import CheapestImage
    from ..maps.envmap import EnvironmentMap
    from ..rendering.to_error import Rendered
    from ..sampling.distribution import Distribution

SHOWN = 3  # methods that --auto mentions


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument(
        "--error",
        type=cli.error,
        metavar="ERROR",
        help="instead of --spp: render until the upper end of the relative RMSE's 95%% interval is at most this, such"
        " as 1%% or 0.01 (default: none)",
    )
    parser.add_argument(
        "--time",
        type=cli.seconds,
        metavar="SECONDS",
        help="with --error: stop after about this time, such as 10s or 500ms (default: none)",
    )
    parser.add_argument(
        "--auto",
        action="store_true",
        help="with --error: measure which method reaches the error in the least time, and use it; it may be the exact"
        " image. Not with --estimator, --sequence or --time",
    )


def check(parser: argparse.ArgumentParser, args: argparse.Namespace) -> None:
    """Refuse what does not go together, and fill in defaults."""
    if not args.error:
        for name in ("time", "auto"):
            if getattr(args, name):
                parser.error(f"--{name} needs --error")
        return
    if args.spp:
        parser.error("--error takes as many samples as it needs; leave out --spp")
    if args.renderer == "pbrt" or args.pbrt:
        parser.error("--error is for --renderer opencl")
    if args.light_share:
        parser.error("--error leaves the share of light samples to the map; leave out --light-share")
    args.renderer = "opencl"
    if args.auto:
        for name in ("estimator", "sequence", "time"):
            if getattr(args, name):
                parser.error(f"--auto chooses the method; leave out --{name}")
    else:
        args.estimator, args.sequence = args.estimator or "product", args.sequence or "lattice"


def run(args: argparse.Namespace, out: Path, envmap: EnvironmentMap) -> None:
    """Render, write the image and its error, and say what was reached."""
    from ..maps.images import tone_map
    from ..maps.sphere import sphere_exposure
    from ..sampling.distribution import build_distribution
    from . import settings

    device = cli.open_device(args)
    print(f"map: {args.map}, {envmap.width} x {envmap.height}")
    distribution = build_distribution(device, envmap)
    cli.explain(args, "the map", device.decisions.take())
    found, reached = _automatic(args, distribution) if args.auto else _rendered(args, distribution)
    cli.explain(args, "the image", device.decisions.take())
    exposure = args.exposure or sphere_exposure(envmap, args.albedo)
    names = cli.write_images(args, out / "sphere", found.image)
    names += cli.write_images(args, out / "sphere", tone_map(found.image, exposure, args.gamma))
    names += _write_error(args, out, found)
    settings.write(out, settings.settings(device, envmap, vars(args)) | {"reached": reached}, names)
    print(f"wrote {out}: {', '.join(names)}")
    print(cli.tone(args, exposure))
    cli.explain_kernels(args, device)


def _percent(*values: float) -> str:
    return " to ".join(f"{100 * value:.3g}" for value in values) + " %"


def _reason(args: argparse.Namespace, found: Rendered | CheapestImage) -> str:
    """Why samples per pixel ended."""
    may_be_above = f"but the error may be above {100 * args.error:.10g} %"
    return {
        "error": f"the error is at most {100 * args.error:.10g} %",
        "time": f"the time is up, {may_be_above}",
        "limit": f"no more samples are taken, {may_be_above}",
        "light": "the samples have missed light of the map",
    }[found.reason or "error"]


def _rendered(args: argparse.Namespace, distribution: Distribution) -> tuple[Rendered, dict[str, Any]]:
    """Samples per pixel, as many as are needed."""
    from ..evaluation.choice import shown
    from ..rendering.to_error import render_to_error

    found = render_to_error(
        distribution,
        args.error,
        args.time,
        args.resolution,
        args.albedo,
        args.seed,
        args.estimator,
        args.sequence,
        within=args.within,
    )
    if found.reason == "error" and not found.image.any():
        print("the image is black")
    else:
        print(f"stopped after {found.spp} spp and {shown(found.seconds)}: {_reason(args, found)}")
        if found.reason == "light":
            print("error: unknown: the image is darker than it must be")
        elif math.isfinite(found.interval[1]):
            print(f"error: {_percent(found.rmse)}, 95 % interval {_percent(*found.interval)} (estimated from 4 images)")
        else:
            print("error: unknown: the noise is larger than the image")
    if args.estimator == "bsdf":
        print(
            "note: the estimate does not include light that no sample has hit, such as a small sun; --estimator product"
            " finds it",
            file=sys.stderr,
        )
    return found, {"reason": found.reason, "spp": found.spp, **_numbers(found)}


def _automatic(args: argparse.Namespace, distribution: Distribution) -> tuple[CheapestImage, dict[str, Any]]:
    """The cheapest method, and why it is that."""
    from ..evaluation.choice import render_cheapest, shown

    found = render_cheapest(distribution, args.error, args.resolution, args.albedo, args.seed, args.within)
    best, *others = found.choices
    print(f"chosen: {best}")
    for other in others[: SHOWN - 1]:
        print(f"slower: {other}")
    if best.method != "exact" and "exact" not in (other.method for other in others[: SHOWN - 1]):
        print(f"slower: {next(other for other in others if other.method == 'exact')}")
    how = "estimated" if found.interval else "known" if best.method == "exact" else "measured on a small image"
    error = _percent(found.rmse) if math.isfinite(found.rmse) else "unknown"
    print(f"rendered in {shown(found.seconds)}, error: {error} ({how})")
    if found.reason:
        print(f"stopped: {_reason(args, found)}")
    chosen = {"method": best.method, "count": best.count, "reason": found.reason}
    return found, {**chosen, "others": [str(other) for other in others], **_numbers(found)}


def _numbers(found: Rendered | CheapestImage) -> dict[str, Any]:
    """What JSON can hold: null in place of infinity."""
    return {
        "relative_rmse": found.rmse if math.isfinite(found.rmse) else None,
        "interval": found.interval and [end if math.isfinite(end) else None for end in found.interval],
        "seconds": found.seconds,
    }


def _write_error(args: argparse.Namespace, out: Path, found: Rendered | CheapestImage) -> list[str]:
    """Write the error of each pixel, as radiance and in false colour, in the formats of ``--format``."""
    import numpy as np

    names = cli.write_images(args, out / "error", np.repeat(found.error[..., None], 3, axis=2))
    if "png" in args.format:
        from ..evaluation.error_plot import error_figure
        from ..plotting import save_figure

        save_figure(error_figure(found.error, found.rmse), out / "error.png")
        names.append("error.png")
    if not names:
        print("note: the image of the error is written as pfm, exr or png; see --format", file=sys.stderr)
    return names
