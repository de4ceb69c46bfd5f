"""A page without a browser: it talks to a viser server over its websocket, in the words of a real one."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import msgspec
import numpy as np
import viser
import zstandard
from viser._messages import GuiUpdateMessage, Message, ScenePointerMessage, ViewerCameraMessage
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from grasp_refine.core.se3 import transform_from_pose
from running_processes import PATIENCE_S

DRAWING = threading.RLock()
"""Held while a panel draws, and while `until` looks: it sees all of a state, or nothing of it."""


@dataclass
class Node:
    """A node of the scene."""

    props: dict[str, Any]
    """Its properties."""
    pose: dict[str, Any] = field(default_factory=lambda: {"position": (0.0, 0.0, 0.0), "wxyz": (1.0, 0.0, 0.0, 0.0)})
    visible: bool = True

    @property
    def T(self) -> np.ndarray:
        """Pose (4, 4) in the frame of its parent."""
        return transform_from_pose(np.concatenate([self.pose["position"], self.pose["wxyz"]])[None])[0]


class Page:
    """Connected to a server; close it before the server stops."""

    def __init__(self, server: viser.ViserServer, token: str = "") -> None:
        """Connect, and look at the scene, without which viser hears nothing of a page."""
        self.messages: list[dict[str, Any]] = []
        """All that the server said, in turn."""
        known = set(server.get_clients())
        self._socket = connect(
            f"ws://127.0.0.1:{server.get_port()}/?token={token}",
            subprotocols=[f"viser-v{viser.__version__}"],
            max_size=None,
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        self.look((1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
        until(lambda: set(server.get_clients()) - known)

    def change(self, handle: Any, value: Any) -> None:
        """Change a widget, as a user would; a button is pressed with True."""
        self._send(GuiUpdateMessage(handle._impl.uuid, {"value": value}))

    def look(self, wxyz: tuple[float, ...], position: tuple[float, ...]) -> None:
        """Look from a position along the z axis of a camera, with an opening of 1 rad in a picture of 800 x 600."""
        self._send(ViewerCameraMessage(wxyz, position, 1.0, 0.01, 100.0, 600, 800, (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)))

    def draw_rectangle(self, low: tuple[float, float], high: tuple[float, float]) -> None:
        """Drag a rectangle over the scene with Shift held, from 0 to 1."""
        self._send(ScenePointerMessage("rect-select", None, None, (low, high), "shift"))

    def told(self, handle: Any, name: str = "value") -> list[Any]:
        """What the server set a property of a widget to, in turn."""
        updates = [message for message in list(self.messages) if message["type"] == "GuiUpdateMessage"]
        changes = [message["updates"] for message in updates if message["uuid"] == handle._impl.uuid]
        return [changed[name] for changed in changes if name in changed]

    def nodes(self) -> dict[str, Node]:
        """The scene as a browser makes it of the messages: name -> node."""
        found: dict[str, Node] = {}
        for message in list(self.messages):
            name, kind = message.get("name"), message["type"]
            if kind == "RemoveSceneNodeMessage":
                found = {each: node for each, node in found.items() if not f"{each}/".startswith(f"{name}/")}
            elif "props" in message and isinstance(name, str):
                found[name] = Node(dict(message["props"]))
            elif name in found:
                node = found[name]
                node.pose |= {key: message[key] for key in node.pose.keys() & message}
                node.visible = message.get("visible", node.visible)
                node.props |= message.get("updates", {})
        return found

    def close(self) -> None:
        """Leave."""
        self._socket.close()
        self._reader.join(PATIENCE_S)

    def _send(self, message: Message) -> None:
        self._socket.send(msgspec.msgpack.encode(message.as_serializable_dict()))

    def _read(self) -> None:
        unpack = zstandard.ZstdDecompressor()
        try:
            for frame in self._socket:
                size, packed = (int.from_bytes(frame[at : at + 8], "little") for at in (0, 8))
                window = msgspec.msgpack.decode(unpack.decompress(frame[16 : 16 + packed], max_output_size=size))
                self.messages += window["messages"]
        except ConnectionClosed:
            pass


def until(said: Callable[[], Any], seconds: float = PATIENCE_S) -> Any:
    """What `said` returns when it is true for the first time.

    Raises:
        AssertionError: it was not within so many seconds.
    """
    end = time.monotonic() + seconds
    while True:
        with DRAWING:
            found = said()
        if found:
            return found
        assert time.monotonic() < end, f"not within {seconds:g} s"
        time.sleep(0.01)
