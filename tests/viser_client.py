"""A client of viser without a browser: it sends what a browser would, and keeps what it is told."""

from __future__ import annotations

import math
import struct
import threading
import time
from collections.abc import Callable
from typing import Any

import msgspec.msgpack
import zstandard
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect


class Client:
    """A connection, which the server takes for a browser; a context manager."""

    def __init__(self, port: int) -> None:
        import viser

        self._connection = connect(
            f"ws://127.0.0.1:{port}", subprotocols=[f"viser-v{viser.__version__}"], max_size=None
        )
        self.told: list[dict[str, Any]] = []
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()
        self.send(
            "ViewerCameraMessage",
            wxyz=(1.0, 0.0, 0.0, 0.0),
            position=(0.0, 0.0, 1.0),
            fov=1.0,
            near=0.01,
            far=10.0,
            image_height=48,
            image_width=64,
            look_at=(0.0, 0.0, 0.0),
            up_direction=(0.0, 0.0, 1.0),
        )

    def send(self, kind: str, **values: Any) -> None:
        """Send a message."""
        self._connection.send(msgspec.msgpack.encode({"type": kind, **values}))

    def upload(
        self, button: str, name: str, content: bytes, *, said: int | None = None, part: int = 2**19, key: str = "1"
    ) -> None:
        """Upload a file as a browser does; `said` is the size that it claims."""
        parts = [content[at : at + part] for at in range(0, len(content), part)]
        self.send(
            "FileTransferStartUpload",
            source_component_uuid=button,
            transfer_uuid=key,
            filename=name,
            mime_type="",
            part_count=math.ceil(len(content) / part),
            size_bytes=len(content) if said is None else said,
        )
        for at, piece in enumerate(parts):
            self.send("FileTransferPart", source_component_uuid=button, transfer_uuid=key, part_index=at, content=piece)

    def click(self, button: str) -> None:
        """Click a button."""
        self.send("GuiUpdateMessage", uuid=button, updates={"value": True})

    def wait(self, ready: Callable[[Client], Any], seconds: float = 20.0) -> Any:
        """What `ready` gives once it is true."""
        end = time.monotonic() + seconds
        while not (found := ready(self)):
            assert time.monotonic() < end, "nothing came"
            time.sleep(0.02)
        return found

    def downloads(self) -> dict[str, bytes]:
        """The files that have come whole: name -> content."""
        found = {}
        for start in self.of("FileTransferStartDownload"):
            parts = [p for p in self.of("FileTransferPart") if p["transfer_uuid"] == start["transfer_uuid"]]
            if len(parts) == start["part_count"]:
                found[start["filename"]] = b"".join(p["content"] for p in sorted(parts, key=lambda p: p["part_index"]))
        return found

    def of(self, kind: str) -> list[dict[str, Any]]:
        """What was told in messages of a kind."""
        return [message for message in list(self.told) if message["type"] == kind]

    def close(self) -> None:
        """Leave."""
        self._connection.close()

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _listen(self) -> None:
        try:
            while True:
                raw = self._connection.recv()
                assert isinstance(raw, bytes)
                size, packed = struct.unpack("<QQ", raw[:16])
                text = zstandard.ZstdDecompressor().decompress(raw[16 : 16 + packed], max_output_size=size)
                self.told += msgspec.msgpack.decode(text)["messages"]
        except ConnectionClosed:
            pass
