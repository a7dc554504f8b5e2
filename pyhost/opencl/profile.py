"""The device time of each stage, from OpenCL's profiling events."""

from __future__ import annotations

from collections import deque
from typing import Any

import pyopencl as cl

PENDING = 64  # the most pending events; each is kept with its command's arrays


class Profile:
    """Device time by stage name, in the order in which the stages first ran.

    An event, and the arrays that its command uses, are kept until the command is done.
    """

    def __init__(self) -> None:
        self._nanoseconds: dict[str, int] = {}
        self._pending: deque[tuple[str, cl.Event, tuple[object, ...]]] = deque()  # of an in-order queue, oldest first

    def record(self, stage: str, event: cl.Event, *kept: object) -> None:
        """Add the time of ``event`` to ``stage``; ``kept`` stays alive until the event is complete."""
        self._pending.append((stage, event, kept))
        while self._pending and (len(self._pending) > PENDING or self._pending[0][1].command_execution_status <= 0):
            self._settle_oldest()

    def settle(self) -> None:
        """Wait for all commands still running."""
        while self._pending:
            self._settle_oldest()

    def _settle_oldest(self) -> None:
        stage, event, kept = self._pending.popleft()
        event.wait()
        del kept  # only now that the command is done
        # Much faster than event.profile.end.
        times: list[Any] = [event.get_profiling_info(time) for time in (cl.profiling_info.END, cl.profiling_info.START)]
        self._nanoseconds[stage] = self._nanoseconds.get(stage, 0) + times[0] - times[1]

    def seconds(self) -> dict[str, float]:
        """The device time of each stage in seconds; waits for commands still running."""
        self.settle()
        return {stage: 1e-9 * nanoseconds for stage, nanoseconds in self._nanoseconds.items()}

    def clear(self) -> None:
        """Forget all times; waits for commands still running."""
        self.settle()
        self._nanoseconds.clear()
