"""viser behind a one-time token, for this computer only.

viser answers whoever reaches its port, and has no place for a check. What it gives to `websockets`, its `process_request`, is wrapped while
the server starts: a request passes with the session's cookie only, which the address with the token gives once; its `Host` and `Origin`
have to be this server's, so that no other page and no name that points here gets in. Whether the check is in force is tried before
anybody is told the address.
"""

from __future__ import annotations

import contextlib
import http
import io
import secrets
import threading
from collections.abc import Callable, Iterator
from http.client import HTTPConnection
from http.cookies import CookieError, SimpleCookie
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qs, urlsplit

from tepm_opt.errors import InputError

if TYPE_CHECKING:
    import viser

HOST = "127.0.0.1"
INSTALL = "pip install 'tepm-opt[view]'"
_STARTING = threading.Lock()  # one server at a time wraps what viser gives to websockets

POLICY = (
    "default-src 'none'; script-src 'self' 'unsafe-inline' 'unsafe-eval' blob: data:; worker-src 'self' blob: data:; "
    "style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; font-src 'self' data:; media-src data: blob:; "
    "connect-src 'self' data: blob: {websocket}; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)
"""Content security policy of the page: it loads nothing that is not from here, whatever its scripts would like."""

HIDDEN = (("Referrer-Policy", "no-referrer"), ("X-Content-Type-Options", "nosniff"), ("Cache-Control", "no-store"))


class Gate:
    """Who may enter.

    Attributes:
        token: opens once.
        port: of the server.
    """

    def __init__(self) -> None:
        self.token = secrets.token_urlsafe(24)
        self.port = 0
        self._session = secrets.token_urlsafe(24)
        self._used = False
        self._lock = threading.Lock()

    @property
    def address(self) -> str:
        """Address to open in a browser, once."""
        return f"http://{HOST}:{self.port}/?token={self.token}"

    @property
    def cookie(self) -> str:
        """Name of the session's cookie: cookies do not know ports."""
        return f"tepm_studio_{self.port}"

    @property
    def hosts(self) -> tuple[str, str]:
        """Under which names the server is known."""
        return f"{HOST}:{self.port}", f"localhost:{self.port}"

    def refuses(self, headers: Any) -> str:
        """Tell why requests with these headers are refused, empty where they may come in; `headers` has `get_all`."""
        hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
        if len(hosts) != 1 or hosts[0].lower() not in self.hosts:
            return "unknown host"
        if origins and (len(origins) != 1 or origins[0] not in {f"http://{host}" for host in self.hosts}):
            return "other pages may not ask"
        return ""

    def knows(self, headers: Any) -> bool:
        """Whether the headers have the session's cookie."""
        for text in headers.get_all("Cookie"):
            jar: SimpleCookie = SimpleCookie()
            with contextlib.suppress(CookieError):
                jar.load(text)
            if (found := jar.get(self.cookie)) and secrets.compare_digest(found.value.encode(), self._session.encode()):
                return True
        return False

    def opens(self, path: str) -> bool:
        """Whether the path has the token, which is used up then."""
        given = parse_qs(urlsplit(path).query).get("token", [""])[0]
        with self._lock:
            if self._used or not secrets.compare_digest(given.encode(), self.token.encode()):
                return False
            self._used = True
            return True

    @property
    def granted(self) -> str:
        """The cookie that a session is known by, as a header's value."""
        return f"{self.cookie}={self._session}; HttpOnly; SameSite=Lax; Path=/"


def start(title: str, port: int = 0) -> tuple[viser.ViserServer, Gate]:
    """A viser server on this computer behind a token, and its gate with the address to open.

    Args:
        title: of the page's panel.
        port: to listen at, or the next free one above it; any where 0.

    Raises:
        InputError: viser is not installed, or a version of it whose server cannot be guarded.
    """
    try:
        import viser
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] != "viser":
            raise
        raise InputError(f"the studio needs viser, which is not installed: {INSTALL}") from error

    class LocalServer(viser.ViserServer):
        """viser that stays on this computer."""

        def request_share_url(self, verbose: bool = True) -> str | None:
            """No address on the internet, whoever asks."""
            return None

    gate = Gate()
    with _STARTING, _guard_servers(gate), contextlib.redirect_stdout(io.StringIO()):  # viser prints where it listens, without the token
        server = LocalServer(host=HOST, port=port, label=title, verbose=False)
    gate.port = server.get_port()
    if (seen := _status_without_token(gate.port)) != http.HTTPStatus.FORBIDDEN:
        server.stop()
        raise InputError(
            f"viser {viser.__version__} answers {seen} to requests without the token, so that the studio cannot be guarded; {INSTALL}"
        )
    return server, gate


def stop(server: viser.ViserServer) -> None:
    """Close a server, in silence."""
    with contextlib.redirect_stdout(io.StringIO()):
        server.stop()


@contextlib.contextmanager
def _guard_servers(gate: Gate) -> Iterator[None]:
    """Guard websockets' servers that are started meanwhile by the gate."""
    import websockets.asyncio.server as served

    unguarded = served.serve

    def serve(*arguments: Any, process_request: Callable[..., Any] | None = None, **options: Any) -> Any:
        return unguarded(*arguments, process_request=_check_requests(gate, process_request), **options)

    served.serve = serve  # type: ignore[assignment, misc]
    try:
        yield
    finally:
        served.serve = unguarded  # type: ignore[misc]


def _check_requests(gate: Gate, answer: Callable[..., Any] | None) -> Callable[..., Any]:
    """Answer requests by `answer`, where the gate lets them pass."""
    from websockets import Headers
    from websockets.http11 import Response

    def process(connection: Any, request: Any) -> Any:
        reason = gate.refuses(request.headers)
        if not reason and not gate.knows(request.headers):
            if gate.opens(request.path):
                return Response(http.HTTPStatus.SEE_OTHER, "See Other", Headers([("Location", "/"), ("Set-Cookie", gate.granted), *HIDDEN]))
            reason = "the address that the terminal shows opens this page, once"
        if reason:
            return Response(http.HTTPStatus.FORBIDDEN, "Forbidden", Headers([("Content-Type", "text/plain")]), f"403: {reason}\n".encode())
        found = answer(connection, request) if answer is not None else None
        if found is not None:
            websocket = " ".join(f"ws://{host}" for host in gate.hosts)
            for name, value in (("Content-Security-Policy", POLICY.format(websocket=websocket)), *HIDDEN):
                found.headers[name] = value
        return found

    return process


def _status_without_token(port: int) -> int:
    connection = HTTPConnection(HOST, port, timeout=10)
    try:
        connection.request("GET", "/")
        return connection.getresponse().status
    finally:
        connection.close()
