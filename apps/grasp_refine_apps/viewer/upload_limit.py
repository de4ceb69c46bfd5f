"""Limit of uploads, enforced when they begin: viser itself keeps whatever a browser sends in memory."""

from __future__ import annotations

from collections.abc import Callable

import viser
from viser import _messages

MAX_CONCURRENT_UPLOADS = 4
"""Maximum concurrent uploads of all browsers together."""


def limit_uploads(server: viser.ViserServer, largest: int, refuse: Callable[[str, int], None]) -> None:
    """Refuse uploads of more than `largest` bytes, and too many at once; their bytes are dropped as they arrive.

    viser 1.1 has no limit and no public way to set one: its own record of uploads under way is used, after its own
    handlers, which ignore the parts of uploads that are not in it.

    Args:
        server: The server.
        largest: Maximum bytes of one upload.
        refuse: Called with name and size of each refused upload, in the server's event loop; must return at once.
    """
    under_way = server.gui._current_file_upload_states

    def on_start(_: int, message: _messages.FileTransferStartUpload) -> None:
        size = message.size_bytes
        if not 0 <= size <= largest or len(under_way) > MAX_CONCURRENT_UPLOADS:
            if under_way.pop(message.transfer_uuid, None) is not None:
                # The browser waits for the last byte to be received, and lets nothing else be uploaded until then.
                server._websock_server.queue_message(
                    _messages.FileTransferPartAck(message.source_component_uuid, message.transfer_uuid, size, size)
                )
                refuse(message.filename, size)

    def on_part(_: int, message: _messages.FileTransferPart) -> None:
        state = under_way.get(message.transfer_uuid)
        if state is not None and state["transferred_bytes"] > state["total_bytes"]:
            # More than declared at the beginning.
            under_way.pop(message.transfer_uuid, None)

    server._websock_server.register_handler(_messages.FileTransferStartUpload, on_start)
    server._websock_server.register_handler(_messages.FileTransferPart, on_part)
