"""The budget of bytes over all bodies, in the app and by itself."""

import asyncio

import pytest

from service.errors import TooManyBodiesError
from service.inference.body_budget import BodyBudget
from tests.service.samples import body


def give_up(timeout: asyncio.Timeout):
    """Return what ends the reading of a body."""
    return lambda: timeout.reschedule(asyncio.get_running_loop().time())


def test_the_largest_body_that_arrives_is_given_up():
    async def scenario() -> list[str]:
        budget, ended = BodyBudget(100), []

        async def read(name: str, pieces: list[int]) -> None:
            with budget.body() as held:
                try:
                    async with asyncio.timeout(60) as timeout:
                        held.give_up = give_up(timeout)
                        for piece in pieces:
                            budget.grow(held, piece)
                            await asyncio.sleep(0)
                        await asyncio.sleep(0.1)
                except (TimeoutError, TooManyBodiesError):
                    assert held.evicted or name == "greedy"
                    ended.append(name)
                finally:
                    held.give_up = None

        await asyncio.gather(read("large", [60]), read("small", [10] * 5), read("tiny", [1]))
        await read("greedy", [101])
        assert budget.size == 0
        return ended

    assert asyncio.run(scenario()) == ["large", "greedy"]


def test_what_has_been_read_is_not_given_up_and_leaves_no_room():
    async def scenario() -> None:
        budget = BodyBudget(100)
        with budget.body() as waiting:
            waiting.give_up = lambda: None
            budget.grow(waiting, 90)
            waiting.give_up = None
            with budget.body() as late:
                late.give_up = lambda: None
                with pytest.raises(TooManyBodiesError):
                    budget.grow(late, 20)
            assert not waiting.evicted
        assert budget.size == 0

    asyncio.run(scenario())


def test_a_body_over_the_budget_is_503_and_the_next_is_read(start):
    client = start(max_total_body_bytes=100_000)
    while client.get("/health/ready").status_code != 200:
        pass
    refused = client.post("/predict", json={"model": "x" * 200_000})
    assert (refused.status_code, refused.headers["retry-after"]) == (503, "1")
    assert refused.json()["type"] == "/problems/too-many-bodies"
    for _ in range(20):
        assert client.post("/predict", json=body(horizon=1)).status_code == 200
