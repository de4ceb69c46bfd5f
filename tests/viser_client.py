"""A page without a browser that uploads, and keeps the files that it is sent."""

from __future__ import annotations

import math
from typing import Any

from viser._messages import FileTransferPart, FileTransferStartUpload, GetRenderResponseMessage

from websocket_page import Page, until


class Client(Page):
    """A page that uploads and downloads; a context manager."""

    def upload(
        self, button: Any, name: str, content: bytes, *, said: int | None = None, part: int = 2**19, key: str = "1"
    ) -> None:
        """Upload a file as a browser does; `said` is the size that it claims."""
        self.announce(button, name, len(content) if said is None else said, math.ceil(len(content) / part), key)
        for at in range(0, len(content), part):
            self.send_part(button, at // part, content[at : at + part], key)

    def announce(self, button: Any, name: str, size: int, parts: int, key: str = "1") -> None:
        """Say that an upload begins."""
        self._send(FileTransferStartUpload(button._impl.uuid, key, name, "", parts, size))

    def send_part(self, button: Any, at: int, content: bytes, key: str = "1") -> None:
        """Send a part of it."""
        self._send(FileTransferPart(button._impl.uuid, key, at, content))

    def draw(self, request: dict[str, Any], picture: bytes) -> None:
        """Answer what asks for a picture."""
        self._send(GetRenderResponseMessage(payload=picture, render_uuid=request["render_uuid"]))

    def of(self, kind: str) -> list[dict[str, Any]]:
        """What was told in messages of a kind."""
        return [message for message in list(self.messages) if message["type"] == kind]

    def downloads(self) -> dict[str, bytes]:
        """The files that have come whole: name -> content."""
        found = {}
        for start in self.of("FileTransferStartDownload"):
            parts = [p for p in self.of("FileTransferPart") if p["transfer_uuid"] == start["transfer_uuid"]]
            if len(parts) == start["part_count"]:
                found[start["filename"]] = b"".join(p["content"] for p in sorted(parts, key=lambda p: p["part_index"]))
        return found

    def download(self) -> tuple[str, bytes]:
        """Name and content of the only file, once it has come."""
        until(self.downloads)
        ((name, content),) = self.downloads().items()
        return name, content

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
