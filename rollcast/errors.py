"""Exceptions of this package.

* RollcastError
  x SceneParametersError      scene parameters that do not fit together
  x SceneRejectedError        no acceptable scene comes out of a seed and its parameters
  x FootageError              a video or image file cannot be read as requested
    + CropError               a crop does not lie inside the picture
    + FootageEndedError       footage ends before a time that is asked for
    + FrameError              a picture cannot be converted to a frame
  x MissingExtraError         a package is not installed that one of the extras brings
  x ClientError               a call through ``rollcast.client`` failed
    + InvalidArgumentError    an argument or environment variable cannot be used; nothing was sent
    + UnreachableError        the service did not answer
      - RequestTimeoutError   it did not answer within the client's ``timeout_s``
    + UnexpectedAnswerError   the answer is not a valid answer of this API
    + ProblemError            the service answered with a problem document
      - BadRequestError       the request is at fault (400, 404, 413, 415, 422)
        > AuthError           the API key is missing, unknown or lacks the scope (401, 403)
      - OverloadedError       the queue is full or the rate limit is exceeded (429)
      - ServerError           the service failed or is not ready (5xx)
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rollcast.schemas import Problem


class RollcastError(Exception):
    """Root of the package's exceptions."""


class SceneParametersError(RollcastError):
    """A scene parameter does not fit.

    Parameters
    ----------
    field
        Name of the parameter, a field of ``rollcast.scene.Scene``.
    value
        Given value. expected Expected value, in words.
    """

    def __init__(self, field: str, value: object, expected: str) -> None:
        super().__init__(field, value, expected)
        self.field = field
        self.value = value
        self.expected = expected

    def __str__(self) -> str:
        """Return the parameter, its value and the expected value."""
        return f"{self.field} is {self.value!r}, expected {self.expected}"


class SceneRejectedError(RollcastError):
    """The rejection rules of the paper dropped every scene that was drawn."""


class FootageError(RollcastError):
    """A video or an image file cannot be read as requested."""


class DatasetError(RollcastError):
    """A file is not a data set of scenes, or a data set has no frames."""


class CropError(FootageError):
    """A crop does not lie inside the picture."""


class FootageEndedError(FootageError):
    """Footage ends before a requested time."""


class FrameError(FootageError, ValueError):
    """A picture is damaged, or its shape or values cannot be converted to a frame."""


class MissingExtraError(RollcastError, ImportError):
    """A package of one of the extras is not installed.

    Parameters
    ----------
    purpose
        Feature that needs the package, with its verb.
    package
        Its name.
    extra
        Which brings it.
    """

    def __init__(self, purpose: str, package: str, extra: str) -> None:
        super().__init__(f"{purpose} {package}: pip install 'rollcast[{extra}]'")


class ClientError(RollcastError):
    """A call to the service failed.

    Attributes
    ----------
    status_code
        HTTP status of the answer; None when there was none.
    request_id
        Identifier of the request (``X-Request-ID``), which the service's log lines carry too; None
        when nothing was sent.
    retry_after_s
        Seconds after which the service asks to be tried again; 0 where it says nothing.
    """

    status_code: int | None = None
    request_id: str | None = None
    retry_after_s: float = 0.0


class InvalidArgumentError(ClientError, ValueError):
    """An argument or an environment variable of the client cannot be used; nothing was sent."""


class UnreachableError(ClientError):
    """The service did not answer: it is down, the address is wrong, or the connection was lost."""


class RequestTimeoutError(UnreachableError, TimeoutError):
    """The call took longer than the client's ``timeout_s``, retries included."""


class UnexpectedAnswerError(ClientError):
    """The answer is not a valid answer of this API.

    Another program answers at this address or in between, or the answer is incomplete,
    contradicts itself, or is larger than the client accepts.
    """

    def __init__(self, message: str, status_code: int | None = None) -> None:
        super().__init__(message)
        self.status_code = status_code


class ProblemError(ClientError):
    """The service answered with a problem document (RFC 9457).

    Attributes
    ----------
    problem
        The document: type, title, status, detail, and where they apply field, value, expected.
    advice
        Remedy in terms of this client; empty if the document is enough.
    """

    def __init__(self, problem: "Problem") -> None:
        super().__init__(problem)
        self.problem = problem
        self.advice = ""
        self.status_code = problem.status

    def __str__(self) -> str:
        """Return the document's title, status and detail, and the advice."""
        told = f"{self.problem.title} ({self.problem.status}): {self.problem.detail}"
        return f"{told}; {self.advice}" if self.advice else told


class BadRequestError(ProblemError):
    """The request is at fault; sending it again unchanged does not help."""


class AuthError(BadRequestError):
    """The API key is missing, unknown or expired, or it lacks the scope."""


class OverloadedError(ProblemError):
    """The request queue is full, or the rate limit is exceeded."""


class ServerError(ProblemError):
    """The service failed, is not ready yet or is shutting down."""
