import asyncio
import threading
from concurrent.futures import ThreadPoolExecutor

import pytest
from prometheus_client import Gauge

from service.errors import QueueFullError
from service.inference.admission import Workers
from service.inference.deadlines import CancellationToken
from tests.service import samples
from tests.service.samples import body


@pytest.fixture
def workers():
    workers = Workers(Threads(), 2, Gauge("held", "Calls", registry=None))
    yield workers
    workers.close()


class Threads(ThreadPoolExecutor):
    """One thread, whose calls go on when they are abandoned."""

    def __init__(self) -> None:
        super().__init__(1)

    def submit(self, abandoned, call, /, *args):
        return super().submit(call, *args)

    def close(self) -> None:
        self.shutdown(cancel_futures=True)


async def run(workers, call, *args):
    return await asyncio.wrap_future(workers.submit(CancellationToken(), call, *args))


def test_a_full_queue_refuses_at_once_and_recovers(workers):
    gate = threading.Event()

    async def scenario():
        waiting = [asyncio.create_task(run(workers, gate.wait, 30)) for _ in range(2)]
        await asyncio.sleep(0)
        with pytest.raises(QueueFullError):
            await run(workers, gate.wait, 30)
        gate.set()
        assert await asyncio.gather(*waiting) == [True, True]
        assert await run(workers, max, 1, 2) == 2

    asyncio.run(scenario())


def test_a_call_that_is_cancelled_before_its_turn_never_runs(workers):
    gate, ran = threading.Event(), threading.Event()

    async def scenario():
        running = asyncio.create_task(run(workers, gate.wait, 30))
        await asyncio.sleep(0)
        waiting = asyncio.create_task(run(workers, ran.set))
        await asyncio.sleep(0)
        waiting.cancel()
        with pytest.raises(asyncio.CancelledError):
            await waiting
        gate.set()
        await running
        await run(workers, max, 1, 2)

    asyncio.run(scenario())
    assert not ran.is_set()


def test_a_full_queue_is_429_with_retry_after(start):
    gate, entered = threading.Event(), threading.Semaphore(0)
    model = samples.served()

    class Slow(samples.DotPredictor):
        def encode(self, frames, *, two_cores=False):
            entered.release()
            gate.wait(30)
            return super().encode(frames, two_cores=two_cores)

    slow = samples.Model("dot", 1, model.manifest, Slow(model.manifest))
    client = start(
        lambda _: samples.Registry([slow]),
        inference_threads=1,
        inference_queue=0,
    )
    statuses = []
    first = threading.Thread(
        target=lambda: statuses.append(client.post("/predict", json=body()).status_code)
    )
    first.start()
    try:
        assert entered.acquire(timeout=30)
        refused = client.post("/predict", json=body())
        assert refused.status_code == 429
        assert refused.headers["retry-after"] == "1"
        assert refused.json()["type"] == "/problems/queue-full"
    finally:
        gate.set()
        first.join()
    assert statuses == [200]
    assert client.post("/predict", json=body()).status_code == 200


def test_no_memory_left_is_503(start):
    model = samples.served()

    class Hungry(samples.DotPredictor):
        def encode(self, frames, *, two_cores=False):
            raise MemoryError

    hungry = samples.Model("dot", 1, model.manifest, Hungry(model.manifest))
    client = start(lambda _: samples.Registry([hungry]))
    for path in ("/predict", "/predict/stream"):
        answer = client.post(path, json=body())
        assert (answer.status_code, answer.headers["retry-after"]) == (503, "1")
        assert answer.json()["type"] == "/problems/out-of-memory"
