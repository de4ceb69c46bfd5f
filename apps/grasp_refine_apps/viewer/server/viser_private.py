"""Private parts of viser 1.1 that the viewer uses, each with the reason; nothing else touches any but page_head.html.

page_head.html is the half that runs in the page: keys, links, placeholders, and overlays.

The upper bound of the version in pyproject.toml is there for them. In the page, viser keeps `window.__viserMutable`
and `window.__viserSceneTree` for its own tests.
"""

from __future__ import annotations

import asyncio
import gzip
import json
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from functools import lru_cache
from http import HTTPStatus
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from urllib.parse import urlsplit

import viser
import websockets.asyncio.server
from viser import _icons, _messages
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from grasp_refine_apps.viewer.server.access import Access

Answer = Callable[[Any, Request], Response | None]
"""Function that answers a request; None: it is a websocket's, to be accepted."""

PAGE_HEAD = Path(__file__).parent / "page_head.html"
"""Style and script that are added to the page; its private parts are `window.__viserMutable` and names of classes."""

ALIVE = "/alive"
"""Path by which a page asks whether the program still runs."""

GZIP_LEVEL = 1
"""Compression of the page, which is sent over this machine mostly."""

MAX_CONCURRENT_UPLOADS = 4
"""Maximum concurrent uploads of a page."""

NODE_TEXT = """const node = window.__viserSceneTree && window.__viserSceneTree.getState()["NAME"];
    const text = node && node.message.props.text;"""
"""Script that sets `text` to the text of the label NAME: exported pages have no other way to read the scene."""


Site = viser.ViserServer | viser.ClientHandle
"""All pages of a server together, or one page: both have a scene and widgets of their own."""


def pages_of(site: Site) -> dict[int, viser.ClientHandle]:
    """Return the pages of a site that are connected, by number; viser keeps handles of pages that were closed."""
    if isinstance(site, viser.ViserServer):
        return site.get_clients()
    return {number: page for number, page in site._viser_server.get_clients().items() if page is site}


def widget_id(handle: Any) -> str:
    """Return the id that a widget has in messages and, for buttons, in the page: needed to style or address it."""
    return str(handle._impl.uuid)


def is_removed(handle: Any) -> bool:
    """Return whether a widget was removed: setting its value then raises."""
    return bool(handle._impl.removed)


def send_value(handle: Any) -> None:
    """Send the value of a widget to all pages; setting an unchanged value sends nothing."""
    handle._queue_update("value", handle.value)


def event_loop(handle: Any) -> asyncio.AbstractEventLoop:
    """Return the loop of viser's thread, where changes by users arrive: what is set there comes in their order."""
    loop: asyncio.AbstractEventLoop = handle._impl.gui_api._event_loop
    return loop


def click_script(handle: Any) -> str:
    """Return a script that sends the attribute data-do of a clicked element as the value of a text widget.

    viser has no events of HTML. A number makes each value new, since equal ones are not sent on.
    """
    return (
        "const c=event.target.closest('[data-do]');"
        "if(c&&window.__viserMutable)window.__viserMutable.sendMessage({type:'GuiUpdateMessage',uuid:"
        f"{json.dumps(widget_id(handle))},updates:{{value:c.dataset.do+' '+performance.now()}}}})"
    )


@contextmanager
def guarded(access: Access, again: str = "") -> Iterator[None]:
    """Let a server that is started in this context answer only the requests that `access` allows.

    Its page names the command `again` when the program has ended.

    Otherwise any page that is open in the same browser could connect to it, and anyone on the network; viser passes
    no origins on, and knows no tokens.
    """
    module: Any = websockets.asyncio.server
    serve = module.serve

    def serve_guarded(*args: Any, process_request: Answer, **options: Any) -> Any:
        return serve(*args, process_request=_guarded_answer(process_request, access, again), **options)

    module.serve = serve_guarded
    try:
        yield
    finally:
        module.serve = serve


def _guarded_answer(answer: Answer, access: Access, again: str) -> Answer:
    """Return a function that refuses requests, and otherwise returns what `answer` returns."""

    def guarded_answer(connection: Any, request: Request) -> Response | None:
        headers, port = request.headers, int(connection.local_address[1])
        # Several headers of one name raise in `get`.
        origin, host, cookie = (next(iter(headers.get_all(name)), None) for name in ("Origin", "Host", "Cookie"))
        if not access.allows_token(request.path, cookie, port):
            # viser's own answer ignores errors in the log of the library.
            return _refusal("Open the whole address that refine-grasp view printed: it ends with a token.")
        if not access.allows_origin(origin, host):
            return _refusal("Only the page of this server may connect to it.")
        if urlsplit(request.path).path == ALIVE:
            return Response(HTTPStatus.NO_CONTENT, "No Content", Headers())
        found = answer(connection, request)
        if found is not None:
            _add_head(found, again)
            for name, value in access.cookies(port).items():
                found.headers[name] = value
        return found

    return guarded_answer


def _add_head(response: Response, again: str) -> None:
    """Add our style and script to the page, if it is one, with the command that serves it again.

    viser has neither keys that its camera leaves alone, nor links, nor placeholders, nor a way to draw over everything,
    and runs no script in HTML of the panel.
    """
    headers, body = response.headers, bytes(response.body)
    if "html" not in headers.get("Content-Type", "") or b"<head>" not in (page := _unpacked(headers, body)):
        return
    head = PAGE_HEAD.read_text(encoding="utf-8").replace('"GR_AGAIN"', json.dumps(again).replace("<", "\\u003c"))
    page = page.replace(b"<head>", b"<head>" + head.encode(), 1)
    response.body = gzip.compress(page, GZIP_LEVEL) if headers.get("Content-Encoding") == "gzip" else page
    del headers["Content-Length"]
    headers["Content-Length"] = str(len(response.body))


@lru_cache(maxsize=2)
def _gunzipped(body: bytes) -> bytes:
    return gzip.decompress(body)


def _unpacked(headers: Headers, body: bytes) -> bytes:
    return _gunzipped(body) if headers.get("Content-Encoding") == "gzip" else body


def _refusal(text: str) -> Response:
    body = f"{text}\n".encode()
    headers = Headers({"Content-Type": "text/plain; charset=utf-8", "Content-Length": str(len(body))})
    return Response(HTTPStatus.FORBIDDEN, "Forbidden", headers, body)


@contextmanager
def icons_opened() -> Iterator[None]:
    """Open viser's file of icons once in this context: viser reads the names of all 5000 icons for each button."""
    module: Any = _icons
    before = module.zipfile
    with zipfile.ZipFile(module.ICONS_DIR / "tabler-icons.zip") as opened:
        module.zipfile = SimpleNamespace(ZipFile=lambda path: nullcontext(opened))
        try:
            yield
        finally:
            module.zipfile = before


def forbid_sharing(server: viser.ViserServer) -> None:
    """Disable share links, with which any page that reaches the server could open a tunnel to the outside."""
    server._websock_server.unregister_handler(_messages.ShareUrlRequest)


def limit_uploads(site: Site, max_bytes: int, refuse: Callable[[str, int], None]) -> None:
    """Refuse uploads of more than `max_bytes`, and too many at once; their bytes are dropped as they arrive.

    viser keeps whatever a browser sends in memory, and has no limit: its own record of uploads under way is used, after
    its own handlers, which ignore the parts of uploads that are not in it.

    Args:
        site: The pages.
        max_bytes: Maximum bytes of one upload.
        refuse: Called with name and size of each refused upload, in the server's event loop; must return at once.
    """
    under_way, interface = uploads_under_way(site), site.gui._websock_interface

    def on_start(_: int, message: _messages.FileTransferStartUpload) -> None:
        size = message.size_bytes
        # viser waits for parts of an empty file, and there is none.
        if not 0 < size <= max_bytes or len(under_way) > MAX_CONCURRENT_UPLOADS:
            if under_way.pop(message.transfer_uuid, None) is not None:
                # The browser waits for the last byte to be received, and lets nothing else be uploaded until then.
                interface.queue_message(
                    _messages.FileTransferPartAck(message.source_component_uuid, message.transfer_uuid, size, size)
                )
                refuse(message.filename, size)

    def on_part(_: int, message: _messages.FileTransferPart) -> None:
        state = under_way.get(message.transfer_uuid)
        if state is not None and state["transferred_bytes"] > state["total_bytes"]:
            # More than declared at the beginning.
            under_way.pop(message.transfer_uuid, None)

    interface.register_handler(_messages.FileTransferStartUpload, on_start)
    interface.register_handler(_messages.FileTransferPart, on_part)


def uploads_under_way(site: Site) -> dict[str, Any]:
    """Return viser's record of the uploads that are under way, by their ids."""
    record: dict[str, Any] = site.gui._current_file_upload_states
    return record
