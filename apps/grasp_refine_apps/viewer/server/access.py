"""Access to the page, on this machine or over the network: by people who have the address with its token."""

from __future__ import annotations

import ipaddress
import secrets
import socket
from collections.abc import Mapping
from dataclasses import dataclass, field
from hmac import compare_digest
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs, quote, urlsplit

LOCAL_HOSTS = ("127.0.0.1", "localhost", "::1")
"""Names of this machine that only it can reach."""

ALL_ADDRESSES = ("", "0.0.0.0", "::")
"""Hosts that stand for all addresses of this machine."""

TOKEN, COOKIE = "token", "grasp-refine-token"
"""Name of the token in the address, and of the cookie in which a browser keeps it."""

TOKEN_BYTES = 24
"""Random bytes of a token."""

ELSEWHERE = ("192.0.2.1", "2001:db8::1")
"""Addresses outside of any local network (RFC 5737, RFC 3849), to which nothing is sent."""

PUBLIC_WARNING = (
    "whoever has this address can open the page, upload files and start computations on this machine, and others on "
    "the network may read along: share it only with people you trust; ssh -L is safer"
)
"""Warning about a page that others can reach."""


@dataclass(frozen=True)
class Access:
    """Rules for requests to a server: which origins, and which token."""

    host: str
    """Host that the server listens on."""
    token: str = field(repr=False)
    """Token without which nothing is answered: other users of this machine reach its ports, too."""

    @staticmethod
    def to(host: str) -> Access:
        """Return the rules of a host, with a new token."""
        return Access(host, secrets.token_urlsafe(TOKEN_BYTES))

    def allows_origin(self, origin: str | None, host: str | None) -> bool:
        """Return whether a page may connect to the server.

        Args:
            origin: Header Origin of the request; None: it is from a program, not from a page.
            host: Header Host of the request, the name and port that were asked.
        """
        if origin is None:
            return True
        parts = urlsplit(origin)
        # Through a tunnel with another port, page and connection are asked from that port.
        return parts.scheme in ("http", "https") and host is not None and parts.netloc.lower() == host.lower()

    def allows_token(self, path: str, cookie: str | None, port: int) -> bool:
        """Return whether a request has the token in its path or in its cookie."""
        tokens = (*parse_qs(urlsplit(path).query).get(TOKEN, ()), _cookie_value(cookie, port))
        return any(compare_digest(one.encode(), self.token.encode()) for one in tokens)

    def cookies(self, port: int) -> Mapping[str, str]:
        """Return the headers with which a browser keeps the token, by port."""
        return {"Set-Cookie": f"{COOKIE}-{port}={self.token}; Path=/; HttpOnly; SameSite=Strict"}

    def address(self, port: int) -> str:
        """Return the address to open in a browser, from the network if others can reach it."""
        name = network_address(self.host) if self.host in ALL_ADDRESSES else self.host
        return f"http://{f'[{name}]' if ':' in name else name}:{port}/?{TOKEN}={self.token}"

    def frame_address(self, port: int) -> str:
        """Return the address for a frame in another page, such as a notebook, where browsers keep no cookies."""
        address = self.address(port)
        return f"{address}&websocket={quote(address.replace('http', 'ws', 1), safe='')}"


def is_local(host: str) -> bool:
    """Return whether only this machine can reach a host."""
    try:
        return host in LOCAL_HOSTS or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def network_address(host: str) -> str:
    """Return the address by which others on the network reach this machine; its name if it is in none."""
    families = {"": (0, 1), "0.0.0.0": (0,), "::": (1, 0)}[host]
    for version in families:
        with socket.socket((socket.AF_INET, socket.AF_INET6)[version], socket.SOCK_DGRAM) as probe:
            try:
                # Connecting a datagram socket only chooses a route.
                probe.connect((ELSEWHERE[version], 9))
                return str(probe.getsockname()[0])
            except OSError:
                continue
    return socket.gethostname()


def _cookie_value(cookie: str | None, port: int) -> str:
    """Token in the header Cookie; empty where there is none."""
    try:
        found = SimpleCookie(cookie or "").get(f"{COOKIE}-{port}")
    except CookieError:
        return ""
    return "" if found is None else found.value
