"""Killing a process of a catalog loses no finished row and leaves no incomplete file: tests/tools/catalog_faults.py."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

pytest.importorskip("distributed")
pytest.importorskip("pyarrow")

from catalog_faults import Trial

if TYPE_CHECKING:
    from distributed import Client

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def trial(client: Client, tmp_path_factory: pytest.TempPathFactory) -> Trial:
    return Trial(tmp_path_factory.mktemp("trial"), maps=8, workers=1, address=client.scheduler.address)


# test_catalog.py has maps that kill their worker.
@pytest.mark.parametrize("kind", ["client", "scheduler"])
def test_a_killed_process_costs_no_row(trial: Trial, kind: str) -> None:
    outcome = trial.kill(kind, 3)
    assert outcome.is_equal
    assert outcome.lost == 0
    assert not outcome.half
    assert 2 <= outcome.finished <= 8  # one of the three rows may be that of the damaged map
