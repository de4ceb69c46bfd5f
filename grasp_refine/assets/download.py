"""One file to one place: over http(s) or from a folder, its hash checked before it appears under its name.

A file that is cut starts again: what arrived lies under a temporary name, is removed, and never taken for whole.
"""

from __future__ import annotations

import os
import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeGuard
from urllib.parse import urlsplit

from grasp_refine.assets.origin import HOW_TO_MIRROR, shown
from grasp_refine.core.errors import AssetError

if TYPE_CHECKING:
    import requests

ATTEMPTS = 3
"""How often a file is tried when the connection fails or breaks off."""

PAUSE = 0.5
"""Seconds before the second attempt; twice that before the third."""

CONNECT_TIMEOUT, READ_TIMEOUT = 10.0, 30.0
"""Seconds to wait for a connection, and for the next bytes of an answer."""

LARGEST = 512 * 2**20
"""Most bytes of a file whose size the manifest does not know."""

CHUNK = 2**16
"""Bytes that are read at a time."""

AGAIN = (408, 425, 429)
"""Answers below 500 that may be others the next time."""

READABLE = 0o644
"""Mode of a file in the cache: the temporary files that it was belong to their owner alone."""

_SYSTEM = re.compile(r"\[Errno -?\d+\] ([^'\")\]]+)")


def download(
    source: str | Path,
    path: Path,
    sha256: str,
    *,
    what: str,
    size: int | None = None,
    tell: Callable[[int], None] = lambda done: None,
    pause: float = PAUSE,
) -> None:
    """Put the file at `source` to `path`, replacing what is there; nothing is left when that fails.

    Args:
        source: Address, http:// or https://, or path of a file.
        path: Where the file will lie; its folder is made.
        sha256: What its hash has to be.
        what: How the file is called in messages.
        size: Its bytes, where known; it is cut off once it has more.
        tell: Hears how many bytes have arrived.
        pause: Seconds before the second attempt.

    Raises:
        AssetError: the source is missing or unreachable, or gives another file; says what to do.
    """
    from pooch import get_logger, retrieve

    get_logger().setLevel("WARNING")  # it would print a line for each file
    most = LARGEST if size is None else size
    fetch = _Copy(source, what, most, tell) if isinstance(source, Path) else _Http(what, most, tell)
    for attempt in range(ATTEMPTS):
        try:
            retrieve(str(source), f"sha256:{sha256}", path.name, path.parent, downloader=fetch)
            return
        except OSError as error:
            if isinstance(source, Path) or not _is_answer(error):
                raise AssetError(f"{path}: cannot be written ({error.strerror or error})") from error
            if attempt == ATTEMPTS - 1 or not _may_pass(error):
                raise AssetError(f"{what}: {_failure(str(source), error)}") from error
        except ValueError as error:
            # Of a file that is near, another attempt would give the same.
            if attempt == ATTEMPTS - 1 or isinstance(source, Path):
                raise AssetError(
                    f"{what}: {shown(source)} is not the file that the manifest means, its sha256 is not {sha256}; "
                    "nothing was kept"
                ) from error
        time.sleep(pause * (attempt + 1))


class _Count:
    """A progress bar as pooch wants one, which stops a file that has more bytes than it may."""

    def __init__(self, what: str, most: int, tell: Callable[[int], None]) -> None:
        self.what, self.most, self.tell = what, most, tell
        self.total = self.done = 0

    def update(self, count: int) -> None:
        """Count bytes; the last ones are rounded up to a chunk."""
        self.done += count
        if max(self.total, self.done - CHUNK + 1) > self.most:
            raise AssetError(f"{self.what}: has more than the {self.most} bytes it may have; nothing was kept")
        self.tell(min(self.done, self.most))

    def reset(self) -> None:
        """Start again."""
        self.done = 0

    def close(self) -> None:
        """Nothing is open."""


class _Http:
    """A downloader for pooch over http and https; redirects to anything else are refused by requests."""

    def __init__(self, what: str, most: int, tell: Callable[[int], None]) -> None:
        self.limits = what, most, tell

    def __call__(self, url: str, output_file: str, pooch: Any) -> None:
        from pooch import HTTPDownloader

        fetch = HTTPDownloader(
            progressbar=_Count(*self.limits),
            chunk_size=CHUNK,
            timeout=(CONNECT_TIMEOUT, READ_TIMEOUT),
            headers={"Accept-Encoding": "identity"},
        )
        fetch(url, output_file, pooch)
        os.chmod(output_file, READABLE)


class _Copy:
    """A downloader for pooch from a folder."""

    def __init__(self, source: Path, what: str, most: int, tell: Callable[[int], None]) -> None:
        self.source, self.what = source, what
        self.count = _Count(what, most, tell)

    def __call__(self, url: str, output_file: str, pooch: Any) -> None:
        try:
            if not self.source.is_file():
                raise FileNotFoundError(2, "no such file")
            there = self.source.open("rb")
        except OSError as error:
            raise AssetError(f"{self.what}: {self.source} cannot be read ({error.strerror})") from None
        with there, open(output_file, "wb") as here:
            while chunk := there.read(CHUNK):
                here.write(chunk)
                self.count.update(len(chunk))
        os.chmod(output_file, READABLE)


def _is_answer(error: OSError) -> TypeGuard[requests.RequestException]:
    """Whether an error is one of the connection, not one of this machine's files."""
    from requests import RequestException

    return isinstance(error, RequestException)


def _may_pass(error: requests.RequestException) -> bool:
    """Whether another attempt may go better."""
    from requests import exceptions

    if isinstance(error, exceptions.HTTPError) and error.response is not None:
        return error.response.status_code >= 500 or error.response.status_code in AGAIN
    return isinstance(error, exceptions.ConnectionError | exceptions.Timeout | exceptions.ChunkedEncodingError)


def _failure(url: str, error: requests.RequestException) -> str:
    """What went wrong and what to do, for people."""
    from requests import exceptions

    address = shown(url)
    host = urlsplit(address).netloc
    if isinstance(error, exceptions.HTTPError) and error.response is not None:
        said = f"{host} answered {error.response.status_code} {error.response.reason or ''}".rstrip()
        return f"{said} for {address}; nothing was kept; try again later, {HOW_TO_MIRROR}"
    if isinstance(error, exceptions.InvalidSchema | exceptions.InvalidURL | exceptions.TooManyRedirects):
        return f"{address} leads to where nothing is fetched from, only http and https are; nothing was kept"
    tried = f"tried {ATTEMPTS} times"
    if isinstance(error, exceptions.ChunkedEncodingError):
        return f"the connection to {host} broke off ({tried}); files that were whole are kept, fetch again for the rest"
    reason = _SYSTEM.search(str(error))
    why = "no answer in time" if isinstance(error, exceptions.Timeout) else reason[1] if reason else "no connection"
    return f"{host} cannot be reached ({why}; {tried}); check the connection, {HOW_TO_MIRROR}"
