"""The faults that tools/mutate.py puts into the code stay applicable as the code changes."""

from __future__ import annotations

from collections import Counter

import faults
import mutate
from helpers import ROOT


def test_every_fault_can_be_put_in_and_changes_something() -> None:
    for fault in faults.FAULTS:
        path, text = mutate.faulty(ROOT, fault)
        assert text != path.read_text(encoding="utf-8"), fault.name
        assert fault.why
        assert mutate.test_paths(ROOT, fault.tests), fault.name


def test_there_are_enough_faults_of_every_area_and_no_two_of_a_name() -> None:
    assert len({fault.name for fault in faults.FAULTS}) == len(faults.FAULTS) >= 100
    areas = Counter(fault.area for fault in faults.FAULTS)
    assert areas.keys() == mutate.AREAS.keys()
    assert min(areas.values()) >= 20
