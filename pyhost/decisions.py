"""What was used for a scene, and what was skipped because the scene does not need it, each with its reason."""

from __future__ import annotations

from typing import NamedTuple


class Decision(NamedTuple):
    """``what`` was used or skipped, and ``why``."""

    what: str
    used: bool
    why: str

    def __str__(self) -> str:
        return f"{'used' if self.used else 'skipped'}: {self.what}; {self.why}"


class Decisions:
    """The decisions since the last :meth:`take`, in the order in which they were first made.

    A later decision on the same thing replaces an earlier one.
    """

    def __init__(self) -> None:
        self._made: dict[str, Decision] = {}

    def use(self, what: str, why: str) -> None:
        """Note that ``what`` is used."""
        self._made[what] = Decision(what, True, why)

    def skip(self, what: str, why: str) -> None:
        """Note that ``what`` is skipped."""
        self._made[what] = Decision(what, False, why)

    def take(self) -> list[Decision]:
        """Return the decisions and forget them: later ones belong to another result."""
        made = list(self._made.values())
        self._made.clear()
        return made
