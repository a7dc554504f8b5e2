"""Curves of reflectances: each mistake is named, and correct curves agree."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from lightdome.checking.fresnel import CAUSES_OF_CURVES, check_fresnel, read_curves
from lightdome.errors import LightdomeError
from lightdome.fresnel.equations import critical_angle, fresnel
from student_fresnel import curves

DEGREES = np.arange(0, 91.0)
OF_BOTH = ("amplitudes averaged", "one polarisation for both", "p and s added")  # only in unpolarised light


def sides(name: str) -> list[bool]:
    """The values of ``leaving`` for which the mistake makes a difference."""
    if name in ("curve ends at the critical angle", "Schlick with the incident angle on the way out"):
        return [True]
    return [False, True]


@pytest.mark.parametrize("name", [cause.name for cause in CAUSES_OF_CURVES])
def test_each_mistake_is_named(name: str) -> None:
    for eta in (1.33, 1.4, 2.4):
        for leaving in sides(name):
            found = curves(DEGREES, eta, leaving, name)
            given = [found] if name in OF_BOTH else [{"p": found["p"], "s": found["s"]}] if "p" in found else []
            given += [{"reflectance": found["reflectance"]}] if name != "p and s swapped" else []
            for values in given:
                check = check_fresnel(np.radians(DEGREES), **values, eta=eta, leaving=leaving)
                assert check.cause is not None, (eta, leaving, list(values), check.verdict)
                assert check.cause.name == name, (eta, leaving, list(values), check.verdict)


def test_correct_curves_agree() -> None:
    for eta in (0.8, 1.1, 1.33, 1.4, 1.5, 2.4):
        for leaving in (False, True):
            for degrees in (DEGREES, np.linspace(0, 89.9, 317), np.array([0.0, 30, 60])):
                for digits in (4, 15):
                    found = {name: np.round(v, digits) for name, v in curves(degrees, eta, leaving).items()}
                    for keep in (("reflectance",), ("p", "s"), ("reflectance", "p", "s")):
                        values = {name: found[name] for name in keep}
                        check = check_fresnel(np.radians(degrees), **values, eta=eta, leaving=leaving)
                        assert check.agrees, (eta, leaving, check.verdict)


def test_rounded_angles_agree_even_near_the_critical_angle() -> None:
    critical = critical_angle(1.4, 1.0)
    assert critical is not None
    theta = np.append(critical + np.linspace(-1e-3, 1e-3, 41), math.pi / 2)
    p, s = fresnel(theta, 1.4, 1.0)
    assert check_fresnel(np.round(theta, 4), p=p, s=s, eta=1.4, leaving=True).agrees


@pytest.mark.parametrize("lost", [math.nan, 0.0, None])
def test_a_curve_may_end_in_several_ways(lost: float | None) -> None:
    found = curves(DEGREES, 1.4, True, "curve ends at the critical angle")["reflectance"]
    keep = np.isfinite(found) if lost is None else np.full(len(found), True)
    values = np.nan_to_num(found, nan=lost or 0.0) if lost != lost or lost == 0 else found
    check = check_fresnel(np.radians(DEGREES)[keep], values[keep], eta=1.4, leaving=True)
    assert check.cause is not None
    assert check.cause.name == "curve ends at the critical angle"


def test_an_unknown_mistake_is_reported_with_its_angle() -> None:
    values = curves(DEGREES, 1.4, False)["reflectance"]
    values[40] += 0.2
    check = check_fresnel(np.radians(DEGREES), values, eta=1.4)
    assert check.agrees is False
    assert check.cause is None
    assert "0.2 at 40 degrees" in check.verdict


@pytest.mark.parametrize(
    ("header", "angle"),
    [("angle_degrees,R_p,R_s", 45), ("theta_rad,Rp,Rs", math.pi / 4), ("angle;p;s", 45), ("Theta,P,S", 45)],
)
def test_angles_are_in_the_unit_that_the_column_says(tmp_path: Path, header: str, angle: float) -> None:
    path = tmp_path / "curve.csv"
    delimiter = ";" if ";" in header else ","
    path.write_text(f"{header}\n" + delimiter.join(map(str, (angle, 0.25, 0.5))) + "\n")
    theta, (both, p, s) = read_curves(path)
    np.testing.assert_allclose(theta, [math.pi / 4])
    assert both is None
    assert (p, s) == ([0.25], [0.5])


def test_what_cannot_be_checked_is_refused(tmp_path: Path) -> None:
    for arguments, message in (
        ({"theta": [0.1]}, "no reflectances to check"),
        ({"theta": [2.0], "p": [0.1]}, "between 0 and pi/2"),
        ({"theta": [0.1], "p": [0.1], "eta": 1.0}, "no boundary"),
        ({"theta": [0.1], "p": [0.1, 0.2]}, "shape"),
    ):
        values = {name: np.array(v) if isinstance(v, list) else v for name, v in arguments.items()}
        with pytest.raises(LightdomeError, match=message):
            check_fresnel(**values)
    (tmp_path / "curve.csv").write_text("a,b\n1,2\n")
    with pytest.raises(LightdomeError, match="expected a column angle_degrees"):
        read_curves(tmp_path / "curve.csv")
