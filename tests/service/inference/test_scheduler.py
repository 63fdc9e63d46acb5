"""Rollouts that step together answer as rollouts alone do."""

import threading
from concurrent.futures import wait

import numpy as np
import pytest
from prometheus_client import Gauge

from rollcast.rollout import Step
from service.errors import QueueFullError
from service.inference.deadlines import CancellationToken, ClientGoneError
from service.inference.scheduler import DecodedRequest, Scheduler
from tests.service import samples

SECONDS = 30


class Counting:
    """A network whose numbers count up from what the frames show; it notes how many step."""

    manifest = samples.manifest()

    def __init__(self) -> None:
        self.batches: list[int] = []
        self.encoded: list[int] = []
        self.two_cores: list[bool] = []
        self.gate = threading.Event()
        self.gate.set()

    def encode(self, frames, *, two_cores=False):
        self.encoded.append(len(frames))
        self.two_cores.append(two_cores)
        return self.step(frames)

    def advance(self, state, steps):
        return samples.one_by_one(self.next, state, steps)

    def next(self, state):
        assert self.gate.wait(SECONDS)
        self.batches.append(len(state["count"]))
        return self.step(state["count"] + 1)

    def step(self, count):
        return Step({"count": count}, {"positions": np.stack([count, count], axis=-1)[:, None]})


class Count:
    """A job that begins with some numbers and keeps what it is told."""

    def __init__(self, network, begin, horizon, encoding=None):
        self.network, self.horizon = network, horizon
        self.numbers = np.array(begin, np.float32)
        self.encoding = encoding
        self.seen = []

    def begin(self):
        if self.encoding is not None:
            assert self.encoding.wait(SECONDS)
        return DecodedRequest(self.network, self.numbers, self.horizon)

    def take(self, outputs):
        self.seen += list(outputs["positions"][:, :, 0, 0])

    def finish(self):
        return np.stack(self.seen, axis=1).tolist()

    @property
    def expected(self):
        return (self.numbers[:, None] + np.arange(self.horizon)).tolist()


@pytest.fixture
def network():
    return Counting()


@pytest.fixture
def start():
    """Make schedulers with a number of threads."""
    made: list[Scheduler] = []

    def _start(threads=2, capacity=64, max_batch=16) -> Scheduler:
        held = Gauge("held", "Requests", registry=None)
        made.append(Scheduler(threads, capacity, max_batch, held, lambda _: lambda _: None))
        return made[-1]

    yield _start
    for scheduler in made:
        scheduler.close()


@pytest.mark.parametrize("threads", [1, 2, 4])
def test_requests_of_any_size_and_horizon_get_their_own_steps(start, network, threads):
    scheduler = start(threads)
    generator = np.random.default_rng(5)
    jobs = [
        Count(network, generator.integers(0, 1000, size=1 + k % 3), 1 + int(generator.integers(30)))
        for k in range(60)
    ]
    futures = [scheduler.submit(job, CancellationToken()) for job in jobs]
    assert [future.result(SECONDS) for future in futures] == [job.expected for job in jobs]
    assert scheduler.idle


def test_a_core_that_is_idle_helps_a_request_alone(start, network):
    scheduler = start(threads=2)
    for begin in (10, 20):
        assert scheduler.submit(job := Count(network, [begin], 3), CancellationToken()).result(
            SECONDS
        )
        assert len(job.seen) == 3
    assert network.two_cores == [True, True]


def test_no_core_helps_while_all_compute(start, network):
    scheduler = start(threads=2)
    network.gate.clear()
    first = scheduler.submit(Count(network, [10], 3), CancellationToken())
    while not network.encoded:  # its rollout waits at the gate
        threading.Event().wait(0.001)
    second = scheduler.submit(Count(network, [20], 1), CancellationToken())
    second.result(SECONDS)
    network.gate.set()
    first.result(SECONDS)
    assert network.two_cores == [True, False]


def test_one_thread_is_never_helped(start, network):
    start(threads=1).submit(Count(network, [10], 3), CancellationToken()).result(SECONDS)
    assert network.two_cores == [False]


def test_what_waits_is_encoded_first_and_then_steps_together(start, network):
    scheduler = start(threads=1)
    encoding = threading.Event()
    jobs = [Count(network, [10 * k], 5, encoding) for k in range(8)]
    futures = [scheduler.submit(job, CancellationToken()) for job in jobs]
    encoding.set()
    wait(futures, SECONDS)
    assert network.batches == [8] * 4


def test_a_full_batch_steps_although_frames_wait(start, network):
    scheduler = start(threads=1, max_batch=3)
    encoding = threading.Event()
    jobs = [Count(network, [10 * k], 5, encoding) for k in range(7)]
    futures = [scheduler.submit(job, CancellationToken()) for job in jobs]
    encoding.set()
    wait(futures, SECONDS)
    assert network.batches == [3] * 4 + [3] * 4 + [1] * 4


def test_a_request_joins_while_others_step(start, network):
    scheduler = start(threads=2)
    network.gate.clear()
    first = scheduler.submit(Count(network, [0], 50), CancellationToken())
    second = Count(network, [100], 50)
    joined = scheduler.submit(second, CancellationToken())
    while not network.gate.is_set():
        if len(second.seen) == 1:
            network.gate.set()
    assert (first.result(SECONDS), joined.result(SECONDS)) == (
        [np.arange(50.0).tolist()],
        second.expected,
    )
    assert max(network.batches) == 2
    assert sum(network.batches) == 2 * 49


def test_whoever_goes_away_leaves_with_the_next_step(start, network):
    scheduler = start(threads=1)
    token = CancellationToken()
    encoding = threading.Event()
    leaving = scheduler.submit(Count(network, [0, 1], 1000, encoding), token)
    staying = Count(network, [7], 20, encoding)
    stays = scheduler.submit(staying, CancellationToken())
    token.cancel()
    encoding.set()
    assert stays.result(SECONDS) == staying.expected
    assert isinstance(leaving.exception(SECONDS), ClientGoneError)
    assert set(network.batches) == {1}


def blocked(scheduler: Scheduler, network: Counting) -> threading.Event:
    """Keep the only thread of a scheduler busy until the event is set."""
    encoding, begun = threading.Event(), threading.Event()

    class Blocking(Count):
        def begin(self):
            begun.set()
            return super().begin()

    scheduler.submit(Blocking(network, [0], 1, encoding), CancellationToken())
    assert begun.wait(SECONDS)
    return encoding


def test_what_waits_is_encoded_a_few_at_a_time(start, network):
    scheduler = start(threads=1)
    encoding = blocked(scheduler, network)
    jobs = [Count(network, [10 * k], 1 + k) for k in range(6)]
    futures = [scheduler.submit(job, CancellationToken()) for job in jobs]
    encoding.set()
    assert [future.result(SECONDS) for future in futures] == [job.expected for job in jobs]
    assert network.encoded == [1, 4, 2]


def test_threads_share_out_what_waits(start, network):
    scheduler = start(threads=4)
    gate = threading.Event()
    everybody = threading.Barrier(5)

    class Waiting(Count):
        def begin(self):
            everybody.wait(SECONDS)
            assert gate.wait(SECONDS)
            return super().begin()

    first = [scheduler.submit(Waiting(network, [k], 1), CancellationToken()) for k in range(4)]
    everybody.wait(SECONDS)
    later = [scheduler.submit(Count(network, [k], 1), CancellationToken()) for k in range(4)]
    gate.set()
    wait([*first, *later], SECONDS)
    assert network.encoded == [1] * 8


def test_requests_for_several_models_are_encoded_apart(start, network):
    other = Counting()
    scheduler = start(threads=1)
    encoding = blocked(scheduler, network)
    jobs = [Count(of, [10 * k], 3) for k, of in enumerate([network, other, network])]
    futures = [scheduler.submit(job, CancellationToken()) for job in jobs]
    encoding.set()
    assert [future.result(SECONDS) for future in futures] == [job.expected for job in jobs]
    assert (network.encoded, other.encoded) == ([1, 2], [1])


def test_frames_that_cannot_be_read_fail_nobody_else(start, network):
    class Broken(Count):
        def begin(self):
            raise ValueError("a damaged image")

    scheduler = start(threads=1)
    encoding = blocked(scheduler, network)
    broken = scheduler.submit(Broken(network, [5], 3), CancellationToken())
    other = Count(network, [6], 3)
    answered = scheduler.submit(other, CancellationToken())
    encoding.set()
    assert answered.result(SECONDS) == other.expected
    with pytest.raises(ValueError, match="damaged"):
        broken.result(SECONDS)


class Slow(Count):
    """A job whose images are large."""

    def begin(self):
        return super().begin


@pytest.mark.parametrize("threads", [1, 2])
def test_large_images_keep_no_small_request_waiting(start, network, threads):
    scheduler, encoding = start(threads), threading.Event()
    large = [Slow(network, [index], 3, encoding) for index in range(6)]
    waiting = [scheduler.submit(job, CancellationToken()) for job in large]
    small = Count(network, [10], 3)
    assert scheduler.submit(small, CancellationToken()).result(SECONDS) == small.expected
    assert not any(future.done() for future in waiting)
    encoding.set()
    assert [future.result(SECONDS) for future in waiting] == [job.expected for job in large]
    assert scheduler.idle


def test_a_large_image_that_cannot_be_read_fails_nobody_else(start, network):
    class Broken(Slow):
        def begin(self):
            return self.fail

        def fail(self):
            raise ValueError("no image")

    scheduler = start()
    broken = scheduler.submit(Broken(network, [1], 3), CancellationToken())
    other = Slow(network, [2], 3)
    assert scheduler.submit(other, CancellationToken()).result(SECONDS) == other.expected
    with pytest.raises(ValueError, match="no image"):
        broken.result(SECONDS)
    cancelled = CancellationToken()
    cancelled.cancel()
    with pytest.raises(ClientGoneError):
        scheduler.submit(other, cancelled).result(SECONDS)
    assert scheduler.idle


class Replaced(Count):
    """A job that another network begins anew after the first step."""

    def __init__(self, network, begin, horizon, encoding=None, *, slow=False):
        super().__init__(network, begin, horizon, encoding)
        self.other = Counting()
        self.slow = slow
        self.was_replaced = False

    def take(self, outputs):
        if not self.was_replaced:
            assert len(outputs["positions"]) == 1
            self.was_replaced = True
            instead = DecodedRequest(self.other, self.numbers + 1000, self.horizon)
            return (lambda: instead) if self.slow else instead
        return super().take(outputs)


@pytest.mark.parametrize("slow", [False, True])
@pytest.mark.parametrize("horizon", [1, 12])
def test_another_network_may_begin_a_request_anew(start, network, slow, horizon):
    scheduler = start(threads=1)
    encoding = threading.Event()
    replaced = Replaced(network, [5, 6], horizon, encoding, slow=slow)
    beside = Count(network, [7], horizon, encoding)
    answers = [scheduler.submit(job, CancellationToken()) for job in (replaced, beside)]
    encoding.set()
    steps = np.arange(horizon)
    assert answers[0].result(SECONDS) == [list(1005 + steps), list(1006 + steps)]
    assert answers[1].result(SECONDS) == beside.expected
    assert replaced.other.encoded == [2]
    assert scheduler.idle


def test_a_request_that_fails_to_begin_anew_fails_alone(start, network):
    class Failing(Count):
        def take(self, outputs):
            def decode():
                raise ValueError("no image")

            return decode

    scheduler = start(threads=1)
    encoding = threading.Event()
    failing = scheduler.submit(Failing(network, [5], 3, encoding), CancellationToken())
    beside = Count(network, [6], 3, encoding)
    answered = scheduler.submit(beside, CancellationToken())
    encoding.set()
    assert answered.result(SECONDS) == beside.expected
    with pytest.raises(ValueError, match="no image"):
        failing.result(SECONDS)
    assert scheduler.idle


def test_one_failure_is_the_answer_of_one_request(start, network):
    class Failing(Count):
        def take(self, outputs):
            if len(self.seen) == 1:
                raise ValueError("a number is not finite")
            super().take(outputs)

    scheduler = start(threads=1)
    encoding = threading.Event()
    failing = scheduler.submit(Failing(network, [5], 10, encoding), CancellationToken())
    other = Count(network, [6], 10, encoding)
    answered = scheduler.submit(other, CancellationToken())
    encoding.set()
    assert answered.result(SECONDS) == other.expected
    with pytest.raises(ValueError, match="not finite"):
        failing.result(SECONDS)


@pytest.mark.parametrize("method", ["encode", "advance"])
def test_a_network_that_fails_fails_those_who_share_its_batch(start, network, method):
    def fail(*_, **__):
        raise RuntimeError("out of memory")

    setattr(network, method, fail)
    scheduler = start(threads=1)
    failed = [scheduler.submit(Count(network, [k], 3), CancellationToken()) for k in range(3)]
    for future in failed:
        assert isinstance(future.exception(SECONDS), RuntimeError)
    after = Count(Counting(), [1], 3)
    assert scheduler.submit(after, CancellationToken()).result(SECONDS) == after.expected


def test_a_full_scheduler_refuses(start, network):
    scheduler = start(threads=1, capacity=2)
    network.gate.clear()
    held = [scheduler.submit(Count(network, [k], 3), CancellationToken()) for k in range(2)]
    with pytest.raises(QueueFullError, match="2 requests"):
        scheduler.submit(Count(network, [9], 3), CancellationToken())
    network.gate.set()
    wait(held, SECONDS)
    late = Count(network, [9], 3)
    assert scheduler.submit(late, CancellationToken()).result(SECONDS) == late.expected


def test_what_is_cancelled_before_its_turn_never_begins(start, network):
    scheduler = start(threads=1)
    network.gate.clear()
    running = scheduler.submit(Count(network, [0], 3), CancellationToken())
    while not running.running():
        pass
    encoding = threading.Event()
    blocking = scheduler.submit(Count(network, [1], 2, encoding), CancellationToken())
    dropped = Count(network, [2], 3)
    assert scheduler.submit(dropped, CancellationToken()).cancel()
    encoding.set()
    network.gate.set()
    wait([running, blocking], SECONDS)
    assert dropped.seen == []


def test_closing_answers_what_steps_and_drops_what_waits(network):
    held = Gauge("held", "Requests", registry=None)
    scheduler = Scheduler(1, 9, 16, held, lambda _: lambda _: None)
    network.gate.clear()
    running = scheduler.submit(Count(network, [0], 3), CancellationToken())
    while network.gate.is_set() or not running.running():
        pass
    closing = threading.Thread(target=scheduler.close)
    closing.start()
    network.gate.set()
    closing.join(SECONDS)
    assert running.result(SECONDS) == [[0, 1, 2]]
