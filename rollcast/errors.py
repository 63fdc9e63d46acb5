"""Every exception that this package raises on purpose.

* RollcastError
  x SceneParametersError    scene parameters that do not fit together
  x SceneRejectedError      no acceptable scene comes out of a seed and its parameters
  x FootageError            a video or image file cannot be read as asked
    + CropError             a crop does not lie inside the picture
    + FootageEndedError     footage ends before a time that is asked for
    + FrameError            a picture cannot be converted to a frame
  x MissingExtraError       a package is not installed that one of the extras brings
  x ClientError             a call through ``rollcast.client`` failed
    + UnreachableError      the service did not answer
    + UnexpectedAnswerError the answer is not one of this API's
    + ProblemError          the service answered with a problem document
      - RefusedError        the request is at fault (400, 404, 413, 415, 422)
        > DeniedError         the API key is missing, not known or not good for this (401, 403)
      - BusyError           the queue is full (429)
      - ServiceFailedError  the service is at fault or not ready (5xx)
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
        What was given.
    expected
        What would be right, in words.
    """

    def __init__(self, field: str, value: object, expected: str) -> None:
        super().__init__(field, value, expected)
        self.field = field
        self.value = value
        self.expected = expected

    def __str__(self) -> str:
        """Name the parameter, its value and what would be right."""
        return f"{self.field} is {self.value!r}, expected {self.expected}"


class SceneRejectedError(RollcastError):
    """The rejection rules of the paper dropped every scene that was drawn."""


class FootageError(RollcastError):
    """A video or an image file cannot be read as asked."""


class CropError(FootageError):
    """A crop does not lie inside the picture."""


class FootageEndedError(FootageError):
    """Footage ends before a time that is asked for."""


class FrameError(FootageError, ValueError):
    """A picture is damaged, or its shape or values cannot be converted to a frame."""


class MissingExtraError(RollcastError, ImportError):
    """A package is not installed that one of the extras brings.

    Parameters
    ----------
    purpose
        What needs it.
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
    retry_after_s
        Seconds after which the service asks to be tried again; 0 where it says nothing.
    """

    retry_after_s: float = 0.0


class UnreachableError(ClientError):
    """The service did not answer: it is down, the address is wrong, or the time ran out."""


class UnexpectedAnswerError(ClientError):
    """The answer is not one of this API's: something else listens, or stands in between.

    Attributes
    ----------
    status
        Its HTTP status.
    """

    def __init__(self, message: str, status: int) -> None:
        super().__init__(message)
        self.status = status


class ProblemError(ClientError):
    """The service answered with a problem document (RFC 9457).

    Attributes
    ----------
    problem
        The document: type, title, status, detail, and where they apply field, value, expected.
    """

    def __init__(self, problem: "Problem") -> None:
        super().__init__(problem)
        self.problem = problem

    def __str__(self) -> str:
        """Return the document's own words."""
        return f"{self.problem.title} ({self.problem.status}): {self.problem.detail}"


class RefusedError(ProblemError):
    """The request is at fault; sending it again unchanged does not help."""


class DeniedError(RefusedError):
    """An API key is missing, not known, has expired or has not the right."""


class BusyError(ProblemError):
    """The service's queue is full."""


class ServiceFailedError(ProblemError):
    """The service failed, is not ready yet or is going down."""
