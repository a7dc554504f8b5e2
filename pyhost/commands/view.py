"""Shows a map, its samples, the sphere and the error on an interactive page in the browser."""

from __future__ import annotations

import shlex
import sys
import webbrowser
from argparse import Namespace
from pathlib import Path

from . import cli


def main() -> None:
    parser = cli.parser(
        "Explore a map, its samples, the sphere and the error in the browser: turn the light, sample, compare.\n\n"
        "This command serves the page until Ctrl-C, by default on this machine only, and only to those who know the"
        " address that it prints. It needs the extra [view].",
        "data/default.exr --no-browser",
    )
    parser.add_argument("maps", type=Path, nargs="*", metavar="MAP", help="environment maps: .exr, .hdr or .pfm")
    cli.map_options(parser)
    parser.add_argument("--port", type=cli.port, default=0, metavar="N", help="port to listen on; 0 for any free port")
    parser.add_argument(
        "--host",
        default="127.0.0.1",
        metavar="ADDRESS",
        help="address to listen on; any but the default opens the page to the network, without encryption",
    )
    parser.add_argument("--no-browser", action="store_true", help="only print the address; do not open a browser")
    cli.device_option(parser)
    args = parser.parse_args()

    from ..viewer.notebook import server_class

    server_of = server_class()
    paths = args.maps or [args.map]
    maps = []
    for path in paths:
        of_map = Namespace(**{**vars(args), "map": path})
        words = shlex.join(map(str, cli.map_arguments(of_map)[1:]))
        maps.append((path.stem, words, cli.load_map(of_map)))
    server = server_of(cli.open_device(args), maps, args.host, args.port)

    from ..viewer.server import is_loopback

    if not is_loopback(args.host):
        print(
            f"warning: {args.host} can be reached from the network; anyone who has the address can use this page, and"
            " nothing is encrypted",
            file=sys.stderr,
        )
    print(f"open {server.url}")
    if not args.no_browser:
        webbrowser.open(server.url)
    server.wait()
