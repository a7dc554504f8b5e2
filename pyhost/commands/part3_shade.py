"""Part 3: shade a diffuse sphere with the samples of part 2."""

from __future__ import annotations

import json
import math
from pathlib import Path

from ..errors import LightdomeError
from . import cli


def recorded_exposure(path: Path, albedo: float) -> float | None:
    """The exposure of a sphere of ``albedo`` under the map of the samples in ``path``; None if it is not known.

    :mod:`.part2_sample`, which has the map, records the exposure of a white sphere beside the samples.
    """
    from . import settings

    try:
        content = json.loads((path.parent / settings.NAME).read_text(encoding="utf-8"))
        if content["files"][path.name] != settings.file_sum(path):
            return None
        exposure = float(content["sphere_exposure"]) / albedo
    except (OSError, ValueError, LookupError, TypeError, ZeroDivisionError):
        return None
    return exposure if 0 < exposure < math.inf else None


def main() -> None:
    parser = cli.parser(
        "Shade a diffuse sphere with sets of light samples, each set shared by all pixels.\n\n"
        "Writes sphere_N.pfm (linear radiance), sphere_N.ppm and sphere_N.png, or the formats of --format, for a set of"
        " N samples. settings.json records how they were made.",
        "out/part2/samples_*.npz",
        "out/part3",
    )
    parser.add_argument(
        "samples", type=Path, nargs="+", metavar="SAMPLES.npz", help="files that lightdome sample wrote"
    )
    cli.sphere_options(parser)
    cli.image_options(parser)
    cli.display_option(parser)
    cli.device_option(parser)
    cli.explain_option(parser)
    args = parser.parse_args()

    from ..sampling.samples import Samples

    sets: dict[int, tuple[Path, Samples]] = {}
    for path in args.samples:
        samples = Samples.load(path)
        if len(samples) in sets:
            raise LightdomeError(f"{path}: another file has {len(samples)} samples too; shade it into its own --out")
        sets[len(samples)] = path, samples
    out = cli.output_folder(args.out, images=True)

    from ..lighting.shade import shade_samples
    from ..maps.images import auto_exposure, tone_map
    from . import settings

    device = cli.open_device(args)
    exposure, lines, names = args.exposure or recorded_exposure(sets[max(sets)][0], args.albedo), [], []
    # The largest set first: if no exposure is recorded, its image gives the best estimate, which serves all sets.
    for count, (_, samples) in sorted(sets.items(), reverse=True):
        image = shade_samples(device, samples, args.resolution, args.albedo)
        exposure = exposure or auto_exposure(image)
        for pixels in image, tone_map(image, exposure, args.gamma):
            names += cli.write_images(args, out / f"sphere_{count}", pixels)
        lines.append((f"wrote {out}/sphere_{count}{cli.formats(args)}", count, device.decisions.take()))
    assert exposure is not None  # there is at least one set
    for line, count, decisions in reversed(lines):
        print(line)
        cli.explain(args, f"{count} samples", decisions)
    inputs = {path.name: settings.file_sum(path) for path in args.samples}
    settings.write(out, settings.settings(device, None, vars(args)) | {"inputs": inputs}, names)
    print(cli.tone(args, exposure))
    cli.explain_kernels(args, device)
