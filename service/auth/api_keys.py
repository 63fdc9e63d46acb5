"""API keys in a file that holds their hashes.

Keys are 256 random bits, so a slow hash, which protects passwords that people choose, would protect
nothing here and cost every request its time (decision 0123).
"""

import hashlib
import hmac
import logging
import secrets
import time
from collections.abc import Sequence
from datetime import UTC, date, datetime
from pathlib import Path
from typing import Annotated, Literal, TypeAlias, get_args

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

Right: TypeAlias = Literal["forecast", "manage", "metrics"]
RIGHTS: tuple[Right, ...] = get_args(Right)

TOKEN_BYTES = 32
TOKEN_PREFIX = "rollcast_"
"""Tells scanners of leaked secrets, and people, what it is."""
LOOKED_AT_S = 1.0
"""Seconds for which the file is not looked at again."""
log = logging.getLogger(__name__)


class Key(BaseModel):
    """A key, of which only the hash is known."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9._-]{1,64}$")]
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
    rights: tuple[Right, ...] = ("forecast",)
    expires: date | None = None
    """Last day on which it is good, UTC."""

    def is_good(self, today: date) -> bool:
        """Whether it has not expired."""
        return self.expires is None or today <= self.expires


class KeyFile(BaseModel):
    """The file of keys, JSON."""

    model_config = ConfigDict(frozen=True, extra="forbid")

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
            When it cannot be read.
        pydantic.ValidationError
            When it is not one of keys.
        """
        return cls.model_validate_json(path.read_bytes())

    def write(self, path: Path) -> None:
        """Write the file so that it is never seen half-written; only its owner may read it."""
        unfinished = path.with_name(f"{path.name}.tmp")
        unfinished.touch(mode=0o600)
        unfinished.write_text(self.model_dump_json(indent=1) + "\n", encoding="utf-8")
        unfinished.replace(path)


def new_token() -> str:
    """Draw a key."""
    return TOKEN_PREFIX + secrets.token_urlsafe(TOKEN_BYTES)


def digest(token: str) -> str:
    """Return what the file knows of a key."""
    return hashlib.sha256(token.encode("utf-8", "surrogateescape")).hexdigest()


class ApiKeyStore:
    """The keys of a file, which is read again when it changes.

    A file that cannot be read any more leaves the keys as they were, and the reason in the log.

    Raises
    ------
    OSError, pydantic.ValidationError
        When the file cannot be read at first.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._seen = self._stamp()
        self._keys: Sequence[Key] = KeyFile.read(path).keys
        self._looked = time.monotonic()

    def find(self, token: str) -> Key | None:
        """Return the key, unless it is unknown or has expired.

        Every key is compared, in constant time: how long it takes tells nothing of them.
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
        if now < self._looked + LOOKED_AT_S:
            return
        self._looked = now
        try:
            stamp = self._stamp()
            if stamp == self._seen:
                return
            self._seen = stamp
            self._keys = KeyFile.read(self._path).keys
        except (OSError, ValidationError) as error:
            log.warning("%s cannot be read, the keys stay as they were: %s", self._path, error)
        else:
            log.info("%d keys read", len(self._keys))

    def _stamp(self) -> tuple[int, int, int]:
        status = self._path.stat()
        return status.st_mtime_ns, status.st_size, status.st_ino
