"""Errors of the service, with their HTTP status and stable type.

* ServiceError
  x MalformedBodyError         400  the body cannot be parsed
  x UnauthorizedError          401  an API key is missing, unknown or has expired
  x ForbiddenError             403  the key lacks the scope
  x OriginError                403  a web page of another origin opens a session
  x UnknownModelError          404
  x BodyTooSlowError           408
  x BodyTooLargeError          413
  x UnsupportedMediaTypeError  415  neither JSON nor multipart, or a compressed body
  x NotAnImageError            415  neither PNG nor JPEG nor WebP
  x BrokenImageError           422  the header is fine, the pixels are not
  x InvalidValueError          422  one or several values are wrong
  x NoSuitableModelError       422  "auto" finds no model for the request
  x SceneRejectedProblem       422  the rejection rules dropped every scene
  x DivergedError              422  the forecast leaves every bound before its horizon
  x QueueFullError             429
  x TooManyRequestsError       429  one key, or one address, asks more often than it may
  x SimulationMissingError     501  PyBullet is not installed
  x SimulationLostError        503  the process that simulates died of it, or cannot be started
  x TooManyBodiesError         503  all bodies that are being read exceed their budget
  x OutOfMemoryError           503  the machine, or the container, has no memory left for it
  x ModelUnavailableError      503  the model exists and is not served
  x NotReadyError              503  no model is served, yet or any more
  x DeadlineExceededError      504  the answer takes longer than the client waits

``service/http/problem_details.py`` turns them into problem documents (RFC 9457).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from rollcast.errors import RollcastError


@dataclass(frozen=True)
class InvalidField:
    """One invalid value of a request: field, given value, expected value."""

    field: str
    value: object
    expected: str


class ServiceError(RollcastError):
    """Base class of the service's errors.

    Parameters
    ----------
    detail
        Description of the error, a sentence.
    field_errors
        Invalid values, if any.
    """

    status: ClassVar[int]
    slug: ClassVar[str]
    title: ClassVar[str]

    def __init__(self, detail: str, field_errors: Sequence[InvalidField] = ()) -> None:
        super().__init__(detail, field_errors)
        self.detail = detail
        self.field_errors = tuple(field_errors)

    @classmethod
    def at(cls, field: str, value: object, expected: str) -> "ServiceError":
        """Return the refusal of one value of one field."""
        return cls(f"{field}: expected {expected}", [InvalidField(field, value, expected)])


class MalformedBodyError(ServiceError):
    """The body does not match its content type."""

    status, slug, title = 400, "malformed-body", "The body cannot be read"


class UnauthorizedError(ServiceError):
    """The request has no API key that is good."""

    status, slug, title = 401, "unauthorized", "An API key is required"


class ForbiddenError(ServiceError):
    """The API key lacks the scope."""

    status, slug, title = 403, "forbidden", "The API key lacks a scope"


class OriginError(ServiceError):
    """A web page of an origin that is not allowed opens a session."""

    status, slug, title = 403, "origin-not-allowed", "The origin is not allowed"


class UnknownModelError(ServiceError):
    """No model has that name or version."""

    status, slug, title = 404, "unknown-model", "The model does not exist"


class BodyTooSlowError(ServiceError):
    """The body takes longer to arrive than the service waits."""

    status, slug, title = 408, "body-too-slow", "The body arrives too slowly"


class BodyTooLargeError(ServiceError):
    """The body is larger than the service reads."""

    status, slug, title = 413, "body-too-large", "The body is too large"


class UnsupportedMediaTypeError(ServiceError):
    """The body's content type is not one that the route reads."""

    status, slug, title = 415, "unsupported-media-type", "The content type is not supported"


class NotAnImageError(ServiceError):
    """A frame is neither PNG nor JPEG nor WebP."""

    status, slug, title = 415, "not-an-image", "A frame is not an image"


class BrokenImageError(ServiceError):
    """A frame starts like an image and cannot be decoded."""

    status, slug, title = 422, "broken-image", "A frame cannot be decoded"


class InvalidValueError(ServiceError):
    """One or several values are wrong."""

    status, slug, title = 422, "invalid-value", "A value is invalid"


class NoSuitableModelError(ServiceError):
    """No model is served that "auto" might take for the request."""

    status, slug, title = 422, "no-suitable-model", "No model fits the request"


class SceneRejectedProblem(ServiceError):  # noqa: N818 - SceneRejectedError is the simulator's
    """No acceptable scene comes out of the seed and the parameters."""

    status, slug, title = 422, "scene-rejected", "No valid scene can be sampled"


class DivergedError(ServiceError):
    """The network's numbers leave every bound before the horizon."""

    status, slug, title = 422, "forecast-diverged", "The forecast diverges"


class QueueFullError(ServiceError):
    """The request queue is full."""

    status, slug, title = 429, "queue-full", "The queue is full"


class TooManyRequestsError(ServiceError):
    """A client exceeds its rate limit.

    Parameters
    ----------
    detail
        Description, in a sentence.
    retry_after_s
        Seconds until the next request is allowed.
    """

    status, slug, title = 429, "too-many-requests", "Too many requests"

    def __init__(self, detail: str, retry_after_s: int) -> None:
        super().__init__(detail)
        self.retry_after_s = retry_after_s


class SimulationMissingError(ServiceError):
    """PyBullet, the extra ``simulation``, is not installed in the service's environment."""

    status, slug, title = 501, "simulation-not-installed", "Simulation is not installed"


class SimulationLostError(ServiceError):
    """The process that simulates died before it had answered."""

    status, slug, title = 503, "simulation-lost", "The simulation was lost"


class TooManyBodiesError(ServiceError):
    """All request bodies together exceed the bytes that the service holds."""

    status, slug, title = 503, "too-many-bodies", "Too many request bodies in memory"


class OutOfMemoryError(ServiceError):
    """The machine, or the container, has no memory left for the request."""

    status, slug, title = 503, "out-of-memory", "Not enough memory"


class ModelUnavailableError(ServiceError):
    """The model exists and is not served."""

    status, slug, title = 503, "model-unavailable", "The model is not served"


class NotReadyError(ServiceError):
    """The service loads, drains, or has no usable model."""

    status, slug, title = 503, "not-ready", "The service is not ready"


class DeadlineExceededError(ServiceError):
    """The answer takes longer than the client or the settings allow."""

    status, slug, title = 504, "deadline-exceeded", "The deadline was exceeded"
