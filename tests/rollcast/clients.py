"""Both clients with one face, so that each test of the one is a test of the other."""

import asyncio
import inspect

import httpx2

from rollcast.client import AsyncClient, AsyncForecastStream, AsyncSession

PROBLEM = {
    "type": "/problems/invalid-value",
    "title": "A value is invalid",
    "status": 422,
    "detail": "horizon: expected more",
    "field": "horizon",
    "value": 0,
    "expected": "more",
}


def problem(status, headers=None):
    return httpx2.Response(status, json=PROBLEM | {"status": status}, headers=headers)


class Awaiting:
    """An ``AsyncClient`` in a loop of its own, whose methods wait for what they return."""

    def __init__(self, *arguments, **named):
        self._runner = asyncio.Runner()
        self._client = AsyncClient(*arguments, **named)

    def __getattr__(self, name):
        method = getattr(self._client, name)

        def call(*arguments, **named):
            returned = method(*arguments, **named)
            if isinstance(returned, AsyncForecastStream):
                return AwaitingStream(self._runner, returned)
            if isinstance(returned, AsyncSession):
                return AwaitingSession(self._runner, returned)
            assert inspect.iscoroutine(returned)
            return self._runner.run(returned)

        return call

    def __enter__(self):
        self._runner.run(self._client.__aenter__())
        return self

    def __exit__(self, *raised):
        self._runner.run(self._client.__aexit__(*raised))
        self._runner.close()


class AwaitingStream:
    """The same of an ``AsyncForecastStream``."""

    def __init__(self, runner, stream):
        self._runner, self._stream = runner, stream

    @property
    def forecast(self):
        return self._stream.forecast

    def close(self):
        self._runner.run(self._stream.close())

    def __iter__(self):
        return self

    def __next__(self):
        try:
            return self._runner.run(_next(self._stream))
        except EOFError:
            raise StopIteration from None

    def __enter__(self):
        self._runner.run(self._stream.__aenter__())
        return self

    def __exit__(self, *raised):
        self._runner.run(self._stream.__aexit__(*raised))


class AwaitingSession:
    """The same of an ``AsyncSession``."""

    def __init__(self, runner, session):
        self._runner, self._session = runner, session

    def __getattr__(self, name):
        method = getattr(self._session, name)
        return lambda *arguments, **named: self._runner.run(method(*arguments, **named))

    def __enter__(self):
        self._runner.run(self._session.__aenter__())
        return self

    def __exit__(self, *raised):
        self._runner.run(self._session.__aexit__(*raised))


async def _next(stream):
    try:
        return await anext(stream)
    except StopAsyncIteration:  # which no coroutine may raise
        raise EOFError from None


class Arriving(httpx2.SyncByteStream, httpx2.AsyncByteStream):
    """A body whose parts arrive one by one; an exception among them is raised."""

    def __init__(self, parts):
        self.parts = list(parts)
        self.sent = 0
        self.closed = False

    def __iter__(self):
        for part in self.parts:
            if isinstance(part, Exception):
                raise part
            self.sent += 1
            yield part

    async def __aiter__(self):
        for part in self:
            yield part

    def close(self):
        self.closed = True

    async def aclose(self):
        self.closed = True
