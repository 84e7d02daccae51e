"""Who may read the page and press its stop: by where the server is bound, by the names it is called by, by a token.

A browser runs the pages of strangers beside this one. Three things keep those out. A page of another origin says so
in ``Origin``. A foreign name that was made to point here (DNS rebinding) stands in ``Host``. And a server that is
bound to more than this computer asks for a session, which a link with a token opens. A token opens one session; then
the next one is made, so that a link that was photographed or kept in a history is worth nothing.
"""

from __future__ import annotations

import hmac
import ipaddress
import secrets
import socket
from collections.abc import Callable, Collection
from urllib.parse import urlsplit

LOOPBACK_NAMES = ("localhost", "127.0.0.1", "::1")


def is_loopback(host: str) -> bool:
    """Tell whether only this computer reaches a server that is bound to a host."""
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def reachable_name(host: str) -> str:
    """Return a name or an address under which others reach a server that is bound to a host."""
    if is_loopback(host):
        return "localhost"
    try:
        if not ipaddress.ip_address(host).is_unspecified:
            return f"[{host}]" if ":" in host else host
    except ValueError:
        return host
    # A datagram socket that is connected sends nothing, and knows from which address it would. 192.0.2.1 is nobody's.
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))
            return str(probe.getsockname()[0])
        except OSError:
            return socket.gethostname()


class Admission:
    """Decides on requests by their headers.

    Parameters
    ----------
    host : str -- where the server is bound
    on_token : callable -- called with every token that is made, to show it; never called on this computer alone
    new_secret : callable -- returns a text that nobody guesses
    """

    def __init__(
        self,
        host: str,
        on_token: Callable[[str], None],
        new_secret: Callable[[], str] = secrets.token_urlsafe,
    ) -> None:
        self.needs_session = not is_loopback(host)
        self._names: Collection[str] = (*LOOPBACK_NAMES, host, socket.gethostname())
        self._on_token, self._new_secret = on_token, new_secret
        self._sessions: set[str] = set()
        self._token = ""
        if self.needs_session:
            self._renew()

    def _renew(self) -> None:
        self._token = self._new_secret()
        self._on_token(self._token)

    def refusal(self, host: str | None, origin: str | None, *, needs_origin: bool) -> str:
        """Say why a request is refused for its headers; empty where it is not.

        Parameters
        ----------
        host, origin : str or None -- the headers
        needs_origin : bool -- browsers send the origin with what is asked for; without one it is refused
        """
        name = _name_in(host)
        if name is None or not self._is_ours(name):
            return f"Host {host!r} is not a name of this server: expected localhost, an address, or --host's name"
        if origin is None:
            return "no Origin: expected a browser with this server's own page" if needs_origin else ""
        if origin.partition("://")[::2] not in (("http", host), ("https", host)):
            return f"Origin {origin!r} is another page's: expected this server's own"
        return ""

    def _is_ours(self, name: str) -> bool:
        if name in self._names:
            return True
        # Nobody can make an address point elsewhere; a name somebody can.
        try:
            ipaddress.ip_address(name)
        except ValueError:
            return False
        return self.needs_session

    def redeem(self, token: str) -> str:
        """Return the session that a token opens, which it does once; empty where it opens none."""
        if not self.needs_session or not _are_same(token, self._token):
            return ""
        session = self._new_secret()
        self._sessions.add(session)
        self._renew()
        return session

    def knows(self, session: str | None) -> bool:
        """Tell whether a request of this session may be answered."""
        if not self.needs_session:
            return True
        return any(_are_same(session or "", known) for known in self._sessions)


def _name_in(host: str | None) -> str | None:
    """Return the name in a Host header, without its port."""
    try:
        parts = urlsplit(f"//{host}")
    except ValueError:
        return None
    is_bare = host is not None and parts.netloc == host and parts.username is None
    return parts.hostname if is_bare else None


def _are_same(first: str, second: str) -> bool:
    """Compare two secrets in a time that tells nothing of them."""
    return hmac.compare_digest(first.encode(), second.encode())
