"""Rate limits per key or address."""

import math
import time

from service.errors import TooManyRequestsError


class RateLimiter:
    """Counts the requests of each client in this process.

    Parameters
    ----------
    per_minute
        Requests allowed per client.
    """

    def __init__(self, per_minute: int) -> None:
        # Imported here because it takes an eighth of a second, which most starts need not wait for.
        from limits import RateLimitItemPerMinute
        from limits.storage import MemoryStorage
        from limits.strategies import SlidingWindowCounterRateLimiter

        self._allowed = RateLimitItemPerMinute(per_minute)
        self._limiter = SlidingWindowCounterRateLimiter(MemoryStorage())

    def hit(self, client_name: str) -> None:
        """Count a request.

        Raises
        ------
        TooManyRequestsError
            When it is one too many.
        """
        if self._limiter.hit(self._allowed, client_name):
            return
        reset = self._limiter.get_window_stats(self._allowed, client_name).reset_time
        raise TooManyRequestsError(
            f"{client_name} exceeded the rate limit of {self._allowed.amount} requests per minute.",
            retry_after_s=max(1, math.ceil(reset - time.time())),
        )
