"""Forecasts on a few threads: frames are encoded one request at a time, rollouts step together.

A thread takes what is there in this order: answers to write, frames to encode, a rollout to lead.
Whoever leads a model's rollout steps all requests that have joined it, so while frames wait the
next rollout grows, and the price of a step is shared. A request joins and leaves between two steps.
"""

import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

import numpy as np
from prometheus_client import Gauge

from service.rollout import Arrays, Outputs, Predictor, Step
from service.waiting import Patience
from service.workers import Places

T = TypeVar("T")
T_co = TypeVar("T_co", covariant=True)


class Begun(NamedTuple):
    """A request whose frames are encoded."""

    predictor: Predictor
    first: Step
    horizon: int


class Job(Protocol[T_co]):
    """A request on its way to its answer; every method is called in some thread of the scheduler.

    Whatever a method raises becomes the answer.
    """

    def begin(self) -> Begun:
        """Decode and encode the frames."""
        ...

    def step(self, index: int, outputs: Outputs) -> None:
        """Take the outputs [B, N, ...] of a step, the first included."""
        ...

    def finish(self) -> T_co:
        """Return the answer, after the last step."""
        ...


@dataclass(eq=False)
class _Member(Generic[T]):
    """A request inside the scheduler."""

    job: Job[T]
    patience: Patience
    future: Future[T]
    rows: int = 0
    horizon: int = 0
    steps: int = 0

    @property
    def ended(self) -> bool:
        """Whether it has all its steps."""
        return self.steps == self.horizon

    def begin(self) -> Begun:
        """Begin, and take the first step's outputs."""
        self.patience.check()
        begun = self.job.begin()
        self.rows, self.horizon = len(begun.first.outputs["positions"]), begun.horizon
        self.take(begun.first.outputs)
        return begun

    def take(self, outputs: Outputs) -> None:
        """Take the outputs of the next step."""
        self.job.step(self.steps, outputs)
        self.steps += 1

    def finish(self) -> None:
        """Make the answer."""
        self.guarded(lambda: self.future.set_result(self.job.finish()))

    def guarded(self, act: Callable[[], None]) -> bool:
        """Do something; a failure is this request's answer. Return whether it went well."""
        try:
            act()
        except BaseException as error:  # the thread serves other requests
            self.future.set_exception(error)
            return False
        return True


@dataclass(eq=False)
class _Rollout:
    """The requests that step together through one model."""

    predictor: Predictor
    count: Callable[[float], None]
    members: list[_Member[Any]] = field(default_factory=list[_Member[Any]])
    arrivals: list[tuple[_Member[Any], Arrays]] = field(
        default_factory=list[tuple[_Member[Any], Arrays]]
    )
    led: bool = False
    _state: Arrays = field(default_factory=dict[str, np.ndarray])

    @property
    def rows(self) -> int:
        """Forecasts in it, those that join with the next step included."""
        here = sum(member.rows for member in self.members)
        return here + sum(member.rows for member, _ in self.arrivals)

    def join(self, arrived: list[tuple[_Member[Any], Arrays]]) -> None:
        """Take requests in."""
        for member, state in arrived:
            if self.members:
                known = self._state
                state = {name: np.concatenate([known[name], state[name]]) for name in known}
            self._state = state
            self.members.append(member)

    def advance(self) -> list[_Member[Any]]:
        """Step all that somebody waits for; return those that have ended."""
        self._keep([m for m in self.members if m.guarded(m.patience.check)])
        if not self.members:
            return []
        self.count(sum(member.rows for member in self.members))
        try:
            step = self.predictor.advance(self._state)
        except BaseException as error:  # whatever the runtime raises
            for member in self.members:
                member.future.set_exception(error)
            self.members = []
            return []
        self._state = step.state
        shares = zip(self.members, self._shares(step.outputs), strict=True)
        going_on = [m for m, outputs in shares if m.guarded(lambda m=m, o=outputs: m.take(o))]
        ended = [member for member in going_on if member.ended]
        self._keep([member for member in going_on if not member.ended])
        return ended

    def _shares(self, outputs: Outputs) -> list[Outputs]:
        """Every member's rows of a step's outputs."""
        if len(self.members) == 1:
            return [outputs]
        ends = np.cumsum([member.rows for member in self.members])
        rows = [slice(end - m.rows, end) for m, end in zip(self.members, ends, strict=True)]
        return [{name: values[own] for name, values in outputs.items()} for own in rows]

    def _keep(self, kept: list[_Member[Any]]) -> None:
        """Let go of all other members."""
        if len(kept) == len(self.members):
            return
        stays = np.repeat([m in kept for m in self.members], [m.rows for m in self.members])
        self._state = {name: values[stays] for name, values in self._state.items()}
        self.members = kept


class Scheduler:
    """Threads that answer a bounded number of requests.

    Parameters
    ----------
    threads
        As many as there are cores: each computes all the time.
    capacity
        Requests that it may hold.
    max_batch
        Forecasts with which a rollout begins although more frames wait.
    shown
        Follows the number of requests held.
    batches
        Returns what is told, for every step of a rollout, how many forecasts step together.
    """

    def __init__(
        self,
        threads: int,
        capacity: int,
        max_batch: int,
        shown: Gauge,
        batches: Callable[[Predictor], Callable[[float], None]],
    ) -> None:
        self._places = Places(capacity, shown)
        self._max_batch = max_batch
        self._batches = batches
        self._closed = False
        self._waiting: deque[_Member[Any]] = deque()
        self._rollouts: dict[Predictor, _Rollout] = {}
        self._ended: deque[_Member[Any]] = deque()
        self._lock = threading.Lock()
        self._resting: list[threading.Semaphore] = []
        self._threads = [
            threading.Thread(target=self._work, name=f"forecast-{index}")
            for index in range(threads)
        ]
        for thread in self._threads:
            thread.start()

    @property
    def idle(self) -> bool:
        """Whether it holds no request."""
        return self._places.idle

    def submit(self, job: Job[T], patience: Patience) -> Future[T]:
        """Take a request. Cancelled before its turn, it never begins.

        Raises
        ------
        QueueFullError
            When ``capacity`` requests are being held.
        """
        self._places.take()
        future: Future[T] = Future()
        future.add_done_callback(self._release)
        with self._lock:
            self._waiting.append(_Member(job, patience, future))
            self._wake(1)
        return future

    def _release(self, _: Future[T]) -> None:
        self._places.free()

    def close(self) -> None:
        """Let rollouts end, drop what waits."""
        with self._lock:
            self._closed = True
            dropped, self._waiting = self._waiting, deque()
            self._wake(len(self._threads))
        for member in dropped:
            member.future.cancel()
        for thread in self._threads:
            thread.join()

    def _wake(self, threads: int) -> None:
        """Wake threads that rest, under the lock; the last to rest first: its caches are warm."""
        for _ in range(min(threads, len(self._resting))):
            self._resting.pop().release()

    def _work(self) -> None:
        awake = threading.Semaphore(0)
        while True:
            with self._lock:
                act = self._choose()
                if act is None:
                    if self._closed:
                        return
                    self._resting.append(awake)
            if act is None:
                awake.acquire()
            else:
                act()

    def _choose(self) -> Callable[[], None] | None:
        """Choose what to do next, under the lock."""
        if self._ended:
            return self._ended.popleft().finish
        free = [rollout for rollout in self._rollouts.values() if not rollout.led]
        full = [rollout for rollout in free if rollout.rows >= self._max_batch]
        while self._waiting and not full:
            member = self._waiting.popleft()
            if member.future.set_running_or_notify_cancel():
                return lambda: self._begin(member)
        if not free:
            return None
        chosen = (full or free)[0]
        chosen.led = True
        return lambda: self._lead(chosen)

    def _begin(self, member: _Member[Any]) -> None:
        begun: list[Begun] = []
        if not member.guarded(lambda: begun.append(member.begin())):
            return
        if member.ended:
            member.finish()
            return
        predictor, first, _ = begun[0]
        with self._lock:
            if predictor not in self._rollouts:
                self._rollouts[predictor] = _Rollout(predictor, self._batches(predictor))
            rollout = self._rollouts[predictor]
            rollout.arrivals.append((member, first.state))

    def _lead(self, rollout: _Rollout) -> None:
        """Step a rollout until nobody is left in it, or nobody else can write its answers."""
        while True:
            with self._lock:
                arrived, rollout.arrivals = rollout.arrivals, []
                rollout.join(arrived)
                if not rollout.members:
                    del self._rollouts[rollout.predictor]
                    return
            ended = rollout.advance()
            if ended and not self._hand_over(rollout, ended):
                return

    def _hand_over(self, rollout: _Rollout, ended: list[_Member[Any]]) -> bool:
        """Leave answers to threads that rest; return whether the rollout is still to be led."""
        with self._lock:
            self._ended.extend(ended)
            if self._resting and (rollout.members or rollout.arrivals):
                self._wake(len(ended))
                return True
            # Who leads no more writes an answer next.
            rollout.led = False
            self._wake(len(ended) - 1)
            return False
