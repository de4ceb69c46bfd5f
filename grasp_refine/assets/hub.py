"""Data sets of the Hugging Face Hub: `hf://owner/name[/path]`, by huggingface_hub and its cache, on their terms."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import yaml

from grasp_refine.assets.licence import accept, check_accepted
from grasp_refine.core.errors import AssetError

PREFIX = "hf:/"
"""Beginning of the names of data sets, as a `Path` has it: hf:/owner/name."""
CARD = "README.md"
"""Card of a data set, which has its licence."""
OPEN = (
    *("apache-2.0", "mit", "isc", "bsd", "bsd-2-clause", "bsd-3-clause", "unlicense", "cc0-1.0", "pddl", "odc-by"),
    *("cc-by-2.0", "cc-by-3.0", "cc-by-4.0", "cc-by-sa-3.0", "cc-by-sa-4.0", "cdla-permissive-2.0"),
)
"""Licences, by the Hub's names, that allow any use."""
NON_COMMERCIAL = re.compile(r"(?:^|-)nc(?:-|$)")
"""Part of the name of a licence that excludes commercial use."""
CARD_START = re.compile(r"\A---\s*\n(.*?)\n---\s*(?:\n|\Z)", re.DOTALL)
"""The facts at the beginning of a card."""
NAME = re.compile(r"[A-Za-z0-9][\w.-]{0,95}")
"""Owner or name of a data set."""
MAX_CARD_CHARACTERS = 2**20
"""Most characters of a card that are read."""
INSTALL = "it takes huggingface_hub: pip install 'grasp-refine[hub]'"


@dataclass(frozen=True)
class HubDataset:
    """A data set of the Hub, or a part of it, with its licence."""

    name: str
    """OWNER/NAME."""
    below: PurePosixPath
    """File or folder in it; ".": all."""
    licence: str
    """Licence that its card states."""
    terms: str
    """Terms of the licence: open, non-commercial or unclear."""
    kind: str = "hub"
    """Folder of its record in the cache of assets."""

    @property
    def full_name(self) -> str:
        """Name with its beginning."""
        return f"hf://{self.name}"


def is_on_hub(path: str | Path) -> bool:
    """Return whether a path names a data set of the Hub."""
    return str(path).startswith(PREFIX)


def hub_dataset(path: str | Path, on_message: Callable[[str], None]) -> HubDataset:
    """Return the data set that a path names; its card is fetched where it is not in the cache.

    Raises:
        AssetError: the name is invalid, huggingface_hub is missing, or the data set cannot be had.
    """
    owner, name, *below = [part for part in str(path).removeprefix(PREFIX).split("/") if part] + ["", ""]
    below = [part for part in below if part]
    if not (NAME.fullmatch(owner) and NAME.fullmatch(name)) or ".." in below:
        raise AssetError(f"{path}: names no data set of the Hub: hf://OWNER/NAME, or hf://OWNER/NAME/PATH")
    full = f"{owner}/{name}"
    folder = _snapshot(full, [CARD])
    licence = _licence(folder / CARD)
    terms = "open" if licence in OPEN else "non-commercial" if NON_COMMERCIAL.search(licence) else "unclear"
    return HubDataset(full, PurePosixPath(*below), licence, terms)


def fetch_dataset(
    dataset: HubDataset, suffixes: Sequence[str], on_message: Callable[[str], None], *, accept_license: bool = False
) -> Path:
    """Return the local file or folder of a data set; only its files with some endings are fetched.

    Args:
        dataset: Data set, or a part of it.
        suffixes: Endings of the files.
        on_message: Called with a line before something may be fetched.
        accept_license: The user has accepted a licence that restricts use; this is recorded.

    Raises:
        AssetError: the licence is not accepted, or the files cannot be had.
    """
    if accept_license:
        accept(dataset)
    check_accepted(dataset)
    on_message(f"{dataset.full_name}: licence {dataset.licence} ({dataset.terms}); its files are taken from the cache "
               "of huggingface_hub, or fetched")  # fmt: skip
    below = "" if str(dataset.below) == "." else str(dataset.below)
    wanted = [f"{below}/*{suffix}" if below else f"*{suffix}" for suffix in suffixes]
    folder = _snapshot(dataset.name, [*wanted, *([below] if below else [])])
    place = folder / below
    if not place.exists():
        raise AssetError(f"{dataset.full_name}: has no {below} with files that end with {', '.join(suffixes)}")
    return place


def _snapshot(name: str, patterns: list[str]) -> Path:
    """Folder with the files of a data set that match, in the cache of huggingface_hub."""
    try:
        import huggingface_hub
        from huggingface_hub import errors
    except ImportError:
        raise AssetError(f"hf://{name}: {INSTALL}") from None
    try:
        return Path(huggingface_hub.snapshot_download(name, repo_type="dataset", allow_patterns=patterns))
    except errors.LocalEntryNotFoundError:
        raise AssetError(f"hf://{name}: is not in the cache of huggingface_hub, and the Hub is not reached") from None
    except errors.RepositoryNotFoundError:
        raise AssetError(f"hf://{name}: the Hub has no such data set, or it needs `hf auth login`") from None
    except (errors.HfHubHTTPError, OSError, ValueError) as error:
        raise AssetError(f"hf://{name}: cannot be fetched ({' '.join(str(error).split())[:120]})") from None


def _licence(card: Path) -> str:
    """Licence that a card states, by the Hub's name; "none stated" where it does not."""
    try:
        text = card.read_text(encoding="utf-8", errors="replace")[:MAX_CARD_CHARACTERS]
        found = CARD_START.match(text.replace("\r\n", "\n"))
        facts: Any = yaml.safe_load(found[1]) if found and "*" not in found[1] else None
    except (OSError, yaml.YAMLError, RecursionError):
        facts = None
    value = facts.get("license") if isinstance(facts, dict) else None
    if isinstance(value, list) and value:
        value = value[0] if len(value) == 1 else ", ".join(map(str, value))
    if value == "other" and isinstance(facts, dict):
        value = f"other: {facts.get('license_name', 'without a name')}"
    text = "none stated" if value is None else str(value).lower()
    return text[:100] if text.isprintable() else "none stated"
