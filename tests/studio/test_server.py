"""Who gets in: the token once, its browser afterwards, nobody else."""

from __future__ import annotations

import socket
from collections.abc import Iterator, Mapping
from contextlib import nullcontext
from http.client import HTTPConnection

import pytest

pytest.importorskip("viser", reason="viser is not installed (extra view)")

import viser
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from tepm_opt.errors import InputError
from tepm_opt.studio import server as serving
from tepm_opt.studio.server import Gate, start, stop


@pytest.fixture(scope="module")
def running() -> Iterator[tuple[viser.ViserServer, Gate]]:
    found, gate = start("a test")
    yield found, gate
    stop(found)


@pytest.fixture(scope="module")
def cookie(running: tuple[viser.ViserServer, Gate]) -> str:
    """What the token was changed into; the token is used up."""
    _, gate = running
    status, headers = asked(gate, gate.address.removeprefix(f"http://127.0.0.1:{gate.port}"))
    assert (status, headers["Location"]) == (303, "/")
    assert "HttpOnly" in headers["Set-Cookie"]
    assert gate.token not in headers["Set-Cookie"]
    return headers["Set-Cookie"].partition(";")[0]


def asked(gate: Gate, path: str = "/", headers: Mapping[str, str] | None = None) -> tuple[int, dict[str, str]]:
    """Status and headers of the answer to a request."""
    connection = HTTPConnection("127.0.0.1", gate.port, timeout=10)
    try:
        connection.request("GET", path, headers=dict(headers or {}))
        answer = connection.getresponse()
        answer.read()
        return answer.status, dict(answer.getheaders())
    finally:
        connection.close()


def test_nobody_without_the_token(running: tuple[viser.ViserServer, Gate]) -> None:
    _, gate = running
    for headers in ({}, {"Cookie": f"{gate.cookie}=no"}, {"Cookie": ';;="'}):
        for path in ("/", "/index.html", "/?token=", "/?token=abc", "/?token=abc&token=" + gate.token):
            assert asked(gate, path, headers)[0] == 403


def test_the_token_opens_once(running: tuple[viser.ViserServer, Gate], cookie: str) -> None:
    _, gate = running
    assert asked(gate, f"/?token={gate.token}")[0] == 403
    status, headers = asked(gate, "/", {"Cookie": cookie})
    assert status == 200
    assert "default-src 'none'" in headers["Content-Security-Policy"]
    assert headers["Referrer-Policy"] == "no-referrer"


@pytest.mark.parametrize(
    "header", [{"Host": "evil.example"}, {"Origin": "http://evil.example"}, {"Origin": "null"}, {"Origin": "http://127.0.0.1:1"}]
)
def test_other_names_and_pages_are_refused(running: tuple[viser.ViserServer, Gate], cookie: str, header: dict[str, str]) -> None:
    """Also with the cookie: a name that was bent to this computer, and another page in the same browser."""
    assert asked(running[1], "/", {"Cookie": cookie, **header})[0] == 403


@pytest.mark.parametrize(("given", "opens"), [("nothing", False), ("cookie", True), ("cookie of another page", False)])
def test_websockets(running: tuple[viser.ViserServer, Gate], cookie: str, given: str, opens: bool) -> None:
    _, gate = running
    headers = {} if given == "nothing" else {"Cookie": cookie}
    origin = "http://evil.example" if given == "cookie of another page" else f"http://127.0.0.1:{gate.port}"
    how = {"origin": origin, "additional_headers": headers, "subprotocols": [f"viser-v{viser.__version__}"]}
    if not opens:
        with pytest.raises(InvalidStatus, match="403"):
            connect(f"ws://127.0.0.1:{gate.port}/", **how)  # type: ignore[arg-type]
        return
    with connect(f"ws://127.0.0.1:{gate.port}/", **how) as opened:  # type: ignore[arg-type]
        assert opened.recv(timeout=10)


def test_only_this_computer(running: tuple[viser.ViserServer, Gate]) -> None:
    """It listens at the loopback address alone, and a browser that asks for an address on the internet gets none."""
    server, gate = running
    assert server.get_host() == "127.0.0.1"
    with socket.socket() as other:
        other.bind(("127.0.0.2", gate.port))  # is free: it does not listen everywhere
    assert server.request_share_url() is None


def test_a_viser_that_cannot_be_guarded_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serving, "_guard_servers", lambda gate: nullcontext())
    with pytest.raises(InputError, match="answers 200 to requests without the token"):
        start("a test")


def test_other_servers_are_left_alone(running: tuple[viser.ViserServer, Gate]) -> None:
    """What was wrapped while the server started is as it was."""
    import websockets.asyncio.server

    assert websockets.asyncio.server.serve.__module__ == "websockets.asyncio.server"
