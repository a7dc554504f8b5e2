"""Turns the light in ``lightdome view`` for thousands of frames, to see whether they are fast and memory stays flat.

    python tests/tools/soak_view.py --frames 10000

Needs Chromium and the extras [view] and [test]. Prints the memory of the server and of the page after each tenth of the
frames, the time between pictures, and the latency from input to picture with its parts.
"""

from __future__ import annotations

import argparse
import gc
import os
import shutil
import sys
from pathlib import Path

import lightdome
import numpy as np
from lightdome.viewer.server import Server
from playwright.sync_api import Page, sync_playwright

# Runs in the page: drags a pointer over the sphere, one step per screen refresh.
DRAG = """async (count) => {
  const view = document.getElementById("sphere-view"), box = view.getBoundingClientRect(), { frames } = lightdomeView;
  const send = (kind, n) => view.dispatchEvent(new PointerEvent(kind, { pointerId: 1, button: 0, bubbles: true,
    clientX: box.left + 100 + 70 * Math.sin(n / 20), clientY: box.top + 100 + 40 * Math.sin(n / 31) }));
  view.setPointerCapture = () => {};
  const times = [];
  let seen = null;
  send("pointerdown", 0);
  for (let n = 1; times.length < count; n++) {
    send("pointermove", n);
    await new Promise(requestAnimationFrame);
    const last = frames[frames.length - 1];
    if (last && last !== seen && last.setting.moving) {
      seen = last;
      times.push([last.drawn, last.moved, last.asked, last.arrived, last.server]);
    }
  }
  send("pointerup", 0);
  return times;
}"""


def settled(page: Page) -> None:
    while not page.evaluate("lightdomeView.isSettled"):
        page.wait_for_timeout(50)


def memory(page: Page) -> str:
    """The memory of this process, which runs the server, and of the page's JavaScript, in MB."""
    gc.collect()
    resident = next(
        int(line.split()[1]) / 1024
        for line in Path("/proc/self/status").read_text().splitlines()
        if line.startswith("VmRSS")
    )
    session = page.context.new_cdp_session(page)
    session.send("HeapProfiler.collectGarbage")
    heap = session.send("Runtime.getHeapUsage")["usedSize"] / 2**20
    session.detach()
    return f"server {resident:.0f} MB, page {heap:.1f} MB"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--map", default=str(lightdome.default_map()))
    parser.add_argument("--frames", type=int, default=10000)
    parser.add_argument("--resolution", type=int, default=511)
    args = parser.parse_args()
    envmap = lightdome.EnvironmentMap.read(args.map)
    server = Server(lightdome.open_device(), [("map", args.map, envmap)])
    chromium = shutil.which("chromium") or sys.exit("chromium is not installed")
    with sync_playwright() as started:
        browser = started.chromium.launch(
            executable_path=chromium, args=["--no-sandbox", "--enable-unsafe-swiftshader"]
        )
        page = browser.new_page(viewport={"width": 1280, "height": 900})
        page.goto(f"{server.url}#resolution={args.resolution}")
        settled(page)
        print(f"load {os.getloadavg()[0]:.1f}; at the start: {memory(page)}")
        times = []
        part = max(1, args.frames // 10)
        for done in range(part, args.frames + 1, part):
            times.append(np.array(page.evaluate(DRAG, part)))
            settled(page)
            print(f"{done} frames: {memory(page)}", flush=True)
        print(f"load {os.getloadavg()[0]:.1f}")
        told = {"between pictures": np.concatenate([np.diff(of_part[:, 0]) for of_part in times])}
        drawn, moved, asked, arrived, computed = np.concatenate(times).T
        told |= {
            "input to picture": drawn - moved,
            "computing": computed,
            "transfer": arrived - asked - computed,
            "drawing": drawn - arrived,
        }
        for name, milliseconds in told.items():
            median, slow = np.percentile(milliseconds, [50, 95])
            print(f"{name:17} median {median:6.1f} ms, 95th percentile {slow:6.1f} ms")
        browser.close()
    server.close()


if __name__ == "__main__":
    main()
