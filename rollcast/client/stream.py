"""The events of ``/predict/stream`` put together, for both clients."""

import httpx2

from rollcast.client.answers import problem_error, unexpected
from rollcast.client.calls import Call
from rollcast.client.results import Forecast, ForecastStep
from rollcast.errors import UnexpectedAnswerError
from rollcast.schemas import Problem, StreamDone, StreamStep

EVENTS = "text/event-stream"


class StreamAssembler:
    """The part of a streamed forecast that has arrived.

    Parameters
    ----------
    response
        The response whose body consists of the events.
    call
        The call that it answers.

    Raises
    ------
    UnexpectedAnswerError
        When the body is not a stream of events.
    """

    def __init__(self, response: httpx2.Response, call: Call[Forecast]) -> None:
        kind = response.headers.get("content-type", "").partition(";")[0].strip().lower()
        if kind != EVENTS:
            raise unexpected(response, f"its content type is {kind!r}, expected {EVENTS!r}")
        response.encoding = "utf-8"  # event streams are always UTF-8, regardless of the header
        self.forecast: Forecast | None = None
        """The whole forecast, once the stream has ended."""
        self._response = response
        self._call = call
        self._steps: list[StreamStep] = []

    def take(self, event: httpx2.ServerSentEvent) -> ForecastStep | None:
        """Take the next event and return its step, if it is one.

        Raises
        ------
        ProblemError
            When the service gave up.
        UnexpectedAnswerError
            When it is not an event of this API, or contradicts those before it.
        """
        try:
            match event.event:
                case "step":
                    return self._take_step(StreamStep.model_validate_json(event.data))
                case "done":
                    done = StreamDone.model_validate_json(event.data)
                    self.forecast = self._call.finish(Forecast.from_events(self._steps, done))
                case "error":
                    raise problem_error(Problem.model_validate_json(event.data))
                case _:  # a newer service may send more kinds
                    pass
        except ValueError as error:
            raise unexpected(self._response, error) from error
        return None

    def ended(self) -> UnexpectedAnswerError:
        """Return the exception for a stream that ends before the forecast does."""
        return UnexpectedAnswerError(
            f"{self._response.url} broke off after {len(self._steps)} steps",
            self._response.status_code,
        )

    def _take_step(self, step: StreamStep) -> ForecastStep:
        if step.step != len(self._steps):
            raise ValueError(f"step {step.step} follows {len(self._steps)} steps")
        first = self._steps[0] if self._steps else step
        if [ball.id for ball in step.objects] != [ball.id for ball in first.objects]:
            raise ValueError(f"step {step.step} has other objects than step 0")
        if step.time_s <= (self._steps[-1].time_s if self._steps else -1.0):
            raise ValueError(f"the time of step {step.step} is not after that of the one before")
        self._call.expect_at_most(len(self._steps) + 1)
        self._steps.append(step)
        return ForecastStep.from_event(step)
