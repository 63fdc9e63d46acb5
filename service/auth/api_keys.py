"""API keys in a file that holds their hashes.

Keys are 256 random bits, so a slow hash, which protects passwords that people choose, would protect
nothing here and cost every request its time (decision 0123).
"""

import fcntl
import hashlib
import hmac
import logging
import os
import re
import secrets
import time
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from datetime import UTC, date, datetime
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import Annotated, Literal, TypeAlias, get_args

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator
from pydantic_core import ErrorDetails

from rollcast.files import read_regular_file

Scope: TypeAlias = Literal["forecast", "manage", "metrics"]
SCOPES: tuple[Scope, ...] = get_args(Scope)

TOKEN_BYTES = 32
TOKEN_PREFIX = "rollcast_"
"""Prefix by which people and secret scanners recognise a key."""
MAX_FIELD_ERRORS = 10
"""Mistakes of a file that its refusal names."""
_TOKEN = re.compile(re.escape(TOKEN_PREFIX) + r"[A-Za-z0-9_-]{32,}")
CHECK_INTERVAL_S = 1.0
"""Seconds for which the file is not looked at again."""
log = logging.getLogger(__name__)


class Key(BaseModel):
    """A key, of which only the hash is known."""

    # A key in place of its hash or name must not appear in a log.
    model_config = ConfigDict(frozen=True, extra="forbid", hide_input_in_errors=True)

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9._-]{1,64}$")]
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
    scopes: tuple[Scope, ...] = ("forecast",)
    expires: date | None = None
    """Last day on which it is good, UTC."""

    @field_validator("name")
    @classmethod
    def _is_no_key(cls, name: str) -> str:
        if name.startswith(TOKEN_PREFIX):
            raise ValueError(f"a name that does not begin with {TOKEN_PREFIX}, as keys do")
        return name

    def is_good(self, today: date) -> bool:
        """Return whether the key has not expired."""
        return self.expires is None or today <= self.expires


class KeyFile(BaseModel):
    """The file of keys, JSON."""

    model_config = ConfigDict(frozen=True, extra="forbid", hide_input_in_errors=True)

    keys: tuple[Key, ...] = ()

    @model_validator(mode="after")
    def _names_differ(self) -> "KeyFile":
        names = [key.name for key in self.keys]
        if len(set(names)) < len(names):
            raise ValueError("two keys have the same name")
        return self

    @classmethod
    def read(cls, path: Path) -> "KeyFile":
        """Read a file.

        Raises
        ------
        OSError
            When it cannot be read, or is not a regular file.
        ValueError
            If it is not a key file. The message does not repeat its content, which may contain
            keys in wrong places.
        """
        try:
            return cls.model_validate_json(read_regular_file(path))
        except ValidationError as error:
            messages = [
                _place(fault) for fault in error.errors(include_url=False)[:MAX_FIELD_ERRORS]
            ]
        raise ValueError("; ".join(messages))

    def write(self, path: Path) -> None:
        """Write the file so that it is never seen half-written; only its owner may read it."""
        with NamedTemporaryFile(  # with mode 0600
            "w", encoding="utf-8", dir=path.parent, prefix=f".{path.name}.", delete=False
        ) as unfinished:
            unfinished.write(self.model_dump_json(indent=1) + "\n")
            unfinished.flush()
            os.fsync(unfinished.fileno())
        Path(unfinished.name).replace(path)


@contextmanager
def exclusively(path: Path) -> Generator[None]:
    """Keep other processes that change a file of keys waiting until the block is left."""
    # The folder is locked: the file itself is replaced by every change.
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        fcntl.flock(folder, fcntl.LOCK_EX)
        yield
    finally:
        os.close(folder)


def _place(fault: ErrorDetails) -> str:
    """Describe an error without names or values of the file."""
    known = {"keys", *Key.model_fields}
    parts = [part for part in fault["loc"] if isinstance(part, int) or part in known]
    place = ".".join(map(str, parts)) or "the file"
    unknown = fault["type"] == "extra_forbidden"
    return f"{place}: {'a field has no known name' if unknown else fault['msg']}"


def new_token() -> str:
    """Draw a key."""
    return TOKEN_PREFIX + secrets.token_urlsafe(TOKEN_BYTES)


def without_tokens(text: str) -> str:
    """Return a text with every key in it cut down to its prefix."""
    return _TOKEN.sub(f"{TOKEN_PREFIX}***", text) if TOKEN_PREFIX in text else text


def digest(token: str) -> str:
    """Return the file's entry for a key."""
    return hashlib.sha256(token.encode("utf-8", "surrogateescape")).hexdigest()


class ApiKeyStore:
    """The keys of a file, which is read again when it changes.

    A file that cannot be read any more leaves the keys as they were, and the reason in the log.

    Raises
    ------
    OSError, ValueError
        When the file cannot be read at first.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._seen = self._stamp()
        self._keys: Sequence[Key] = KeyFile.read(path).keys
        self._checked_at = time.monotonic()

    def find(self, token: str) -> Key | None:
        """Return the key, unless it is unknown or has expired.

        All keys are compared in constant time.
        """
        self._refresh()
        given, today = digest(token), datetime.now(UTC).date()
        found = None
        for key in self._keys:
            if hmac.compare_digest(key.sha256, given) and key.is_good(today):
                found = key
        return found

    def _refresh(self) -> None:
        now = time.monotonic()
        if now < self._checked_at + CHECK_INTERVAL_S:
            return
        self._checked_at = now
        try:
            stamp = self._stamp()
            if stamp == self._seen:
                return
            self._seen = stamp
            self._keys = KeyFile.read(self._path).keys
        except (OSError, ValueError) as error:
            log.warning("%s cannot be read, the previous keys stay in use: %s", self._path, error)
        else:
            log.info("%d keys read", len(self._keys))

    def _stamp(self) -> tuple[int, int, int]:
        status = self._path.stat()
        return status.st_mtime_ns, status.st_size, status.st_ino
