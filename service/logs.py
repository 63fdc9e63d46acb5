"""Logs as one JSON object a line, each with the id of its request."""

import logging
import re
from typing import Any, Literal

from asgi_correlation_id import CorrelationIdMiddleware
from asgi_correlation_id.context import correlation_id
from fastapi import FastAPI
from pythonjsonlogger.json import JsonFormatter

REQUEST_ID_HEADER = "X-Request-ID"
ACCESS_LOG = "uvicorn.access"

_REQUEST_ID = re.compile(r"[A-Za-z0-9._:/+=-]{1,128}")


def install_request_ids(app: FastAPI) -> None:
    """Give every request an id, the client's own where it sends a sound one, and send it back."""
    app.add_middleware(
        CorrelationIdMiddleware,
        header_name=REQUEST_ID_HEADER,
        validator=lambda text: _REQUEST_ID.fullmatch(text) is not None,
    )


def request_id() -> str | None:
    """Id of the request that is being answered."""
    return correlation_id.get()


class JsonLines(JsonFormatter):
    """Writes a record's time, level, logger, message and request; an access record's parts too."""

    def __init__(self) -> None:
        super().__init__(  # pyright: ignore[reportUnknownMemberType]
            "{asctime}{levelname}{name}{message}",
            style="{",
            rename_fields={"asctime": "time", "levelname": "level", "name": "logger"},
        )
        self.default_msec_format = "%s.%03d"

    def add_fields(
        self, log_data: dict[str, Any], record: logging.LogRecord, message_dict: dict[str, Any]
    ) -> None:
        """Fill in what a line says of a record."""
        super().add_fields(log_data, record, message_dict)
        if (of_request := request_id()) is not None:
            log_data["request_id"] = of_request
        if record.name == ACCESS_LOG and isinstance(record.args, tuple):
            client, method, path, _, status = record.args
            log_data |= {"client": client, "method": method, "path": path, "status": status}


def configuration(log_format: Literal["json", "text"]) -> dict[str, Any]:
    """Return what ``logging.config.dictConfig`` takes; everything goes to the standard error."""
    text = "%(asctime)s %(levelname)s %(name)s: %(message)s"
    formatter = {"()": JsonLines} if log_format == "json" else {"format": text}
    return {
        "version": 1,
        "disable_existing_loggers": False,
        "formatters": {"lines": formatter},
        "handlers": {"stderr": {"class": "logging.StreamHandler", "formatter": "lines"}},
        "root": {"handlers": ["stderr"], "level": "INFO"},
    }
