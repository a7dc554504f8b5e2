"""Part 1: Fresnel reflectance of a dielectric in air, and how close Schlick's approximation comes."""

from __future__ import annotations

import argparse
from dataclasses import asdict

from .. import __version__
from ..errors import exactly
from ..files import write_json
from ..fresnel.equations import Summary, summarise
from . import cli, settings


def parse_arguments() -> argparse.Namespace:
    """The command line."""
    parser = cli.parser(
        "Plot the Fresnel reflectance of a dielectric in air, beside Schlick's approximation.\n\n"
        "The angle of incidence runs from 0 to 90 degrees, for light that enters the material and for light that"
        " leaves it. Writes plots as .png and .svg, and the characteristic values to fresnel.json: angles in degrees,"
        " reflectances as fractions of the incident power. Needs no OpenCL device.",
        example="--eta 1.5 --out out/glass",
        out="out/part1",
    )
    parser.add_argument(
        "--eta", type=cli.positive_float, default=1.4, metavar="N", help="refractive index of the material, air being 1"
    )
    return parser.parse_args()


def describe(summary: Summary) -> str:
    """The summary as a few lines of text."""

    def angle(value: float | None) -> str:
        return "none" if value is None else f"{value:.6g}"

    return "\n".join(
        [
            f"eta {exactly(summary.eta)}, angles of incidence in degrees",
            f"  normal incidence   R_p = {summary.normal_reflectance_p:.5g}, R_s = {summary.normal_reflectance_s:.5g}",
            f"  Brewster's angle   {angle(summary.brewster_entering_deg)} entering, "
            f"{angle(summary.brewster_leaving_deg)} leaving",
            f"  critical angle     {angle(summary.critical_entering_deg)} entering, "
            f"{angle(summary.critical_leaving_deg)} leaving",
            f"  Schlick            R0 = {summary.schlick_r0:.5g}; largest absolute error",
            f"                     {summary.schlick_entering_max_abs_error:.4g} at "
            f"{summary.schlick_entering_max_abs_error_at_deg:.4g} entering, "
            f"{summary.schlick_leaving_max_abs_error:.4g} at "
            f"{summary.schlick_leaving_max_abs_error_at_deg:.4g} leaving",
        ]
    )


def main() -> None:
    """Write the plots and fresnel.json, and list what was written."""
    arguments = parse_arguments()
    out = cli.output_folder(arguments.out)
    # Matplotlib takes most of a second to load, so the command line is checked first.
    from ..fresnel.plot import fresnel_figure, save, schlick_figure

    summary = summarise(arguments.eta)
    written = [out / "fresnel.json"]
    write_json(written[0], {"version": __version__, **asdict(summary)})

    air, material = (1.0, "air"), (arguments.eta, "material")
    for direction, (n_i, from_name), (n_t, to_name) in (
        ("entering", air, material),
        ("leaving", material, air),
    ):
        sides = (n_i, n_t, from_name, to_name)
        written += save(fresnel_figure(*sides), out / f"fresnel_{direction}")
        written += save(schlick_figure(*sides), out / f"schlick_{direction}")

    settings.write(out, settings.settings(None, None, vars(arguments)), [path.name for path in written])
    written.append(out / settings.NAME)
    print(describe(summary))
    print(f"wrote to {out}: {', '.join(path.name for path in written)}")
