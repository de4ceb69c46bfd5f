"""Download of one file, over http(s) or from a folder; its hash is checked before it appears under its name.

An interrupted download starts again: the part received has a temporary name, and is removed.
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

MAX_ATTEMPTS = 3
"""Most attempts at a file when the connection fails or breaks off."""

RETRY_PAUSE_S = 0.5
"""Seconds before the second attempt; twice that before the third."""

CONNECT_TIMEOUT_S, READ_TIMEOUT_S = 10.0, 30.0
"""Seconds to wait for a connection, and for the next bytes of a response."""

MAX_BYTES = 512 * 2**20
"""Most bytes of a file whose size is not in the manifest."""

CHUNK_BYTES = 2**16
"""Bytes that are read at a time."""

RETRY_STATUS_CODES = (408, 425, 429)
"""HTTP status codes below 500 that may change at the next attempt."""

FILE_MODE = 0o644
"""Mode of a file in the cache; temporary files are readable by their owner only."""

_ERRNO_TEXT = re.compile(r"\[Errno -?\d+\] ([^'\")\]]+)")


def download(
    source: str | Path,
    path: Path,
    sha256: str,
    *,
    what: str,
    size: int | None = None,
    on_bytes: Callable[[int], None] = lambda done: None,
    pause: float = RETRY_PAUSE_S,
) -> None:
    """Download `source` to `path`, replacing a file there; leaves nothing behind on failure.

    Args:
        source: Address, http:// or https://, or path of a file.
        path: Path of the downloaded file; its folder is made.
        sha256: Expected hash.
        what: Name of the file in messages.
        size: Number of bytes, where known; a larger file is refused.
        on_bytes: Called with the number of bytes received so far.
        pause: Seconds before the second attempt.

    Raises:
        AssetError: the source is missing or unreachable, or provides another file; names the remedy.
    """
    from pooch import get_logger, retrieve

    get_logger().setLevel("WARNING")  # it would print a line for each file
    max_bytes = MAX_BYTES if size is None else size
    fetch = _Copy(source, what, max_bytes, on_bytes) if isinstance(source, Path) else _Http(what, max_bytes, on_bytes)
    for attempt in range(MAX_ATTEMPTS):
        try:
            retrieve(str(source), f"sha256:{sha256}", path.name, path.parent, downloader=fetch)
            return
        except OSError as error:
            if isinstance(source, Path) or not _is_network_error(error):
                raise AssetError(f"{path}: cannot be written ({error.strerror or error})") from error
            if attempt == MAX_ATTEMPTS - 1 or not _is_transient(error):
                raise AssetError(f"{what}: {_describe_failure(str(source), error)}") from error
        except ValueError as error:
            # A local file would be the same at the next attempt.
            if attempt == MAX_ATTEMPTS - 1 or isinstance(source, Path):
                raise AssetError(
                    f"{what}: {shown(source)} is not the file in the manifest, its sha256 is not {sha256}; "
                    "nothing was kept"
                ) from error
        time.sleep(pause * (attempt + 1))


class _ByteCounter:
    """A progress bar for pooch that refuses files with too many bytes."""

    def __init__(self, what: str, max_bytes: int, on_bytes: Callable[[int], None]) -> None:
        self.what, self.max_bytes, self.on_bytes = what, max_bytes, on_bytes
        self.total = self.done = 0

    def update(self, count: int) -> None:
        """Count bytes; the last ones are rounded up to a chunk."""
        self.done += count
        if max(self.total, self.done - CHUNK_BYTES + 1) > self.max_bytes:
            raise AssetError(f"{self.what}: has more than the {self.max_bytes} bytes allowed; nothing was kept")
        self.on_bytes(min(self.done, self.max_bytes))

    def reset(self) -> None:
        """Restart the count."""
        self.done = 0

    def close(self) -> None:
        """Do nothing; pooch calls it."""


class _Http:
    """A downloader for pooch over http and https; requests refuses redirects to other schemes."""

    def __init__(self, what: str, max_bytes: int, on_bytes: Callable[[int], None]) -> None:
        self.limits = what, max_bytes, on_bytes

    def __call__(self, url: str, output_file: str, pooch: Any) -> None:
        from pooch import HTTPDownloader

        fetch = HTTPDownloader(
            progressbar=_ByteCounter(*self.limits),
            chunk_size=CHUNK_BYTES,
            timeout=(CONNECT_TIMEOUT_S, READ_TIMEOUT_S),
            headers={"Accept-Encoding": "identity"},
        )
        fetch(url, output_file, pooch)
        os.chmod(output_file, FILE_MODE)


class _Copy:
    """A downloader for pooch from a folder."""

    def __init__(self, source: Path, what: str, max_bytes: int, on_bytes: Callable[[int], None]) -> None:
        self.source, self.what = source, what
        self.count = _ByteCounter(what, max_bytes, on_bytes)

    def __call__(self, url: str, output_file: str, pooch: Any) -> None:
        try:
            if not self.source.is_file():
                raise FileNotFoundError(2, "no such file")
            source = self.source.open("rb")
        except OSError as error:
            raise AssetError(f"{self.what}: {self.source} cannot be read ({error.strerror})") from None
        with source, open(output_file, "wb") as output:
            while chunk := source.read(CHUNK_BYTES):
                output.write(chunk)
                self.count.update(len(chunk))
        os.chmod(output_file, FILE_MODE)


def _is_network_error(error: OSError) -> TypeGuard[requests.RequestException]:
    """Return whether an error is one of the network, not of the local file system."""
    from requests import RequestException

    return isinstance(error, RequestException)


def _is_transient(error: requests.RequestException) -> bool:
    """Return whether another attempt may succeed."""
    from requests import exceptions

    if isinstance(error, exceptions.HTTPError) and error.response is not None:
        return error.response.status_code >= 500 or error.response.status_code in RETRY_STATUS_CODES
    return isinstance(error, exceptions.ConnectionError | exceptions.Timeout | exceptions.ChunkedEncodingError)


def _describe_failure(url: str, error: requests.RequestException) -> str:
    """Describe a failed request and its remedy, for people."""
    from requests import exceptions

    address = shown(url)
    host = urlsplit(address).netloc
    if isinstance(error, exceptions.HTTPError) and error.response is not None:
        status = f"{host} answered {error.response.status_code} {error.response.reason or ''}".rstrip()
        return f"{status} for {address}; nothing was kept; try again later, {HOW_TO_MIRROR}"
    if isinstance(error, exceptions.InvalidSchema | exceptions.InvalidURL | exceptions.TooManyRedirects):
        return f"{address} leads to an address that cannot be fetched, only http and https can; nothing was kept"
    tried = f"tried {MAX_ATTEMPTS} times"
    if isinstance(error, exceptions.ChunkedEncodingError):
        return f"the connection to {host} broke off ({tried}); complete files are kept, fetch again for the rest"
    reason = _ERRNO_TEXT.search(str(error))
    why = "timed out" if isinstance(error, exceptions.Timeout) else reason[1] if reason else "no connection"
    return f"{host} cannot be reached ({why}; {tried}); check the connection, {HOW_TO_MIRROR}"
