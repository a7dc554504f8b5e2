"""Part 3: shade a diffuse sphere with the samples of part 2."""

from __future__ import annotations

from pathlib import Path

from ..errors import LightdomeError
from . import cli


def main() -> None:
    parser = cli.parser(
        "Shade a diffuse sphere with sets of light samples, each set shared by all pixels.\n\n"
        "Writes sphere_N.pfm (linear radiance), sphere_N.ppm and sphere_N.png for a set of N samples."
        " settings.json says what made them.",
        "out/part2/samples_*.npz",
        "out/part3",
    )
    parser.add_argument("samples", type=Path, nargs="+", metavar="SAMPLES.npz", help="files that part 2 wrote")
    cli.sphere_options(parser)
    cli.tone_options(parser)
    cli.device_option(parser)
    cli.explain_option(parser)
    args = parser.parse_args()

    from ..sampling.samples import Samples

    sets: dict[int, Samples] = {}
    for path in args.samples:
        samples = Samples.load(path)
        if len(samples) in sets:
            raise LightdomeError(f"{path}: another file has {len(samples)} samples too; shade it into its own --out")
        sets[len(samples)] = samples
    out = cli.output_folder(args.out, images=True)

    from ..lighting.shade import shade_samples
    from ..maps.images import auto_exposure, tone_map, write_image
    from . import settings

    device = cli.open_device(args)
    exposure, lines = args.exposure, []
    # The largest set first: it knows best how bright the sphere is, and one exposure serves all.
    for count, samples in sorted(sets.items(), reverse=True):
        image = shade_samples(device, samples, args.resolution, args.albedo)
        exposure = exposure or auto_exposure(image)
        write_image(out / f"sphere_{count}.pfm", image)
        picture = tone_map(image, exposure, args.gamma)
        for suffix in ("ppm", "png"):
            write_image(out / f"sphere_{count}.{suffix}", picture)
        lines.append((f"wrote {out}/sphere_{count}.pfm, .ppm, .png", count, device.decisions.take()))
    for line, count, decisions in reversed(lines):
        print(line)
        cli.explain(args, f"{count} samples", decisions)
    names = [f"sphere_{count}.{suffix}" for count in sets for suffix in ("pfm", "ppm", "png")]
    inputs = {path.name: settings.file_sum(path) for path in args.samples}
    settings.write(out, settings.settings(device, None, vars(args)) | {"inputs": inputs}, names)
    print(cli.tone(args, exposure))
    cli.explain_kernels(args, device)
