"""The server: where it listens, whom it lets in, and the thread that draws."""

import gzip
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from http.client import HTTPConnection, HTTPResponse
from urllib.parse import parse_qs, urlsplit

import pytest
import viser
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from grasp_refine.core.errors import GraspRefineError
from grasp_refine_apps.viewer.jobs.controller import Controller
from grasp_refine_apps.viewer.model.state import State
from grasp_refine_apps.viewer.server.access import Access
from grasp_refine_apps.viewer.server.page import Drawer, Page, close_server, open_server
from refusals import refused
from running_processes import PATIENCE_S


@contextmanager
def served(host: str = "127.0.0.1") -> Iterator[Page]:
    page = open_server(host, 0)
    try:
        yield page
    finally:
        close_server(page.server)


def answered(port: int, path: str = "/", **headers: str) -> HTTPResponse:
    """The answer to a request for a page; the name asked for is that of the header Host."""
    asked = HTTPConnection("127.0.0.1", port, timeout=PATIENCE_S)
    asked.request("GET", path, headers=headers)
    found = asked.getresponse()
    found.read()
    asked.close()
    return found


def connects(port: int, path: str = "/", *, origin: str | None = None, **headers: str) -> bool:
    """Whether a page may connect."""
    try:
        protocol = [f"viser-v{viser.__version__}"]
        address = f"ws://127.0.0.1:{port}{path}"
        with connect(address, origin=origin, subprotocols=protocol, additional_headers=headers):
            return True
    except InvalidStatus as refusal:
        assert refusal.response.status_code == 403
        return False


def test_a_port_of_zero_is_any_that_is_free_and_nothing_is_printed(capfd: pytest.CaptureFixture[str]) -> None:
    with served() as one, served() as other:
        assert one.server.get_port() != other.server.get_port()
        assert one.address == f"http://127.0.0.1:{one.server.get_port()}/?token={one.access.token}"
    assert capfd.readouterr().out == ""


def test_a_port_that_is_taken_is_said_in_one_line() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with refused(GraspRefineError, f"127.0.0.1:{port}", "--port"):
            open_server("127.0.0.1", port)


@pytest.mark.parametrize(("host", "port"), [("203.0.113.7", 0), ("no such host", 0), ("127.0.0.1", 99999)])
def test_a_place_where_nothing_can_listen_is_refused_at_once(host: str, port: int) -> None:
    with refused(GraspRefineError, f"{host}:{port}"):
        open_server(host, port)


@pytest.mark.parametrize("host", ["127.0.0.1", "0.0.0.0"])
def test_nothing_is_answered_without_the_token(host: str) -> None:
    with served(host) as page:
        port, token = page.server.get_port(), page.access.token
        assert len(token) >= 32
        for path in ("/", "/index.html", "/alive", f"/?token={token}x", "/?token="):
            assert answered(port, path).status == 403, path
        found = answered(port, f"/?token={token}")
        cookie = found.headers["Set-Cookie"]
        assert found.status == 200 and "HttpOnly" in cookie and "SameSite=Strict" in cookie
        kept = cookie.partition(";")[0]
        assert answered(port, Cookie=f"other=1; {kept}").status == 200
        assert not connects(port) and not connects(port, Cookie=f"{kept}x")
        assert connects(port, Cookie=kept) and connects(port, f"/?token={token}")
        # Only the page that was asked for may connect.
        assert connects(port, Cookie=kept, origin=f"http://127.0.0.1:{port}")
        for origin in ("http://evil.example", f"http://localhost:{port}", "http://127.0.0.1", "null"):
            assert not connects(port, Cookie=kept, origin=origin), origin


def test_an_origin_is_compared_with_the_name_that_was_asked() -> None:
    public = Access.to("0.0.0.0")
    assert public.allows_origin("http://robot.lab:8080", "Robot.lab:8080")
    assert public.allows_origin("https://proxy.lab", "proxy.lab") and public.allows_origin(None, None)
    assert not public.allows_origin("http://robot.lab:8081", "robot.lab:8080")
    assert not public.allows_origin("http://robot.lab", None)


def test_a_frame_has_the_token_of_its_connection_in_its_address() -> None:
    """Browsers keep no cookies of frames in other pages, such as notebooks."""
    with served() as page:
        port = page.server.get_port()
        found = parse_qs(urlsplit(page.frame_address).query)
        (connection,) = found["websocket"]
        assert answered(port, f"/?token={found['token'][0]}").status == 200
        assert connection.startswith(f"ws://127.0.0.1:{port}/")
        assert connects(port, f"/?{urlsplit(connection).query}", origin=f"http://127.0.0.1:{port}")


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.7.3", "robot.lab"])
def test_the_address_of_a_public_host_is_one_that_others_reach(host: str) -> None:
    access = Access.to(host)
    name = urlsplit(access.address(8080)).hostname
    assert name not in ("0.0.0.0", "::", "localhost", None, "")
    assert name == host or host in ("0.0.0.0", "::")
    assert access.address(8080).endswith(f":8080/?token={access.token}")
    assert access.token not in repr(access)


def test_nobody_can_have_a_tunnel_opened() -> None:
    with served() as page:
        handlers = page.server._websock_server._incoming_handlers
        assert viser._messages.ShareUrlRequest not in handlers or not handlers[viser._messages.ShareUrlRequest]


def test_the_newest_state_is_drawn_once_in_a_period_and_a_part_that_breaks_does_not_harm_others(
    viewer: Controller, capsys: pytest.CaptureFixture[str]
) -> None:
    drawn: list[int] = []
    release = threading.Event()

    def slow(state: State) -> None:
        release.wait(PATIENCE_S)
        drawn.append(state.change)

    def broken(state: State) -> None:
        raise ValueError("broken")

    states = [replace(viewer.state, change=change) for change in range(11)]
    drawer = Drawer([broken, slow], states[0], period=0.0)
    for state in states[1:10]:
        drawer.draw(state)
    release.set()
    drawer.settle(PATIENCE_S)
    # The first may have begun before the others came.
    assert drawn in ([9], [0, 9])
    drawer.draw(states[10])
    drawer.settle(PATIENCE_S)
    assert drawn[-1] == 10 and "ValueError: broken" in capsys.readouterr().err
    drawer.close()
    drawer.draw(states[0])
    drawer.settle(0.01)  # never drawn: it comes back all the same
    seldom = Drawer([slow], states[1], period=600.0)
    seldom.settle(PATIENCE_S)
    seldom.draw(states[2])
    seldom.close()
    assert drawn[-1] == 1


def test_a_page_can_ask_whether_its_program_still_runs_and_knows_how_to_start_it_again() -> None:
    page = open_server("127.0.0.1", 0, again="refine-grasp view '</script>'")
    try:
        port = page.server.get_port()
        token = f"?token={page.access.token}"
        assert answered(port, f"/alive{token}").status == 204
        asked = HTTPConnection("127.0.0.1", port, timeout=PATIENCE_S)
        asked.request("GET", f"/{token}", headers={"Accept-Encoding": "identity"})
        text = asked.getresponse().read()
        text = (gzip.decompress(text) if text[:2] == b"\x1f\x8b" else text).decode()
        asked.close()
        assert "refine-grasp view '\\u003c/script>'" in text
    finally:
        close_server(page.server)
