"""Stability: how samplers cope with maps that break samplers, measured against float64."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from contextlib import ExitStack
from typing import TYPE_CHECKING

from . import cli

if TYPE_CHECKING:
    from ..evaluation.stability import Case

DRAWS, QUICK_DRAWS = 10_000_000, 200_000


def main() -> None:
    parser = cli.parser(
        "Check probabilities, sums, CDFs, draws and images on maps that break samplers, against float64.\n\n"
        "Writes stability.csv, stability.json and stability.png; exits with 1 if a case fails.",
        "--quick",
        "out/stability",
    )
    parser.add_argument(
        "--quick", action="store_true", help="no large cases, and fewer draws: under a minute on two cores"
    )
    parser.add_argument(
        "--peers", nargs="+", choices=["mitsuba"], default=[], help="other programs to measure too (default: none)"
    )
    cli.device_option(parser)
    run(parser.parse_args())


def run(args: argparse.Namespace, cases: Sequence[Case] | None = None, draws: int | None = None) -> None:
    """Measure; tests pass few ``cases`` and ``draws``."""
    out = cli.output_folder(args.out)

    from ..errors import LightdomeError
    from ..evaluation import peer_mitsuba_distribution, stability, stability_plot
    from ..evaluation.stability_cases import CASES
    from ..plotting import save_figure
    from ..progress import Progress
    from .settings import settings

    device = cli.open_device(args)
    draws = draws or (QUICK_DRAWS if args.quick else DRAWS)
    cases = [case for case in cases or CASES if not (args.quick and case.large)]
    results, about, absent = [], {}, {}
    with ExitStack() as stack, Progress("stability") as progress:
        mitsuba = None
        if args.peers:
            try:
                mitsuba = stack.enter_context(peer_mitsuba_distribution.start())
                about["mitsuba"] = mitsuba.about
            except LightdomeError as error:
                absent["mitsuba"] = str(error)
        for done, case in enumerate(cases):
            results.append(stability.run(case, device, draws))
            if mitsuba and case.maps and not results[-1].skipped:
                results.append(stability.run_peer(case, "mitsuba", mitsuba.sampler, draws))
            progress.update((done + 1) / len(cases))

    for result in results:
        print(f"{result.verdict:<9}{result.program:<11}{result.group}: {result.case}", end="")
        print(f" ({result.remark})" if result.remark else "")
    for name, reason in absent.items():
        print(f"peer {name}: absent ({reason})")

    made_with = settings(device, None, vars(args) | {"draws": draws}) | {"peers": about, "absent": absent}
    stability.write_stability_csv(out / "stability.csv", results)
    stability.write_stability_json(out / "stability.json", results, made_with)
    save_figure(
        stability_plot.table(results, f"Stability, {draws:,} draws per case, {device.hardware}"),
        out / "stability.png",
    )
    print(f"\nwrote {out}/stability.csv, stability.json, stability.png")

    own = [result for result in results if result.judged]
    failed = sum(result.verdict == "FAILS" for result in own)
    skipped = sum(result.verdict == "skipped" for result in own)
    print(f"{len(own) - failed - skipped} cases hold, {failed} fail, {skipped} skipped")
    if failed:
        raise LightdomeError(f"{failed} of {len(own)} cases fail; {out}/stability.csv says which and by how much")
