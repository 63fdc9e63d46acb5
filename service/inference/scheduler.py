"""Forecasts on a few threads: waiting frames are encoded together, and rollouts step together.

A thread chooses its work in this order: responses to write, frames to encode, a rollout to lead.
Threads divide the waiting frames into batches. The thread that leads a rollout steps all requests
that have joined it, so the next rollout grows while frames are encoded, and requests share the cost
of a step. Steps are taken a few at a time; requests join and leave in between.

Large images are decoded in separate threads, so small requests do not wait for them.
"""

import math
import threading
import time
from collections import defaultdict, deque
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field
from queue import SimpleQueue
from typing import Any, Generic, NamedTuple, Protocol, TypeAlias, TypeVar

import numpy as np
from jaxtyping import UInt8

from rollcast.outputs import SPECS
from rollcast.rollout import Arrays, Outputs, part_of_steps
from service.inference.admission import AdmissionLimit, Gauge
from service.inference.deadlines import CancellationToken
from service.inference.rollout import Predictor

T = TypeVar("T")
T_co = TypeVar("T_co", covariant=True)

MAX_CLOSE_S = 5.0
"""Seconds for which closing waits for the threads: their requests have ended or been cancelled."""
STEPS_TOGETHER = 8
"""Steps of a rollout in one call, between two of which requests join and leave. Calls one after the
other would wait for Python's lock before each step."""
ENCODED_TOGETHER = 4
"""Requests whose frames are encoded in one batch: more gain nothing (docs/benchmarks.md)."""


class DecodedRequest(NamedTuple):
    """A request whose frames are decoded."""

    predictor: Predictor
    frames: UInt8[np.ndarray, "B K 128 128 3"]
    horizon: int


Decoding: TypeAlias = DecodedRequest | Callable[[], DecodedRequest | None] | None
"""A decoded request, or a function that decodes it in a thread for large images; None when nothing
is rolled out and the answer can be made."""


class Job(Protocol[T_co]):
    """A request on its way to its answer; every method is called in some thread of the scheduler.

    Whatever a method raises becomes the answer.
    """

    def begin(self) -> Decoding:
        """Choose the model and decode the frames, or return a function that decodes large ones."""
        ...

    def take(self, outputs: Outputs) -> Decoding | None:
        """Take the outputs [T, B, N, ...] of the next steps.

        The first step comes alone, with the encoded frames and the outputs of no step.

        Returns
        -------
        Decoding or None
            After the first step another model may begin the request anew: its decoded frames, or a
            function that decodes them if that is slow. None goes on.
        """
        ...

    def finish(self) -> T_co:
        """Return the answer, after the last step."""
        ...


@dataclass(eq=False)
class _Request(Generic[T]):
    """A request inside the scheduler."""

    job: Job[T]
    token: CancellationToken
    future: Future[T]
    rows: int = 0
    horizon: int = 0
    steps: int = 0
    decoded: DecodedRequest | None = None
    slow: Callable[[], DecodedRequest | None] | None = None
    """Decodes the frames, in a thread for large images."""

    @property
    def ended(self) -> bool:
        """True if it has all its steps."""
        return self.steps == self.horizon

    @property
    def waits(self) -> bool:
        """True if it waits for a thread that decodes or encodes its frames."""
        return self.decoded is not None or self.slow is not None

    def decode(self, how: Callable[[], Decoding]) -> None:
        """Decode the frames, or learn that it is slow; a failure is this request's answer."""

        def decode() -> None:
            self.token.raise_if_cancelled()
            self._begin(how())

        self.fail_safely(decode)

    def take(self, outputs: Outputs, steps: int) -> bool:
        """Take the outputs of the next steps; return whether the request goes on in its rollout."""
        wanted = min(steps, self.horizon - self.steps)
        self.steps += wanted
        if wanted < steps:
            outputs = part_of_steps(outputs, slice(wanted))

        def take() -> None:
            instead = self.job.take(outputs)
            if instead is not None:
                self.steps = 0
                self._begin(instead)

        return self.fail_safely(take) and not self.waits

    def _begin(self, decoding: Decoding) -> None:
        if decoding is None:
            self.future.set_result(self.job.finish())
        elif isinstance(decoding, DecodedRequest):
            self.decoded = decoding
            self.rows, self.horizon = len(decoding.frames), decoding.horizon
        else:
            self.slow = decoding

    def finish(self) -> None:
        """Make the answer."""
        self.fail_safely(lambda: self.future.set_result(self.job.finish()))

    def fail_safely(self, act: Callable[[], None]) -> bool:
        """Do something; a failure is this request's answer. Return whether it went well."""
        try:
            act()
        except BaseException as error:  # the thread serves other requests
            self.future.set_exception(error)
            return False
        return True


@dataclass(eq=False)
class _Batch:
    """Requests whose states are the rows of one state, in their order."""

    members: list[_Request[Any]]
    state: Arrays

    @property
    def rows(self) -> int:
        """Forecasts in it."""
        return sum(member.rows for member in self.members)

    def join(self, others: "_Batch") -> None:
        """Take others in."""
        if self.members:
            known, new = self.state, others.state
            self.state = {name: np.concatenate([known[name], new[name]]) for name in known}
        else:
            self.state = others.state
        self.members = [*self.members, *others.members]

    def take(self, outputs: Outputs, steps: int) -> list[_Request[Any]]:
        """Give every member its rows of steps' outputs; remove and return ended members."""
        shares = zip(self.members, self._shares(outputs), strict=True)
        going_on = [member for member, share in shares if member.take(share, steps)]
        ended = [member for member in going_on if member.ended]
        self.keep([member for member in going_on if not member.ended])
        return ended

    def keep(self, kept: list[_Request[Any]]) -> None:
        """Let go of all other members."""
        if len(kept) == len(self.members):
            return
        stays = np.repeat([m in kept for m in self.members], [m.rows for m in self.members])
        self.state = {name: values[stays] for name, values in self.state.items()}
        self.members = kept

    def fail(self, error: BaseException) -> None:
        """Answer all members with an error."""
        for member in self.members:
            member.future.set_exception(error)
        self.members = []

    def _shares(self, outputs: Outputs) -> list[Outputs]:
        """Every member's rows of steps' outputs."""
        if len(self.members) == 1:
            return [outputs]
        ends = np.cumsum([member.rows for member in self.members])
        rows = [slice(end - m.rows, end) for m, end in zip(self.members, ends, strict=True)]
        return [
            {
                name: values[:, own] if SPECS[name].is_per_step else values[own]
                for name, values in outputs.items()
            }
            for own in rows
        ]


@dataclass(eq=False)
class _Rollout:
    """The requests that step together through one model."""

    predictor: Predictor
    count: Callable[[float], None]
    here: _Batch = field(default_factory=lambda: _Batch([], {}))
    pending: list[_Batch] = field(default_factory=list[_Batch])
    led: bool = False

    @property
    def rows(self) -> int:
        """Number of forecasts, including those of requests that join with the next step."""
        return self.here.rows + sum(arrived.rows for arrived in self.pending)

    def advance(self) -> list[_Request[Any]]:
        """Take steps of all requests that are not cancelled; return ended requests."""
        here = self.here
        here.keep([m for m in here.members if m.fail_safely(m.token.raise_if_cancelled)])
        if not here.members:
            return []
        self.count(here.rows)
        steps = min(STEPS_TOGETHER, max(m.horizon - m.steps for m in here.members))
        try:
            here.state, outputs = self.predictor.advance(here.state, steps)
        except BaseException as error:  # any exception of the runtime
            here.fail(error)
            return []
        return here.take(outputs, steps)


class Scheduler:
    """Threads that answer a bounded number of requests.

    Parameters
    ----------
    threads
        Number of computing threads, usually that of the cores.
    capacity
        Maximum number of requests, waiting ones included.
    max_batch
        Number of forecasts at which a rollout begins although more frames wait.
    shown
        Gauge of the number of requests.
    batches
        Factory of the callback that receives the number of forecasts of every call of a rollout.
    """

    def __init__(
        self,
        threads: int,
        capacity: int,
        max_batch: int,
        shown: Gauge,
        batches: Callable[[Predictor], Callable[[float], None]],
    ) -> None:
        self._admission = AdmissionLimit(capacity, shown)
        self._max_batch = max_batch
        self._batches = batches
        self._closed = False
        self._waiting: deque[_Request[Any]] = deque()
        self._rollouts: dict[Predictor, _Rollout] = {}
        self._ended: deque[_Request[Any]] = deque()
        self._lock = threading.Lock()
        self._resting: list[threading.Semaphore] = []
        self._threads = [
            threading.Thread(target=self._work, name=f"forecast-{index}", daemon=True)
            for index in range(threads)
        ]
        self._slow: SimpleQueue[_Request[Any] | None] = SimpleQueue()
        self._slow_threads = [
            threading.Thread(target=self._decode_slowly, name=f"decode-{index}", daemon=True)
            for index in range(math.ceil(threads / 2))
        ]
        for thread in (*self._threads, *self._slow_threads):
            thread.start()

    @property
    def idle(self) -> bool:
        """True if it holds no request."""
        return self._admission.idle

    def submit(self, job: Job[T], token: CancellationToken) -> Future[T]:
        """Take a request. Cancelled before its turn, it never begins.

        Raises
        ------
        QueueFullError
            When ``capacity`` requests are being held.
        """
        self._admission.acquire()
        future: Future[T] = Future()
        future.add_done_callback(self._release)
        with self._lock:
            self._waiting.append(_Request(job, token, future))
            self._wake(1)
        return future

    def _release(self, _: Future[T]) -> None:
        self._admission.release()

    def close(self) -> None:
        """Finish rollouts and cancel waiting requests; do not wait for threads in long calls."""
        with self._lock:
            self._closed = True
            dropped, self._waiting = self._waiting, deque()
            self._wake(len(self._threads))
        for member in dropped:
            member.future.cancel()
        for _ in self._slow_threads:
            self._slow.put(None)
        ends = time.monotonic() + MAX_CLOSE_S
        for thread in (*self._threads, *self._slow_threads):
            thread.join(max(0, ends - time.monotonic()))

    def _wake(self, threads: int) -> None:
        """Wake idle threads, under the lock: the latest one first, because its caches are warm."""
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
        """Choose the next work, under the lock."""
        if self._ended:
            return self._ended.popleft().finish
        free = [rollout for rollout in self._rollouts.values() if not rollout.led]
        full = [rollout for rollout in free if rollout.rows >= self._max_batch]
        if self._waiting and not full:
            room = self._max_batch - max((rollout.rows for rollout in free), default=0)
            members = self._next_waiting(room)
            two_cores = bool(self._resting)
            return lambda: self._begin(members, two_cores)
        if not free:
            return None
        chosen = (full or free)[0]
        chosen.led = True
        return lambda: self._lead(chosen)

    def _next_waiting(self, room: int) -> list[_Request[Any]]:
        """Take a thread's share of the waiting requests, under the lock, at most ``room``."""
        share = math.ceil(len(self._waiting) / len(self._threads))
        taken = [self._waiting.popleft() for _ in range(min(share, ENCODED_TOGETHER, room))]
        return [
            member
            for member in taken
            if member.decoded is not None or member.future.set_running_or_notify_cancel()
        ]

    def _decode_slowly(self) -> None:
        """Decode large images, of one request after the other."""
        while (member := self._slow.get()) is not None:
            assert member.slow is not None
            slow, member.slow = member.slow, None
            member.decode(slow)
            if member.decoded is not None:
                with self._lock:
                    self._waiting.appendleft(member)
                    self._wake(1)

    def _begin(self, members: list[_Request[Any]], two_cores: bool) -> None:
        """Encode the frames of some requests, those for one model in one batch.

        While another thread rests its core helps, so that a request alone is there sooner.
        """
        by_model: dict[Predictor, list[tuple[_Request[Any], DecodedRequest]]] = defaultdict(list)
        for member in members:
            if member.decoded is None:
                member.decode(member.job.begin)
            seen, member.decoded = member.decoded, None
            if seen is not None:
                by_model[seen.predictor].append((member, seen))
            elif member.slow is not None:
                self._slow.put(member)
        for predictor, group in by_model.items():
            together = _Batch([member for member, _ in group], {})
            parts = [seen.frames for _, seen in group]
            try:
                frames = parts[0] if len(parts) == 1 else np.concatenate(parts)
                step = predictor.encode(frames, two_cores=two_cores)
            except BaseException as error:  # any exception of the runtime
                together.fail(error)
                continue
            together.state = step.state
            for member in together.take(step.as_steps, 1):
                member.finish()
            self._begin_anew([member for member, _ in group if member.waits])
            if together.members:
                self._arrive(predictor, together)

    def _begin_anew(self, members: list[_Request[Any]]) -> None:
        """Let requests that another model takes over wait for a thread, before all others."""
        for member in members:
            if member.slow is not None:
                self._slow.put(member)
                continue
            with self._lock:
                self._waiting.appendleft(member)
                self._wake(1)

    def _arrive(self, predictor: Predictor, together: _Batch) -> None:
        """Let requests join the rollout of their model with its next step."""
        with self._lock:
            if predictor not in self._rollouts:
                self._rollouts[predictor] = _Rollout(predictor, self._batches(predictor))
            self._rollouts[predictor].pending.append(together)

    def _lead(self, rollout: _Rollout) -> None:
        """Step a rollout until it is empty, or no other thread can write its answers."""
        while True:
            with self._lock:
                for arrived in rollout.pending:
                    rollout.here.join(arrived)
                rollout.pending = []
                if not rollout.here.members:
                    del self._rollouts[rollout.predictor]
                    return
            ended = rollout.advance()
            if ended and not self._hand_over(rollout, ended):
                return

    def _hand_over(self, rollout: _Rollout, ended: list[_Request[Any]]) -> bool:
        """Leave responses to idle threads; return whether the rollout still needs a leader."""
        with self._lock:
            self._ended.extend(ended)
            if self._resting and (rollout.here.members or rollout.pending):
                self._wake(len(ended))
                return True
            # A thread that stops leading writes a response next.
            rollout.led = False
            self._wake(len(ended) - 1)
            return False
