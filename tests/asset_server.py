"""What tests of assets share: a web server on this machine that can misbehave, and a made-up hand to fetch from it."""

from __future__ import annotations

import hashlib
import json
import threading
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import unquote

from grasp_refine.assets.manifest import Asset, read_manifest
from running_processes import PATIENCE_S

CONTENTS = {
    "claw.urdf": b"<robot name='claw'/>\n",
    "meshes/palm.obj": bytes(range(256)) * 40,
    "meshes/tip.obj": hashlib.sha256(b"tip").digest() * 10_000,
}
"""The files of the made-up hand; the last one is larger than what is sent at once."""

MIDDLE = "/claw/meshes/tip.obj"
"""Address of the large file."""


class Server(ThreadingHTTPServer):
    """Serves a folder; `faults` says of an address how it is answered wrongly, and `asked` counts requests."""

    daemon_threads = True

    def __init__(self, root: Path) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.root, self.faults, self.asked = root, {}, Counter()
        self.stalled, self.go_on = threading.Event(), threading.Event()

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.server_address[1]}"


class _Handler(BaseHTTPRequestHandler):
    server: Server

    def log_message(self, format: str, *arguments: object) -> None:
        """Keep quiet."""

    def do_GET(self) -> None:
        path = unquote(self.path)
        self.server.asked[path] += 1
        fault = self.server.faults.get(path)
        if isinstance(fault, list):  # one answer after another
            fault = fault.pop(0) if fault else None
        file = self.server.root / path.lstrip("/")
        content = file.read_bytes() if file.is_file() else None
        if isinstance(fault, int) or content is None:
            self.send_error(fault if isinstance(fault, int) else 404)
            return
        if fault is not None and fault.startswith("to "):
            self.send_response(302)
            self.send_header("Location", fault.removeprefix("to "))
            self.send_header("Content-Length", "0")
            self.end_headers()
            return
        content = {"wrong": content[:-1] + b"?", "endless": content * 50}.get(fault, content)
        length = {"cut": len(content), "short": len(content) // 2, "long": len(content) + 1000}.get(fault, len(content))
        self.send_response(200)
        if fault != "endless":
            self.send_header("Content-Length", str(length))
        self.end_headers()
        if fault == "stall":
            self.wfile.write(content[: len(content) // 2])
            self.server.stalled.set()
            self.server.go_on.wait(PATIENCE_S)
            return
        self.wfile.write(content[: len(content) // 2] if fault in ("cut", "short") else content)


@contextmanager
def serving(root: Path) -> Iterator[Server]:
    server = Server(root)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)
    thread.start()
    try:
        yield server
    finally:
        server.go_on.set()
        server.shutdown()
        server.server_close()
        thread.join()


def made_tree(folder: Path) -> Path:
    """A mirror with the made-up hand in it."""
    for name, content in CONTENTS.items():
        path = folder / "claw" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    return folder


def made_asset(folder: Path, **changes: object) -> Asset:
    """The made-up hand, out of a manifest that is written to `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    files = [
        f'{{ path = "{name}", sha256 = "{hashlib.sha256(content).hexdigest()}", bytes = {len(content)} }}'
        for name, content in CONTENTS.items()
    ]
    values = {
        "repository": "https://github.com/made/up",
        "commit": "0" * 40,
        "mirror": "claw",
        "licence": "MIT",
        "terms": "open",
        "citation": "none stated",
        "unit": "m",
        "scale": 1.0,
        "main": "claw.urdf",
    }
    lines = [f"{key} = {json.dumps(value)}" for key, value in (values | changes).items()]
    text = "\n".join(["[claw]", *lines, f"files = [{', '.join(files)}]"])
    (folder / "hands.toml").write_text(text + "\n")
    return read_manifest("hands", folder)["claw"]
