"""Fresnel reflectance and part 1, against the textbook's equations in 60 decimal digits."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from collections.abc import Callable
from dataclasses import asdict
from decimal import localcontext
from itertools import combinations
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from helpers import LONG, Script, script_path
from lightdome import __version__
from lightdome.errors import LightdomeError
from lightdome.fresnel.equations import (
    brewster_angle,
    critical_angle,
    fresnel,
    normal_reflectance,
    refraction_angle,
    schlick,
    schlick_error,
    summarise,
    unpolarised,
)
from lightdome.fresnel.plot import fresnel_figure, save, schlick_figure
from lightdome.reference import fresnel as textbook
from lightdome.reference import sine_and_cosine
from matplotlib.figure import Figure
from matplotlib.text import Text

RIGHT = math.pi / 2
ETAS = [1 - 1e-7, 1 + 1e-7, 0.999, 1.001, 1 / 1.4, 1.4, 0.1, 10.0, 1e-3, 1e3, 1e-6, 1e6]


def telling_angles(n_i: float, n_t: float) -> np.ndarray:
    """Angles everywhere, and ever closer to 0, to 90 degrees, and to the two special angles from both sides."""
    close = np.r_[0, 10.0 ** np.arange(-16, 0)]
    angles = [np.linspace(0, RIGHT, 46), close, RIGHT - close]
    for special in (brewster_angle(n_i, n_t), critical_angle(n_i, n_t)):
        if special is not None:
            angles += [special * (1 - close), special * (1 + close)]
    theta = np.unique(np.concatenate(angles))
    return theta[theta < RIGHT]


@pytest.mark.parametrize("eta", ETAS)
def test_exact_for_an_angle_within_two_ulps(eta: float) -> None:
    theta = telling_angles(1.0, eta)
    brewster = brewster_angle(1.0, eta)
    computed = fresnel(theta, 1.0, eta)
    for angle, *values in zip(theta, *computed, strict=True):
        slack = 2 * np.spacing(angle)
        around = [textbook(a, 1.0, eta) for a in (max(angle - slack, 0.0), angle, angle + slack)]
        for value, references in zip(values, zip(*around, strict=True), strict=True):
            low, high = float(min(references)), float(max(references))
            if references[0] == around[0][0] and abs(angle - brewster) <= 2 * slack:
                low = 0.0  # the zero of R_p is between the three angles
            assert low * (1 - 3e-15) <= value <= high * (1 + 3e-15), (angle, value, low, high)


def test_entering_s_polarised_light_needs_no_slack_in_the_angle() -> None:
    for eta in (1 + 1e-7, 1.001, 1.4, 10.0, 1e6):
        theta = telling_angles(1.0, eta)
        exact = [float(textbook(a, 1.0, eta)[1]) for a in theta]
        np.testing.assert_allclose(fresnel(theta, 1.0, eta)[1], exact, rtol=3e-15, atol=0)


def test_only_the_ratio_of_the_indices_counts() -> None:
    theta = np.linspace(0, RIGHT, 50)
    for scale in (2.0**-1000, 2.0**1000):
        np.testing.assert_array_equal(fresnel(theta, scale, 1.5 * scale), fresnel(theta, 1.0, 1.5))


@pytest.mark.parametrize("eta", [*ETAS, 1e-300, 1e300])
def test_every_boundary_reflects_all_at_90_degrees(eta: float) -> None:
    assert fresnel(RIGHT, 1.0, eta) == (1, 1)
    assert fresnel(np.float32(RIGHT), 1.0, eta) == (1, 1)
    assert schlick(RIGHT, normal_reflectance(1.0, eta)) == 1


def test_equal_indices_reflect_nothing() -> None:
    np.testing.assert_array_equal(fresnel(np.linspace(0, RIGHT, 91), 1.4, 1.4), 0)


@pytest.mark.parametrize("eta", [eta for eta in ETAS if eta > 1])
def test_all_is_reflected_beyond_the_critical_angle_and_not_before(eta: float) -> None:
    critical = critical_angle(eta, 1.0)
    beyond = np.linspace(critical * (1 + 1e-15), RIGHT, 1000)
    np.testing.assert_array_equal(fresnel(beyond, eta, 1.0), 1)
    assert np.isnan(refraction_angle(beyond[1:], eta, 1.0)).all()
    assert unpolarised(critical * (1 - 1e-12), eta, 1.0) < 1


@pytest.mark.parametrize("eta", [0.7, 1 - 1e-7, 1 + 1e-7, 1.4, 2.4])
def test_nothing_p_polarised_is_reflected_at_brewsters_angle(eta: float) -> None:
    reflected_p, reflected_s = fresnel(brewster_angle(1.0, eta), 1.0, eta)
    assert reflected_p < 1e-31
    assert reflected_s > 1e-16


def test_reflectance_stays_between_0_and_1() -> None:
    rng = np.random.default_rng(1)
    n = 10.0 ** rng.uniform(-8, 8, (2, 100_000))
    near_one = 1 + 1e-7 * rng.uniform(-1, 1, 100_000)
    for theta in (rng.uniform(0, RIGHT, 100_000), RIGHT - 10 ** rng.uniform(-16, 0, 100_000)):
        for n_i, n_t in ((n[0], n[1]), (1.0, near_one), (near_one, 1.0)):
            values = np.stack(fresnel(theta, n_i, n_t))
            assert (values >= 0).all()
            assert (values <= 1).all()


@pytest.mark.parametrize("eta", [1.001, 1.4, 2.4, 10.0])
def test_reflectance_is_the_same_both_ways(eta: float) -> None:
    theta = np.linspace(0, np.radians(89), 500)
    back = fresnel(refraction_angle(theta, 1.0, eta), eta, 1.0)
    np.testing.assert_allclose(fresnel(theta, 1.0, eta), back, rtol=1e-10, atol=1e-15)


def test_known_values_of_eta_1_4() -> None:
    values = summarise(1.4)
    for reflectance in (values.normal_reflectance_p, values.normal_reflectance_s, values.schlick_r0):
        assert reflectance == pytest.approx((0.4 / 2.4) ** 2, rel=2e-15)
        assert round(reflectance, 6) == 0.027778
    assert round(values.brewster_entering_deg, 4) == 54.4623
    assert round(values.brewster_leaving_deg, 4) == 35.5377
    assert values.critical_entering_deg is None
    assert round(values.critical_leaving_deg, 4) == 45.5847


def test_below_1_the_two_sides_swap() -> None:
    thin, thick = summarise(0.625), summarise(1.6)
    assert thin.critical_leaving_deg is None
    assert thin.critical_entering_deg == pytest.approx(thick.critical_leaving_deg, rel=1e-15)
    assert thin.brewster_entering_deg == pytest.approx(thick.brewster_leaving_deg, rel=1e-15)
    assert thin.schlick_leaving_max_abs_error == pytest.approx(thick.schlick_entering_max_abs_error)


@pytest.mark.parametrize("eta", [0.625, 1.05, 1.4, 2.4])
def test_every_number_of_a_summary_is_that_of_its_own_side(eta: float) -> None:
    values = asdict(summarise(eta))
    assert values.pop("eta") == eta
    r0 = ((eta - 1) / (eta + 1)) ** 2
    expected = {"normal_reflectance_p": r0, "normal_reflectance_s": r0, "schlick_r0": r0}
    for side, n_i, n_t in (("entering", 1.0, eta), ("leaving", eta, 1.0)):
        theta = np.linspace(0, RIGHT, 20_001)
        if n_t < n_i:
            theta = np.append(theta, math.asin(n_t / n_i))  # where the error has a corner
        exact = np.mean([[float(r) for r in textbook(a, n_i, n_t)] for a in theta[::50]], axis=1)
        np.testing.assert_allclose(unpolarised(theta[::50], n_i, n_t), exact, atol=1e-13)
        error = np.abs(r0 + (1 - r0) * (1 - np.cos(theta)) ** 5 - unpolarised(theta, n_i, n_t))
        expected |= {
            f"brewster_{side}_deg": math.degrees(math.atan(n_t / n_i)),
            f"critical_{side}_deg": math.degrees(math.asin(n_t / n_i)) if n_t < n_i else None,
            f"schlick_{side}_max_abs_error": error.max(),
            f"schlick_{side}_max_abs_error_at_deg": math.degrees(theta[error.argmax()]),
        }
    assert values.keys() == expected.keys()
    for name, value in values.items():
        if expected[name] is None:
            assert value is None, name
        else:
            assert value == pytest.approx(expected[name], rel=1e-6, abs=0.01 if name.endswith("at_deg") else 0), name


def test_equal_indices_have_neither_special_angle() -> None:
    values = asdict(summarise(1))
    missing = [name for name, value in values.items() if value is None]
    assert missing == [f"{a}_{b}_deg" for a in ("brewster", "critical") for b in ("entering", "leaving")]
    assert values["schlick_entering_max_abs_error"] == 1  # 1 at 90 degrees, where nothing is reflected


@pytest.mark.parametrize("eta", [*ETAS, 1.05, 1.0, 1e-300, 1e300])
def test_a_summary_is_valid_json(eta: float) -> None:
    json.dumps(asdict(summarise(eta)), allow_nan=False)


def test_schlick_keeps_its_digits_at_small_angles() -> None:
    theta = np.array([0.0, 1e-8, 1e-3, 0.5, 1.0, 1.5])
    with localcontext() as context:
        context.prec = 60
        exact = [float((1 - sine_and_cosine(a)[1]) ** 5) for a in theta]
    np.testing.assert_allclose(schlick(theta, 0), exact, rtol=3e-15)
    np.testing.assert_array_equal(schlick(theta, 1), 1)


@pytest.mark.parametrize(
    "sides", [(1, 1.4), (1.4, 1), (1, 1.05), (1.001, 1), (1, 30), (30, 1), (1, 1 + 1e-7), (1, 1e6)]
)
def test_no_angle_has_a_larger_error_of_schlick_than_the_one_found(sides: tuple[float, float]) -> None:
    n_i, n_t = sides
    worst = schlick_error(n_i, n_t)
    edge = critical_angle(n_i, n_t) or RIGHT
    theta = np.r_[np.linspace(0, RIGHT, 20_001), edge - np.geomspace(1e-14, edge, 20_001)]
    theta = np.maximum(theta, 0)
    error = np.abs(schlick(theta, normal_reflectance(n_i, n_t)) - unpolarised(theta, n_i, n_t))
    assert error.max() <= worst.absolute + 1e-14
    # and this error occurs: the flat top of 40,000 angles comes close to it
    assert worst.absolute <= error.max() + 1e-5
    p, s = (float(r) for r in textbook(worst.theta, n_i, n_t))
    assert worst.exact == pytest.approx((p + s) / 2, abs=1e-6 if n_i > n_t else 1e-14)


def test_schlick_leaving_is_furthest_off_at_the_critical_angle() -> None:
    worst = schlick_error(1.4, 1.0)
    assert worst.theta == pytest.approx(critical_angle(1.4, 1.0), rel=1e-15)
    assert worst.exact == 1


def test_shapes_broadcast_and_scalars_stay_scalar() -> None:
    p, s = fresnel(np.zeros((3, 1)), 1.0, [1.2, 1.4])
    assert p.shape == s.shape == (3, 2)
    assert p.dtype == s.dtype == np.float64
    assert all(isinstance(r, float) for r in (*fresnel(0, 1, 2), schlick(0, 0), refraction_angle(0, 1, 2)))


@pytest.mark.parametrize("n", [0.0, -1.4, math.nan, math.inf])
def test_an_impossible_index_is_refused(n: float) -> None:
    for call in (lambda: fresnel(0.1, 1.0, n), lambda: summarise(n), lambda: critical_angle(n, 1.0)):
        with pytest.raises(LightdomeError, match=r"refractive index n_[it] must be finite and above 0"):
            call()


@pytest.mark.parametrize("theta", [-1e-9, RIGHT + 1e-6, 45.0, math.nan])
def test_an_impossible_angle_is_refused(theta: float) -> None:
    for call in (lambda: fresnel(theta, 1.0, 1.4), lambda: schlick([0.0, theta], 0.04)):
        with pytest.raises(LightdomeError, match="between 0 and pi/2"):
            call()


def test_an_impossible_r0_is_refused() -> None:
    with pytest.raises(LightdomeError, match="normal incidence must lie between 0 and 1"):
        schlick(0.0, 1.1)


@pytest.mark.slow
@pytest.mark.parametrize("make", [fresnel_figure, schlick_figure])
@pytest.mark.parametrize("eta", [1.05, 1.1, 1.3, 1.4, 1.42, 1.7, 2.5, 4.0])
def test_labels_cover_neither_curves_nor_each_other(make: Callable[[float, float], Figure], eta: float) -> None:
    for sides in ((1.0, eta), (eta, 1.0)):
        figure = make(*sides)
        figure.canvas.draw()
        for ax in figure.axes:
            # Without their arrows, which reach the curves.
            boxes = [Text.get_window_extent(text) for text in ax.texts]
            assert boxes
            for box in boxes:
                assert ax.bbox.x0 < box.x0 < box.x1 < ax.bbox.x1
                assert ax.bbox.y0 < box.y0 < box.y1 < ax.bbox.y1
                for line in ax.lines:
                    path = line.get_transform().transform_path(line.get_path())
                    assert not path.intersects_bbox(box, filled=False), (sides, line.get_label())
            assert not any(a.overlaps(b) for a, b in combinations(boxes, 2)), sides


@pytest.mark.slow
def test_the_script_writes_its_files_without_opencl_and_always_the_same(tmp_path: Path) -> None:
    path = script_path("part1_fresnel")
    code = (
        "import atexit, runpy, sys\n"
        "unwanted = ('pyopencl', 'OpenImageIO', 'matplotlib.pyplot')\n"
        "atexit.register(lambda: print('loaded:', [m for m in unwanted if m in sys.modules]))\n"
        f"sys.path[0] = {str(path.parent)!r}\n"
        f"runpy.run_path({str(path)!r}, run_name='__main__')\n"
    )
    out = tmp_path / "deep" / "part1"
    command = [sys.executable, "-c", code, "--eta", "1.4", "--out", str(out)]
    result = subprocess.run(command, capture_output=True, text=True, timeout=LONG)
    assert (result.returncode, result.stderr) == (0, "")
    assert "54.4623 entering, 35.5377 leaving" in result.stdout
    assert result.stdout.endswith("loaded: []\n")
    stems = [f"{a}_{b}" for a in ("fresnel", "schlick") for b in ("entering", "leaving")]
    names = {"fresnel.json", "settings.json", *(f"{stem}.{kind}" for stem in stems for kind in ("png", "svg"))}
    assert {path.name for path in out.iterdir()} == names
    content = json.loads((out / "fresnel.json").read_text())
    assert content == {"version": __version__, **asdict(summarise(1.4))}
    for path in save(fresnel_figure(1.0, 1.4, "air", "material"), tmp_path / "fresnel_entering"):
        assert path.read_bytes() == (out / path.name).read_bytes()
    ElementTree.parse(out / "fresnel_entering.svg")


def test_a_wrong_command_line_exits_with_2(script: Script) -> None:
    result = script("part1_fresnel", "--eta", "-1.4")
    assert result.returncode == 2
    assert "--eta: -1.4 is not a finite number above 0" in result.stderr


def test_a_folder_that_cannot_be_written_is_one_line_and_exit_1(script: Script, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    result = script("part1_fresnel", "--out", tmp_path / "file" / "below")
    assert result.returncode == 1
    assert result.stdout == ""
    assert result.stderr.startswith("part1_fresnel: cannot write into the folder ")
    assert result.stderr.count("\n") == 1
