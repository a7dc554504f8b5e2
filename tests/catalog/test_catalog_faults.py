"""Killing a process of a catalog loses no finished row and leaves no incomplete file: tests/tools/catalog_faults.py."""

from __future__ import annotations

import pytest

pytest.importorskip("distributed")
pytest.importorskip("pyarrow")

from catalog_faults import KINDS, Trial

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def trial(tmp_path_factory: pytest.TempPathFactory) -> Trial:
    return Trial(tmp_path_factory.mktemp("trial"), maps=8, workers=1)


@pytest.mark.parametrize("kind", KINDS)
def test_a_killed_process_costs_no_row(trial: Trial, kind: str) -> None:
    outcome = trial.kill(kind, 3)
    assert outcome.is_equal
    assert outcome.lost == 0
    assert not outcome.half
    assert kind == "worker" or 2 <= outcome.finished <= 8  # one of the three rows may be that of the damaged map
