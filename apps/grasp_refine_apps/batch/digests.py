"""Hashes of everything that the result of a shard depends on: contents of files, and settings."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from grasp_refine.core.errors import HandError
from grasp_refine.core.json_files import dumps
from grasp_refine.core.names import exists
from grasp_refine.core.versions import own_version
from grasp_refine.hands.files.mesh_files import resolve_mesh
from grasp_refine.hands.files.mjcf_xml import MJCF_SUFFIXES
from grasp_refine.hands.files.source import ON_ARM, hand_files
from grasp_refine.objects.region_spec import VERBS, spec_digest
from grasp_refine.objects.source import ObjectSource
from grasp_refine.problem.spec import AUTO, NEAREST, ProblemSpec, SourceSpec
from grasp_refine.results.document import settings
from grasp_refine.results.result_files import fingerprint
from grasp_refine.scene.protocols.protocol import Protocol
from grasp_refine.scene.protocols.protocol_file import load_protocol
from grasp_refine.transfers.key_points import MANO

LAYOUT_VERSION = 1
"""Version of the layout of result files; a new number makes all results outdated."""

SCAN_FILES = ("camera", "intrinsics", "mask", "completions")
"""Inputs of a scan that are files or folders, or numbers."""

CONTENT_INPUTS = (
    "hand",
    "transfer_from",
    "arm",
    "urdf",
    "mjcf",
    "object",
    "object_name",
    "objects",
    "grasps",
    "targets",
    "index",
    "scene",
    *SCAN_FILES,
)
"""Inputs that are hashed by their contents, not by their names."""

IGNORED_INPUTS = ("other_object", "as_is")
"""Inputs that only permit a command, and do not change its results."""

_MESH_NAME = re.compile(r"""(?:filename|file)\s*=\s*["']([^"']+)["']""")
"""Pattern of the names of meshes in URDF and MJCF files."""

_MESH_FOLDER = re.compile(r"""(?:meshdir|assetdir)\s*=\s*["']([^"']+)["']""")
"""Pattern of the mesh folder in MJCF files."""


class Digests:
    """Hashes of files, each read once."""

    def __init__(self) -> None:
        """Begin with an empty cache."""
        self._files: dict[Path, dict[str, str]] = {}
        self._hands: dict[tuple[Any, ...], tuple[str, str]] = {}
        self._protocols: dict[str, Protocol] = {}

    def file(self, path: Path) -> dict[str, str]:
        """Path and sha256 of a file or a folder, as `results.result_files.fingerprint`."""
        if path not in self._files:
            self._files[path] = fingerprint(path)
        return self._files[path]

    def hand(self, source: str, inputs: SourceSpec, say: Callable[[str], None]) -> tuple[str, str]:
        """Name of a hand, or of one on an arm, and hash of the files of both and all meshes that they name.

        Where grasps are transferred, the files of their own hand count, too.

        Raises:
            AssetError, HandError: there is no such hand, or it cannot be read.
        """
        hand = self._robot(source, inputs.urdf, inputs.mjcf, say)
        if inputs.transfer_from not in (None, MANO):
            hand = hand[0], sha256_of([hand[1], self._robot(inputs.transfer_from, None, None, say)[1]])
        if inputs.arm is None:
            return hand
        arm = self._robot(inputs.arm, None, None, say)
        return f"{hand[0]}{ON_ARM}{arm[0]}", sha256_of([hand[1], arm[1]])

    def _robot(self, source: str, urdf: Path | None, mjcf: Path | None, say: Callable[[str], None]) -> tuple[str, str]:
        """Name of a hand or an arm, and hash of its files."""
        key = (source, urdf, mjcf)
        if key not in self._hands:
            name, toml = hand_files(source, urdf, mjcf, say)
            assert toml.file is not None
            described = [path for path in (toml.file, toml.path, toml.mjcf) if path is not None]
            files = dict.fromkeys(file for path in described for file in (path, *_meshes(path)))
            # Without their folders: a copy of a hand is the same hand.
            contents = [(file.name, self.file(file)["sha256"]) for file in files]
            self._hands[key] = (toml.name or name, sha256_of(contents))
        return self._hands[key]

    def _protocol(self, source: str) -> Protocol:
        """Protocol of a name or a file, which is read once."""
        if source not in self._protocols:
            self._protocols[source] = load_protocol(source)
        return self._protocols[source]

    def object(self, source: ObjectSource) -> str:
        """Hash of a mesh file or a folder of pieces; the name of an object without a file."""
        path = Path(source.source)
        return self.file(path)["sha256"] if path.exists() else str(source.source)

    def stamp(self, inputs: ProblemSpec, **depends: Any) -> str:
        """Hash of the inputs' settings, the targets, this version, and everything else that the result `depends` on."""
        described = {
            name: value for name, value in settings(inputs).items() if name not in (*CONTENT_INPUTS, *IGNORED_INPUTS)
        }
        # Files of a protocol and of regions count by their contents, and nothing does where there are no regions.
        if isinstance(inputs.protocol, str):
            described["protocol"] = settings(self._protocol(inputs.protocol))
        for name in VERBS:
            specs = described.pop(name)
            depends |= {name: [spec_digest(spec) for spec in specs]} if specs else {}
        for name in SCAN_FILES:
            if (value := getattr(inputs, name)) is not None:
                path = Path(value)
                depends[name] = self.file(path)["sha256"] if exists(path) else str(value)
        targets = inputs.targets
        if targets not in (AUTO, NEAREST):
            targets = self.file(Path(targets))["sha256"]
        return sha256_of(
            {"layout": LAYOUT_VERSION, "version": own_version(), "inputs": described, "targets": targets, **depends}
        )


def _meshes(path: Path, seen: tuple[Path, ...] = (), folders: tuple[Path, ...] = ()) -> list[Path]:
    """Existing meshes, and included files with more of them, that a URDF or MJCF file names.

    `folders` are those for meshes of the files that include this one, whose meshes may be there as well.
    """
    text = path.read_text(encoding="utf-8", errors="replace")
    folders = (*folders, path.parent, *(path.parent / name for name in sorted(set(_MESH_FOLDER.findall(text)))))
    found = []
    for name in sorted(set(_MESH_NAME.findall(text))):
        try:
            files = [resolve_mesh(name, path)]
        except HandError:
            # Missing meshes are reported when the hand is loaded; MJCF files may name a folder for their meshes.
            files = [file for folder in folders if (file := folder / name).is_file()]
        found += files
        for file in files:
            if file.suffix.lower() in MJCF_SUFFIXES and file not in (*seen, path):
                found += _meshes(file, (*seen, path), folders)
    return found


def sha256_of(value: Any) -> str:
    """Return the hash of a value, as JSON writes it."""
    return hashlib.sha256(dumps(value).encode()).hexdigest()
