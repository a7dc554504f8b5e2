"""The page in a browser: each control changes what it should, and the page's numbers match the library's."""

from __future__ import annotations

import json
import math
import shutil
import time
from base64 import b64decode
from collections.abc import Callable, Iterator
from pathlib import Path
from urllib.parse import urlencode

import numpy as np
import pytest
from lightdome.evaluation.metrics import pareto_front, relative_rmse
from lightdome.fresnel import summarise
from lightdome.lighting.exact import exact
from lightdome.lighting.harmonics import project, shade_harmonics
from lightdome.lighting.lights import Lights
from lightdome.lighting.median_cut import median_cut
from lightdome.lighting.shade import shade
from lightdome.maps.envmap import EnvironmentMap
from lightdome.maps.images import tone_map, write_image
from lightdome.maps.rotation import rotation_matrix
from lightdome.names import SEED
from lightdome.opencl.device import Device
from lightdome.rendering.per_pixel import render
from lightdome.sampling.distribution import build_distribution

playwright = pytest.importorskip("playwright.sync_api", reason="needs playwright, of the extra [dev]")
pytest.importorskip("starlette", reason="needs the extra [view]")
pytest.importorskip("uvicorn", reason="needs the extra [view]")
pytest.importorskip("websockets", reason="needs the extra [view]")

from lightdome.viewer.server import Server  # noqa: E402

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
SECONDS = 60  # to wait for a picture, even on a slow, shared machine
RESOLUTION = 63
WINDOW = {"width": 1300, "height": 900}

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium: apt-get install chromium"),
]


@pytest.fixture(scope="module")
def envmap() -> EnvironmentMap:
    rng = np.random.default_rng(3)
    radiance = rng.gamma(0.3, 1, (32, 64, 3)).astype(np.float32)
    radiance[8:11, 20:24] = (60, 50, 30)
    return EnvironmentMap(radiance)


@pytest.fixture(scope="module")
def server(device: Device, envmap: EnvironmentMap) -> Iterator[Server]:
    opened = Server(device, [("first", "first.exr", envmap), ("second", "second.exr", envmap.mirrored())])
    yield opened
    opened.close()


@pytest.fixture(scope="module")
def browser() -> Iterator[playwright.Browser]:
    with playwright.sync_playwright() as started:
        arguments = ["--no-sandbox", "--enable-unsafe-swiftshader"]
        opened = started.chromium.launch(executable_path=CHROMIUM, args=arguments)
        yield opened
        opened.close()


@pytest.fixture(scope="module")
def errors() -> list[str]:
    """What pages have reported during a test."""
    return []


@pytest.fixture(scope="module")
def context(browser: playwright.Browser, errors: list[str]) -> playwright.BrowserContext:
    opened = browser.new_context(viewport=WINDOW, accept_downloads=True)
    opened.on("weberror", lambda error: errors.append(str(error.error)))
    opened.on("console", lambda message: errors.append(message.text) if is_error(message) else None)
    return opened


Open = Callable[..., "playwright.Page"]


@pytest.fixture
def open_page(server: Server, context: playwright.BrowserContext, errors: list[str]) -> Iterator[Open]:
    """Open the page in a state, in the tab of the test before. Any error that it reports fails the test."""
    idle = context.pages

    def opened(**state: object) -> playwright.Page:
        page = idle.pop() if idle else context.new_page()
        page.goto(f"{server.url}#{urlencode({'resolution': RESOLUTION, **state})}")
        settled(page)
        return page

    yield opened
    for page in context.pages:
        page.evaluate("0")  # an error on its way arrives first
    said = errors.copy()
    for page in context.pages[1:]:
        page.close()
    for page in context.pages:
        page.goto("about:blank")
        page.set_viewport_size(WINDOW)
    errors.clear()
    assert said == []


def is_error(message: playwright.ConsoleMessage) -> bool:
    """Whether a console message is an error. Chromium also reports refused files (status 422), which are expected."""
    return message.type == "error" and "422" not in message.text


def until(page: playwright.Page, expression: str) -> None:
    """Wait until a JavaScript expression is true; the page's policy blocks Playwright's own wait."""
    end = time.monotonic() + SECONDS
    while not page.evaluate(expression):
        assert time.monotonic() < end, expression
        page.wait_for_timeout(20)


def settled(page: playwright.Page) -> None:
    """Wait until the page shows the exact image for its state."""
    until(page, "lightdomeView.isSettled")


def rmse(page: playwright.Page) -> float:
    settled(page)
    return page.evaluate("lightdomeView.numbers.rmse")


def enter(page: playwright.Page, name: str, value: object) -> None:
    """Type a value into a field, as a user does."""
    page.fill(f"#{name}", str(value))
    page.press(f"#{name}", "Enter")
    settled(page)


def shared(
    device: Device, envmap: EnvironmentMap, count: int = 256, seed: int = SEED, sequence: str = "sobol"
) -> Lights:
    return Lights.of(build_distribution(device, envmap).sample(count, seed, sequence))


def test_numbers_and_controls_match_the_library(open_page: Open, device: Device, envmap: EnvironmentMap) -> None:
    page = open_page()
    truth = exact(device, envmap, RESOLUTION)

    def of(lights: Lights) -> float:
        return relative_rmse(shade(device, lights, resolution=RESOLUTION), truth)

    assert rmse(page) == pytest.approx(of(shared(device, envmap)), rel=1e-5)
    image = shade(device, shared(device, envmap), resolution=RESOLUTION)
    assert page.evaluate("lightdomeView.numbers.largest") == pytest.approx(np.abs(image - truth).max(), rel=1e-4)
    enter(page, "count", 64)
    assert rmse(page) == pytest.approx(of(shared(device, envmap, 64)), rel=1e-5)
    enter(page, "seed", 5)
    assert rmse(page) == pytest.approx(of(shared(device, envmap, 64, 5)), rel=1e-5)
    page.select_option("#sequence", "independent")
    assert rmse(page) == pytest.approx(of(shared(device, envmap, 64, 5, "independent")), rel=1e-5)
    page.select_option("#method", "median-cut")
    assert rmse(page) == pytest.approx(of(median_cut(build_distribution(device, envmap), 64)), rel=1e-5)
    page.select_option("#method", "harmonics")
    enter(page, "count", 4)
    image = shade_harmonics(device, project(device, envmap, 4), RESOLUTION)
    assert rmse(page) == pytest.approx(relative_rmse(image, truth), rel=1e-4)


@pytest.mark.parametrize("method", ["light", "bsdf", "mis", "product"])
def test_estimators_match_the_library(open_page: Open, device: Device, envmap: EnvironmentMap, method: str) -> None:
    page = open_page(method=method, sequence="sobol", count=8, seed=2, yaw=20, pitch=10)
    turned = envmap.rotated(20, 10)
    pixels = "centres" if method in ("light", "product") else "areas"
    truth = exact(device, turned, RESOLUTION, pixels=pixels)
    ((_, image),) = render(build_distribution(device, turned), [8], RESOLUTION, 1.0, 2, method, "sobol")
    assert rmse(page) == pytest.approx(relative_rmse(image, truth), rel=1e-5)


def test_albedo_and_resolution(open_page: Open, device: Device, envmap: EnvironmentMap) -> None:
    page = open_page()
    before = page.evaluate("lightdomeView.numbers")
    enter(page, "albedo", 0.5)
    now = page.evaluate("lightdomeView.numbers")
    assert now["brightest"] == pytest.approx(0.5 * before["brightest"], rel=1e-6)
    assert now["rmse"] == pytest.approx(before["rmse"], rel=1e-4)
    enter(page, "resolution", 40)
    image = shade(device, shared(device, envmap), resolution=40)
    assert rmse(page) == pytest.approx(relative_rmse(image, exact(device, envmap, 40)), rel=1e-5)


def test_another_map(open_page: Open, device: Device, envmap: EnvironmentMap) -> None:
    page = open_page()
    page.select_option("#map", "1")
    other = envmap.mirrored()
    image = shade(device, shared(device, other), resolution=RESOLUTION)
    assert rmse(page) == pytest.approx(relative_rmse(image, exact(device, other, RESOLUTION)), rel=1e-5)
    until(page, "document.getElementById('map-name').textContent.startsWith('second')")


def drag(page: playwright.Page, view: str, right: float, down: float = 0.0) -> None:
    box = page.locator(view).bounding_box()
    x, y = box["x"] + 0.15 * box["width"], box["y"] + 0.4 * box["height"]
    page.mouse.move(x, y)
    page.mouse.down()
    for step in range(1, 6):
        page.mouse.move(x + right * step / 5, y + down * step / 5)
    page.mouse.up()
    settled(page)


@pytest.mark.parametrize(("view", "right", "down"), [("#map-canvas", 90, 0), ("#sphere-canvas", 40, 25)])
def test_dragging_turns_the_light_as_rotated_does(
    open_page: Open, device: Device, envmap: EnvironmentMap, view: str, right: float, down: float
) -> None:
    """The page shows the map's samples, turned, and the exact image of the turned map."""
    page = open_page()
    drag(page, view, right, down)
    angles = page.evaluate("[lightdomeView.state.yaw, lightdomeView.state.pitch, lightdomeView.state.roll]")
    assert angles[0] != 0
    assert (angles[1] != 0) == (down != 0)
    lights = shared(device, envmap).rotated(*angles)
    image = shade(device, lights, resolution=RESOLUTION)
    seen = page.evaluate("Array.from(lightdomeView.images.image.data)")
    np.testing.assert_array_equal(np.array(seen, np.float32).reshape(image.shape), image)
    # Resampling the turned map changes its light a little; a turn by whole columns does not change it at all.
    reference = np.array(page.evaluate("Array.from(lightdomeView.images.reference.data)")).reshape(image.shape)
    assert relative_rmse(reference, exact(device, envmap.rotated(*angles), RESOLUTION)) < 0.02
    columns = round(angles[0] / 360 * envmap.width) * 360 / envmap.width
    enter(page, "yaw", columns)
    enter(page, "pitch", 0)
    enter(page, "roll", 0)
    reference = np.array(page.evaluate("Array.from(lightdomeView.images.reference.data)")).reshape(image.shape)
    assert relative_rmse(reference, exact(device, envmap.rotated(columns), RESOLUTION)) < 1e-6


def test_what_is_dragged_follows_the_pointer(open_page: Open) -> None:
    """On the map, the direction under the pointer stays under it."""
    page = open_page()
    box = page.locator("#map-canvas").bounding_box()
    drag(page, "#map-canvas", 70, 40)
    angles = page.evaluate("[lightdomeView.state.yaw, lightdomeView.state.pitch, lightdomeView.state.roll]")
    at = [(0.15, 0.4), (0.15 + 70 / box["width"], 0.4 + 40 / box["height"])]
    before, after = (
        np.array([math.sin(t) * math.cos(p), math.cos(t), math.sin(t) * math.sin(p)])
        for p, t in ((2 * math.pi * u, math.pi * v) for u, v in at)
    )
    np.testing.assert_allclose(rotation_matrix(*angles) @ before, after, atol=0.02)


def test_a_drag_down_the_sphere_moves_light_down(open_page: Open) -> None:
    page = open_page()
    drag(page, "#sphere-canvas", 0, 30)
    pitch = page.evaluate("lightdomeView.state.pitch")
    assert pitch > 5
    assert rotation_matrix(0, pitch)[1, 2] < 0  # what was in front is lower


def test_keys(open_page: Open) -> None:
    page = open_page()
    for keys in (
        (
            ("s", "sequence", "lattice"),
            ("+", "count", 512),
            ("n", "seed", SEED + 1),
            ("e", "ev", 0.5),
            ("w", "wipe", 50),
            ("x", "marks", False),
            ("g", "gamma", 2.3),
            ("h", "tone", "soft"),
            ("c", "difference", 20),
            ("a", "albedo", 1.1),
            ("r", "resolution", RESOLUTION + 64),
            ("t", "map", 1),
            ("i", "eta", 1.5),
        ),
        (
            ("-", "count", 256),
            ("d", "ev", 0),
            ("d", "ev", -0.5),
            ("G", "gamma", 2.2),
            ("C", "difference", 10),
            ("A", "albedo", 1),
            ("I", "eta", 1.4),
        ),
        (("m", "method", "median-cut"), ("2", "tab", "fresnel")),
        (("3", "tab", "check"),),
    ):
        address = {}
        for key, name, value in keys:
            page.keyboard.press(key)
            assert page.evaluate(f"lightdomeView.state.{name}") == value, key
            # An address has only what differs from the default.
            is_default = value in (256, 2.2, 10, 1, 1.4) and name != "map"
            address[name] = None if is_default else str(value).lower()
        shown = "new URLSearchParams(location.hash.slice(1)).get(name) === value"
        until(page, f"Object.entries({json.dumps(address)}).every(([name, value]) => {shown})")


def test_arrow_keys_turn_the_light_and_0_turns_it_back(open_page: Open) -> None:
    page = open_page()
    page.focus("#sphere-view")
    page.keyboard.press("ArrowRight")
    page.keyboard.press("Shift+ArrowDown")
    assert page.evaluate("lightdomeView.state.yaw") == pytest.approx(5, abs=0.1)
    assert page.evaluate("lightdomeView.state.pitch") == pytest.approx(1, abs=0.1)
    page.keyboard.press("0")
    assert page.evaluate("[lightdomeView.state.yaw, lightdomeView.state.pitch]") == [0, 0]


def test_everything_can_be_reached_by_tab_and_help_names_the_keys(open_page: Open) -> None:
    page = open_page()
    page.keyboard.press("?")
    assert page.locator("#help").is_visible()
    assert "next sequence" in page.locator("#keys").inner_text()
    page.keyboard.press("Escape")
    reached = set()
    for _ in range(60):
        page.keyboard.press("Tab")
        reached.add(page.evaluate("document.activeElement.id"))
    assert {"map-view", "sphere-view", "method", "count", "yaw-slider", "wipe", "save-picture", "copy-link"} <= reached
    unnamed = page.evaluate(
        "[...document.querySelectorAll('input, select, textarea, button')]"
        ".filter(e => !e.labels?.length && !e.ariaLabel && !e.getAttribute('aria-labelledby')"
        " && !e.textContent.trim()).map(e => e.id)"
    )
    assert unnamed == []


def test_a_link_shows_the_same(open_page: Open) -> None:
    page = open_page(method="mis", sequence="lattice", count=4, seed=9, yaw=-30, albedo=0.7, ev=1.5, wipe=40)
    first = rmse(page)
    other = page.context.new_page()
    other.goto(page.url)
    assert rmse(other) == first
    for name in "ev", "wipe", "yaw", "albedo":
        assert other.evaluate(f"lightdomeView.state.{name}") == page.evaluate(f"lightdomeView.state.{name}")


def test_a_wrong_address_shows_the_nearest_right_one(open_page: Open) -> None:
    page = open_page(method="evil", sequence="<b>", count=1e9, yaw="NaN", map=999, gamma=-1, tab="x")
    state = page.evaluate("lightdomeView.state")
    assert (state["method"], state["sequence"], state["count"], state["yaw"]) == ("shared", "sobol", 256, 0)
    assert (state["map"], state["gamma"], state["tab"]) == (0, 2.2, "light")


def pixels_of(page: playwright.Page, canvas: str) -> np.ndarray:
    """The pixels of a canvas, (h, w, 4), with row 0 at the top."""
    width, height, data = page.evaluate(
        "async (id) => { const c = document.getElementById(id), d = document.createElement('canvas');"
        " d.width = c.width; d.height = c.height; const g = d.getContext('2d'); g.drawImage(c, 0, 0);"
        " const reader = new FileReader();"
        " const read = new Promise((done) => { reader.onload = () => done(reader.result); });"
        " reader.readAsDataURL(new Blob([g.getImageData(0, 0, c.width, c.height).data]));"
        " return [c.width, c.height, await read]; }",
        canvas,
    )
    return np.frombuffer(b64decode(data.partition(",")[2]), np.uint8).reshape(height, width, 4)


def test_the_map_is_shown_as_tone_map_shows_it(open_page: Open, envmap: EnvironmentMap) -> None:
    page = open_page(marks="false", ev=-1, gamma=1.8)
    seen = pixels_of(page, "map-canvas")
    exposure = 0.5 * page.evaluate("lightdomeView.exposures[0]")
    expected = tone_map(envmap.radiance, exposure, 1.8)
    height, width = seen.shape[:2]
    y, x = np.arange(32), np.arange(64)  # centres of the map's pixels
    at = seen[np.ix_((y * height + height // 2) // 32, (x * width + width // 2) // 64)][..., :3]
    assert np.abs(at.astype(int) - expected).mean() < 4


def test_marks_lie_where_the_samples_are(open_page: Open, device: Device, envmap: EnvironmentMap) -> None:
    page = open_page(count=1, yaw=60, pitch=20)
    with_mark = pixels_of(page, "map-canvas")
    page.keyboard.press("x")
    page.wait_for_timeout(200)
    changed = np.argwhere((with_mark != pixels_of(page, "map-canvas")).any(axis=2))
    (x, y, z) = shared(device, envmap, 1).rotated(60, 20).direction[0]
    height, width = with_mark.shape[:2]
    row = math.acos(y) / math.pi * height
    column = math.atan2(z, x) / (2 * math.pi) % 1 * width
    np.testing.assert_allclose(changed.mean(axis=0), [row, column], atol=2)


def test_exposure_asks_the_server_for_nothing(open_page: Open) -> None:
    page = open_page()
    frames = page.evaluate("lightdomeView.frames.length")
    before = pixels_of(page, "sphere-canvas")
    page.keyboard.press("d")
    page.wait_for_timeout(300)
    assert pixels_of(page, "sphere-canvas").mean() < before.mean()
    assert page.evaluate("lightdomeView.frames.length") == frames


def test_the_wipe_shows_the_exact_image_on_the_right(open_page: Open) -> None:
    page = open_page(count=4, wipe=100)
    method = pixels_of(page, "sphere-canvas")
    page.evaluate("lightdomeView.state.wipe = 50; document.getElementById('wipe').value = 50;")
    page.locator("#wipe").dispatch_event("input")
    page.wait_for_timeout(200)
    both = pixels_of(page, "sphere-canvas")
    gap = round(0.02 * both.shape[1])
    side = (both.shape[1] - 2 * gap) // 3
    left, right = slice(0, side // 2 - 3), slice(side // 2 + 3, side)
    np.testing.assert_array_equal(both[:, left], method[:, left])
    start = gap + side  # where the exact image begins
    np.testing.assert_allclose(both[:, right], both[:, start + side // 2 + 3 : start + side], atol=1)


def test_the_approximation_while_dragging_looks_like_the_exact_image(open_page: Open) -> None:
    page = open_page(resolution=255)
    page.evaluate("lightdomeView.turn({ yaw: 130, pitch: -50, roll: 20 }, true)")
    until(page, "lightdomeView.frames.at(-1).setting.yaw === 130 && lightdomeView.frames.at(-1).drawn > 0")
    assert page.evaluate("lightdomeView.numbers.is_exact") is False
    moving = pixels_of(page, "sphere-canvas").astype(int)
    page.evaluate("lightdomeView.turn({ yaw: 130, pitch: -50, roll: 20 }, false)")
    settled(page)
    page.wait_for_timeout(100)
    resting = pixels_of(page, "sphere-canvas").astype(int)
    exact_one = slice(moving.shape[1] // 3 + 10, 2 * moving.shape[1] // 3 - 10)
    assert resting[:, exact_one].std() > 20
    assert np.abs(moving - resting)[:, exact_one].mean() < 2


def test_two_pages_at_once_both_get_the_exact_image(open_page: Open) -> None:
    pages = [open_page(yaw=12, resolution=95) for _ in range(2)]
    for page in pages:
        page.evaluate("lightdomeView.turn({ yaw: 34 }, false)")
    assert rmse(pages[0]) == rmse(pages[1])


def test_points_are_collected_with_their_pareto_front(open_page: Open) -> None:
    page = open_page()
    for _ in range(3):
        page.keyboard.press("+")
        settled(page)
    points = page.evaluate("lightdomeView.points")
    assert len(points) == 4

    class Measured:
        def __init__(self, x: float, y: float) -> None:
            self.wall_seconds, self.rmse = x, y

    front = [(m.wall_seconds, m.rmse) for m in pareto_front(Measured(p["x"], p["y"]) for p in points)]
    assert [(p["x"], p["y"]) for p in page.evaluate("lightdomeView.front()")] == front
    until(page, "document.querySelectorAll('#error-count circle').length >= 5")
    assert "Slope" in page.locator("#slope").inner_text()


def test_fresnel_matches_the_library(open_page: Open) -> None:
    page = open_page(tab="fresnel")
    enter(page, "eta", 1.7)
    expected = summarise(1.7)
    until(page, f"document.body.innerText.includes('{expected.brewster_entering_deg:.4f}°')")
    text = page.locator("#fresnel-table").inner_text()
    assert f"{expected.critical_leaving_deg:.4f}°" in text
    assert f"{expected.brewster_leaving_deg:.4f}°" in text
    assert page.locator("#entering path.curve").count() == 4


def test_check_reports_what_the_command_reports(
    open_page: Open, device: Device, envmap: EnvironmentMap, tmp_path: Path
) -> None:
    image = exact(device, envmap, 33)
    page = open_page(tab="check")
    for name, pixels, said in (
        ("right.exr", image, "agrees"),
        ("mirrored.pfm", image[:, ::-1], "mirrored left to right"),
    ):
        write_image(tmp_path / name, pixels)
        page.set_input_files("#file", tmp_path / name)
        until(
            page,
            f"document.getElementById('verdict').innerText.includes('{name}') && "
            "!document.getElementById('verdict').classList.contains('busy')",
        )
        assert said in page.locator("#verdict h2").inner_text().lower()
    (tmp_path / "broken.exr").write_bytes(b"v/1\x01 but no more")
    page.set_input_files("#file", tmp_path / "broken.exr")
    until(page, "document.getElementById('verdict').innerText.includes('Not checked')")
    assert "/tmp" not in page.locator("#verdict").inner_text()


def test_saving(open_page: Open, device: Device, envmap: EnvironmentMap, tmp_path: Path) -> None:
    page = open_page(count=16, yaw=90)
    with page.expect_download() as download:
        page.click("#save-lights")
    rows = np.loadtxt(download.value.path(), delimiter=",", skiprows=1)
    lights = shared(device, envmap, 16).rotated(90)
    np.testing.assert_allclose(rows[:, :3], lights.direction, atol=1e-6)
    np.testing.assert_allclose(rows[:, 3:], lights.flux, rtol=1e-6)
    with page.expect_download() as download:
        page.click("#save-picture")
    assert Path(download.value.path()).read_bytes().startswith(b"\x89PNG")
    until(page, "document.getElementById('command').value.includes('--rotate 90 0 0')")
    assert "lightdome shade" in page.input_value("#command")


@pytest.mark.parametrize("tab", ["light", "fresnel", "check"])
def test_nothing_is_wider_than_the_window(open_page: Open, tab: str) -> None:
    page = open_page(tab=tab)
    for width in 390, 750, 1500:
        page.set_viewport_size({"width": width, "height": 900})
        until(page, f"innerWidth === {width}")
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth"), width


def test_without_webgl_the_server_makes_the_pictures(server: Server, browser: playwright.Browser) -> None:
    arguments = ["--no-sandbox", "--disable-3d-apis"]
    without = browser.browser_type.launch(executable_path=CHROMIUM, args=arguments)
    page = without.new_page()
    page.goto(f"{server.url}#resolution={RESOLUTION}")
    settled(page)
    assert page.evaluate("lightdomeView.hasPictures")
    until(page, "document.getElementById('difference-picture').naturalWidth === 63")
    assert "no WebGL" in page.locator("#numbers").inner_text()
    without.close()


def test_many_frames_leave_nothing_behind(open_page: Open, server: Server) -> None:
    """A hundred frames; ``tests/tools/soak_view.py`` runs ten thousand."""
    page = open_page(resolution=31)
    page.evaluate("lightdomeView.frames.length = 0")
    turns = (
        "async (count) => { const { frames, turn } = lightdomeView; let n = 0;"
        " while (frames.length < count) { turn({ yaw: ++n % 360 }, true); await new Promise(requestAnimationFrame); } }"
    )
    page.evaluate(turns, 100)
    frames = page.evaluate("lightdomeView.frames")
    asked = np.array([frame["asked"] for frame in frames])
    arrived = np.array([frame["arrived"] for frame in frames])
    assert (asked[1:] >= arrived[:-1]).all(), "more than one frame was in flight"
    assert server.engine.exact_images.bytes <= 2**26


def test_a_closed_page_makes_room_for_another(open_page: Open, server: Server) -> None:
    for _ in range(2):
        page = open_page()
        page.reload()
        settled(page)
        page.close()
    until(open_page(), "true")
    end = time.monotonic() + 20
    while server.pages > 1 and time.monotonic() < end:
        time.sleep(0.05)
    assert server.pages == 1
