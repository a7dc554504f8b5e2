"""What every stage costs on the device, from OpenCL's profiling events."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import pyopencl as cl


class Profile:
    """Events by the name of their stage, in the order in which the stages first ran."""

    def __init__(self) -> None:
        self._events: dict[str, list[cl.Event]] = {}

    def record(self, stage: str, event: cl.Event) -> cl.Event:
        """Keep ``event`` as a part of ``stage`` and hand it back."""
        self._events.setdefault(stage, []).append(event)
        return event

    def seconds(self) -> dict[str, float]:
        """The device time of each stage in seconds; waits for what is still running."""
        result = {}
        for stage, events in self._events.items():
            for event in events:
                event.wait()
            result[stage] = 1e-9 * sum(e.profile.end - e.profile.start for e in events)
        return result

    def clear(self) -> None:
        """Forget all events."""
        self._events.clear()
