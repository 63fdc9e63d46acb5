"""The time limit of a call."""

import time
from typing import Self


class Deadline(float):
    """A time limit in seconds that can be paused.

    As a float it is the whole limit, so that it can be passed as a timeout; ``left_s`` is the
    remaining time.
    """

    _left_s: float
    _running_since: float | None

    def __new__(cls, seconds: float) -> Self:
        """Make one that is paused."""
        deadline = super().__new__(cls, seconds)
        deadline._left_s, deadline._running_since = float(seconds), None
        return deadline

    def left_s(self) -> float:
        """Return the seconds that remain, at least 0."""
        running_s = 0.0 if self._running_since is None else time.monotonic() - self._running_since
        return max(0.0, self._left_s - running_s)

    def resume(self) -> None:
        """Let it run."""
        if self._running_since is None:
            self._running_since = time.monotonic()

    def pause(self) -> None:
        """Pause the deadline."""
        self._left_s, self._running_since = self.left_s(), None

    def check(self) -> None:
        """Raise TimeoutError when nothing remains."""
        if self.left_s() <= 0:
            raise TimeoutError(f"{float(self):g} s are over")
