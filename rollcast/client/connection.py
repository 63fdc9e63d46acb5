"""Address, key and proxy of requests, checked before anything is sent."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from threading import TIMEOUT_MAX
from typing import Any, TypeVar

import httpx2

from rollcast.client import settings
from rollcast.client.settings import Proxy
from rollcast.errors import InvalidArgumentError

T = TypeVar("T")


@dataclass(frozen=True)
class Target:
    """A service as the client reaches it."""

    base_url: httpx2.URL
    api_key: str | None = field(repr=False)
    proxy: Proxy | None
    """Proxy of the environment that requests go through; None without one."""

    @classmethod
    def resolve(cls, base_url: str | None, api_key: str | None, *, over_network: bool) -> "Target":
        """Use the arguments, and the environment for omitted ones.

        Raises
        ------
        InvalidArgumentError
            When an address or a key cannot be used.
        """
        given = base_url is not None
        address = base_url if base_url is not None else settings.service_url()
        url = _checked_url(address, "base_url" if given else settings.URL_VARIABLE)
        if api_key is None:
            key = _checked_key(settings.api_key(), settings.API_KEY_VARIABLE)
        else:
            key = _checked_key(api_key or None, "api_key")
        port = url.port or {"http": 80, "https": 443}[url.scheme]
        proxy = settings.proxy_for(url.scheme, f"{url.host}:{port}") if over_network else None
        return cls(url, key, proxy)

    def options(self) -> dict[str, Any]:
        """Return the arguments of an HTTP client except its transport."""
        headers = {} if self.api_key is None else {"Authorization": f"Bearer {self.api_key}"}
        return {"base_url": self.base_url, "headers": headers}

    def transport(self, make: Callable[..., T]) -> T:
        """Make a transport over the network.

        Raises
        ------
        InvalidArgumentError
            When the environment names a proxy or certificates that cannot be used.
        """
        try:
            return make(proxy=None if self.proxy is None else self.proxy.url)
        except (ImportError, OSError, ValueError, httpx2.InvalidURL) as error:
            causes = [f"the proxy {self.proxy}"] if self.proxy else []
            causes += [f"{name}={value}" for name, value in settings.certificates().items()]
            hint = "; NO_PROXY=127.0.0.1 excludes local addresses" if self.proxy else ""
            raise InvalidArgumentError(
                f"{' or '.join(causes) or 'TLS settings'} of the environment cannot be used: "
                f"{error}{hint}"
            ) from error


def checked_timeout(timeout_s: float) -> float:
    """Return a time limit in seconds.

    Raises
    ------
    InvalidArgumentError
        When it is not a positive number.
    """
    try:
        seconds = float(timeout_s)
    except (TypeError, ValueError):
        seconds = math.nan
    if not seconds > 0:
        raise InvalidArgumentError(f"timeout_s is {timeout_s!r}, expected seconds, more than 0")
    return min(seconds, TIMEOUT_MAX / 2)  # infinity included: no lock waits longer


def _checked_url(address: str, name: str) -> httpx2.URL:
    expected = f"{name} is {address!r}, expected an address like {settings.DEFAULT_URL}"
    try:
        url = httpx2.URL(address)
    except (httpx2.InvalidURL, TypeError, ValueError) as error:
        raise InvalidArgumentError(expected) from error
    if url.scheme not in {"http", "https"} or not url.host:
        raise InvalidArgumentError(expected)
    return url


def _checked_key(key: str | None, name: str) -> str | None:
    """Return a key that a header can carry; a wrong one is not repeated in the message."""
    if key is not None and not (key.isascii() and key.isprintable() and " " not in key):
        raise InvalidArgumentError(f"{name} is not an API key: expected ASCII without spaces")
    return key
