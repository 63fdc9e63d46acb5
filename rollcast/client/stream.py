"""The events of ``/predict/stream`` put together, whichever client reads them."""

import httpx2
from pydantic import ValidationError

from rollcast.client.calls import problem_error, unexpected
from rollcast.client.results import Forecast, ForecastStep
from rollcast.errors import UnexpectedAnswerError
from rollcast.schemas import Problem, StreamDone, StreamStep

EVENTS = "text/event-stream"


class Arrivals:
    """What of a streamed forecast has arrived.

    Parameters
    ----------
    response
        Whose body the events are.

    Raises
    ------
    UnexpectedAnswerError
        When its body is no stream of events.
    """

    def __init__(self, response: httpx2.Response) -> None:
        if response.headers.get("content-type", "").partition(";")[0].strip() != EVENTS:
            raise unexpected(response)
        self.forecast: Forecast | None = None
        """All of it, once it has ended."""
        self._response = response
        self._steps: list[StreamStep] = []

    def take(self, event: httpx2.ServerSentEvent) -> ForecastStep | None:
        """Take the next event and return its step, if it is one.

        Raises
        ------
        ProblemError
            When the service gave up.
        UnexpectedAnswerError
            When it is not an event of this API's.
        """
        try:
            match event.event:
                case "step":
                    step = StreamStep.model_validate_json(event.data)
                    self._steps.append(step)
                    return ForecastStep.from_event(step)
                case "done":
                    done = StreamDone.model_validate_json(event.data)
                    self.forecast = Forecast.from_events(self._steps, done)
                case "error":
                    raise problem_error(Problem.model_validate_json(event.data))
                case _:  # a newer service may tell more
                    pass
        except ValidationError as error:
            raise unexpected(self._response) from error
        return None

    def broken_off(self) -> UnexpectedAnswerError:
        """Return the exception for a stream that ends before the forecast does."""
        return UnexpectedAnswerError(
            f"{self._response.url} broke off after {len(self._steps)} steps",
            self._response.status_code,
        )
