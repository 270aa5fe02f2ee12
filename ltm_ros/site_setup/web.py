"""Query the web services of data sources, and download files: retries, resume, cache, checksums and limits."""

import errno
import fcntl
import hashlib
import json
import logging
import os
import re
import shutil
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from itertools import count
from pathlib import Path
from typing import Any, TypeVar

import httpx

from ltm_core.base.redaction import plain, redacted
from ltm_core.storage.disk_io import free_bytes
from ltm_ros.runtime.retry import Backoff
from ltm_ros.site_setup.request import FetchError, NoCoverageError, Progress, Remote

TRIES = 5
"""Number of attempts at each request."""
LONGEST_WAIT_S = 60.0
"""Maximum pause that a service may demand (Retry-After)."""
_ANSWER_BYTES = 32 << 20
"""Maximum size of an answer that is read into memory."""
MOST_BYTES = 8 << 30
"""Maximum size of a download."""
SPARE_BYTES = 64 << 20
"""Free space that stays on the disk."""
_LATER = (408, 425, 429, 500, 502, 503, 504)
"""Statuses after which the same request may succeed."""
_FULL = (errno.ENOSPC, errno.EDQUOT)

T = TypeVar("T")

for _name in ("httpx", "httpcore"):
    logging.getLogger(_name).setLevel(logging.WARNING)  # their messages contain whole URLs, with keys


class AgainError(Exception):
    """An attempt failed in a way that may pass."""

    def __init__(self, why: str, wait_s: float = 0.0) -> None:
        super().__init__(why)
        self.wait_s = wait_s


def digest(*parts: object) -> str:
    """Return a short name for a request."""
    return hashlib.sha256("\n".join(map(str, parts)).encode()).hexdigest()[:24]


def check_room(folder: Path, needed: int) -> None:
    """Raise FetchError unless the disk of `folder` has room for `needed` bytes."""
    free = free_bytes(folder)
    if free < needed + SPARE_BYTES:
        raise FetchError(
            f"{folder}: {needed / 1e6:.0f} MB are needed and {free / 1e6:.0f} MB are free; make room, or keep the "
            "cache elsewhere (XDG_CACHE_HOME)"
        )


@contextmanager
def only_writer(path: Path) -> Iterator[Any]:
    """Open a file of the cache for appending, and keep other processes from it. Raises FetchError."""
    with path.open("ab") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise FetchError(f"{path}: another process is fetching this file; wait until it ends") from error
        try:
            yield file
        except OSError as error:
            if error.errno in _FULL:
                with suppress(OSError):
                    file.truncate(0)
            raise FetchError(f"{path}: cannot be written ({error.strerror}); make room on the disk") from error


class Web:
    """HTTP client of the sources. Proxies are those of the environment (HTTPS_PROXY, NO_PROXY).

    `cache`: folder for downloads; a second or an interrupted run fetches only the rest. `first_pause_s`: after the
    first failed attempt; it doubles with each further one.
    `timeout_s`: for a connection, and for each part of an answer."""

    def __init__(self, cache: Path | None = None, first_pause_s: float = 1.0, timeout_s: float = 90.0) -> None:
        usual = Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser() / "ltm/sites"
        self.cache = usual if cache is None else cache
        self._first_pause_s = first_pause_s
        limits = httpx.Timeout(timeout_s, connect=min(20.0, timeout_s))
        headers = {"User-Agent": "ltm-init", "Accept-Encoding": "identity"}
        try:
            self._client = httpx.Client(follow_redirects=True, timeout=limits, headers=headers)
        except (ValueError, ImportError, httpx.InvalidURL) as error:
            raise FetchError(f"the proxy in HTTPS_PROXY or ALL_PROXY cannot be used ({error}); correct it") from error

    def tried(self, url: str, attempt: Callable[[], T]) -> T:
        """Return what `attempt` returns; repeat it, with growing pauses, after an AgainError. Raises FetchError."""
        place, backoff = _host(url), Backoff(self._first_pause_s, LONGEST_WAIT_S)
        for tries in count(1):
            try:
                return attempt()
            except AgainError as error:
                if tries >= TRIES:
                    later = "try again later, or choose another source"
                    raise FetchError(f"{place}: {error} ({tries} attempts); {later}") from error
                time.sleep(max(backoff.failed(), min(error.wait_s, LONGEST_WAIT_S)))
        raise AssertionError  # not reached

    def get(self, url: str, params: Mapping[str, str] | None = None) -> bytes:
        """Return the body of an answer. Raises NoCoverageError (404, 204), FetchError."""

        def attempt() -> bytes:
            body = bytearray()
            with self._answer(url, params) as response:
                for chunk in response.iter_bytes():
                    body += chunk
                    if len(body) > _ANSWER_BYTES:
                        raise FetchError(f"{_host(url)}: more than {_ANSWER_BYTES} bytes; request a smaller area")
            return bytes(body)

        return self.tried(url, attempt)

    def json(self, url: str, params: Mapping[str, str] | None = None) -> Any:
        """Return the value of a JSON answer. Raises as `get` does."""
        body = self.get(url, params)
        try:
            return json.loads(body)
        except ValueError as error:
            raise FetchError(f"{_host(url)}: the answer is not JSON ({in_words(body)}); try again later") from error

    def remote(self, url: str) -> Remote | None:
        """Return size and version of a file; None if it does not exist. Its first byte is read, as some servers do not
        answer HEAD. Raises FetchError."""

        def attempt() -> Remote:
            with self._answer(url, headers={"Range": "bytes=0-0"}) as response:
                total = re.fullmatch(r"bytes 0-0/(\d+)", response.headers.get("Content-Range", ""))
                size = int(total[1]) if total else int(response.headers.get("Content-Length") or 0)
                return Remote(url, size, _version(response), total is not None)

        try:
            return self.tried(url, attempt)
        except NoCoverageError:
            return None

    def piece(self, remote: Remote, first: int, length: int) -> bytes:
        """Return bytes of a remote file. Raises FetchError."""
        last = min(first + length, remote.size) - 1

        def attempt() -> bytes:
            with self._answer(remote.url, headers={"Range": f"bytes={first}-{last}"}) as response:
                if response.status_code != 206:
                    raise AgainError("the server delivered the whole file instead of a part")
                if _version(response) != remote.version:
                    raise FetchError(f"{redacted(remote.url)}: changed on the server meanwhile; run the command again")
                body = b"".join(response.iter_bytes())
                if len(body) != last + 1 - first:
                    raise AgainError(f"delivered {len(body)} of {last + 1 - first} bytes")
                return body

        return self.tried(remote.url, attempt)

    def download(
        self,
        url: str,
        progress: Progress,
        params: Mapping[str, str] | None = None,
        *,
        remote: Remote | None = None,
        sha256: str = "",
        most: int = MOST_BYTES,
    ) -> Path:
        """Return the file of a URL in the cache, fetched whole. A download of a known `remote` continues where it
        stopped. Raises NoCoverageError, FetchError; a file with a wrong checksum is removed."""
        path = self.cache / digest(url, sorted((params or {}).items()), remote and remote.version, sha256)
        if path.exists():
            return path
        partial = path.with_suffix(".part")
        self.make_cache()

        def attempt() -> None:
            with only_writer(partial) as file:
                have = file.tell()
                if remote is None or not (remote.ranges and remote.version) or have > remote.size:
                    have = 0
                elif have == remote.size:
                    return
                headers = {"Range": f"bytes={have}-", "If-Range": remote.version} if have and remote else {}
                with self._answer(url, params, headers) as response:
                    have = have if response.status_code == 206 else 0
                    file.truncate(have)
                    total = have + int(response.headers.get("Content-Length") or 0)
                    check_room(partial.parent, total - have)
                    for chunk in response.iter_bytes():
                        file.write(chunk)
                        have += len(chunk)
                        if have > most:
                            raise FetchError(f"{response.url.host}: more than {most} bytes; request a smaller area")
                        progress(have, total)
                    file.flush()
                if remote is not None and have != remote.size:
                    raise AgainError(f"delivered {have} of {remote.size} bytes")

        self.tried(url, attempt)
        with partial.open("rb") as file:
            found = hashlib.file_digest(file, "sha256").hexdigest() if sha256 else ""
        if found != sha256:
            partial.unlink()
            raise FetchError(f"{redacted(url)}: SHA-256 is {found}, expected {sha256}; check the address and the sum")
        partial.replace(path)
        return path

    def make_cache(self) -> None:
        """Make the folder of the cache. Raises FetchError."""
        try:
            self.cache.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise FetchError(
                f"{self.cache}: cannot be made ({error.strerror}); keep the cache elsewhere (XDG_CACHE_HOME)"
            ) from error

    @contextmanager
    def _answer(
        self, url: str, params: Mapping[str, str] | None = None, headers: Mapping[str, str] | None = None
    ) -> Iterator[httpx.Response]:
        """Open a GET request. Raises as `_check_status` does, AgainError if there is no answer, FetchError."""
        whole = httpx.URL(url).copy_merge_params(params) if params else httpx.URL(url)
        try:
            with self._client.stream("GET", whole, headers=headers) as response:
                _check_status(response)
                yield response
        except httpx.TimeoutException as error:
            raise AgainError("no answer in time") from error
        except httpx.HTTPError as error:
            broke = "no connection" if isinstance(error, httpx.ConnectError) else "the connection broke"
            raise AgainError(f"{broke} ({redacted(str(error))})") from error


def _check_status(response: httpx.Response) -> None:
    status, host = response.status_code, response.url.host
    if response.is_success and status != 204:
        return
    said = ""
    with suppress(httpx.HTTPError):
        said = in_words(next(response.iter_bytes(2000), b""))
    reason = f"HTTP {status}" + (f": {said}" if said else "")
    if status in _LATER:
        wait = response.headers.get("Retry-After", "")
        raise AgainError(reason, float(wait) if wait.isdecimal() else 0.0)
    if status in (204, 404):
        raise NoCoverageError(f"{host} has no data for this request ({reason}); choose another source or area")
    if status in (401, 403):
        raise FetchError(f"{host} rejected the request ({reason}); check the key in the environment, or the proxy")
    raise FetchError(f"{host} rejected the request ({reason}); change the area or the source")


def _version(response: httpx.Response) -> str:
    return response.headers.get("ETag") or response.headers.get("Last-Modified") or ""


def in_words(body: bytes) -> str:
    """Return the text of an error page on one line."""
    text = re.sub(r"<[^>]*>", " ", body[:2000].decode("utf-8", "replace"))
    return redacted(plain(" ".join(text.split()), 300))


def _host(url: str) -> str:
    try:
        return httpx.URL(url).host or redacted(url)
    except (httpx.InvalidURL, UnicodeError) as error:
        raise FetchError(f"{redacted(url)}: not a valid URL ({error}); correct the address of the source") from error


def put_into(folder: Path, cached: Path, name: str) -> Path:
    """Return a copy of a cached file in `folder`; a hard link where the disk allows it. Raises FetchError."""
    path = folder / name
    try:
        folder.mkdir(parents=True, exist_ok=True)
        path.unlink(missing_ok=True)
        try:
            os.link(cached, path)
        except OSError:
            shutil.copyfile(cached, path)
    except OSError as error:
        path.unlink(missing_ok=True)
        raise FetchError(f"{path}: cannot be written ({error.strerror}); make room, or name another folder") from error
    return path
