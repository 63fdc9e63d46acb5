"""Environment variables of the client. This module is the only one that reads them."""

import os
from typing import NamedTuple
from urllib.parse import urlsplit
from urllib.request import getproxies, proxy_bypass

DEFAULT_URL = "http://127.0.0.1:8000"
URL_VARIABLE = "ROLLCAST_URL"
API_KEY_VARIABLE = "ROLLCAST_API_KEY"
CERTIFICATE_VARIABLES = ("SSL_CERT_FILE", "SSL_CERT_DIR")
"""Certificate authorities that the TLS library trusts instead of its own."""


class Proxy(NamedTuple):
    """An HTTP proxy of the environment."""

    url: str
    """Address, possibly with user name and password."""
    variable: str
    """Name of the variable that sets it, ``http_proxy`` for example."""

    def __str__(self) -> str:
        """Return the address without user name and password, and the variable."""
        parts = urlsplit(self.url)
        return f"{parts.scheme}://{parts.netloc.rpartition('@')[2]} ({self.variable})"


def service_url() -> str:
    """Return ``ROLLCAST_URL``, by default the address of a service on this machine."""
    return os.environ.get(URL_VARIABLE) or DEFAULT_URL


def api_key() -> str | None:
    """Return ``ROLLCAST_API_KEY``, None when it is not set or empty."""
    return os.environ.get(API_KEY_VARIABLE) or None


def proxy_for(scheme: str, host: str) -> Proxy | None:
    """Return the proxy that the environment sets for a host, None when there is none.

    ``http_proxy``, ``https_proxy`` and ``all_proxy`` set one, ``no_proxy`` lists hosts that are
    reached without, all in either case.
    """
    proxies = getproxies()
    for name in (scheme, "all"):
        if (url := proxies.get(name)) and not proxy_bypass(host):
            return Proxy(url if "://" in url else f"http://{url}", f"{name}_proxy")
    return None


def certificates() -> dict[str, str]:
    """Return the environment variables that set certificate authorities."""
    return {name: os.environ[name] for name in CERTIFICATE_VARIABLES if name in os.environ}
