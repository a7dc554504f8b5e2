"""A page in the browser that shows a map, its samples, the sphere and the error as the user turns the light."""

from __future__ import annotations

import shlex
import sys
import webbrowser
from argparse import Namespace
from pathlib import Path

from . import cli


def main() -> None:
    parser = cli.parser(
        "Look at a map, its samples, the sphere and the error in the browser, turn the light, and compare methods.\n\n"
        "This command serves the page until Ctrl-C, to this machine only, and only at the address that it prints. It"
        " needs the extra [view].",
        "data/default.exr --no-browser",
    )
    parser.add_argument("maps", type=Path, nargs="*", metavar="MAP", help="environment maps: .exr, .hdr or .pfm")
    cli.map_options(parser)
    parser.add_argument("--port", type=_port, default=0, metavar="N", help="port to listen at, 0 for any that is free")
    parser.add_argument(
        "--host",
        default="127.0.0.1",
        metavar="ADDRESS",
        help="address to listen at; any other than the default opens the page to the network, without encryption",
    )
    parser.add_argument("--no-browser", action="store_true", help="print the address, but open no browser")
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
            f"warning: {args.host} can be reached from the network; whoever has the address can use this page, and"
            " nothing is encrypted",
            file=sys.stderr,
        )
    print(f"open {server.url}")
    if not args.no_browser:
        webbrowser.open(server.url)
    server.wait()


def _port(text: str) -> int:
    """Argument type: a number of a port."""
    return int(cli._number(int, text, lambda v: 0 <= v <= 65535, "a whole number from 0 to 65535"))
