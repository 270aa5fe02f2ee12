"""Accept HTTP as cameras speak it: invalid header lines, and every scheme of digest authentication.

Sources: RFC 9112 (messages), RFC 9110 11.6 (challenges), RFC 7616 and 2617 (digest).

Own code, because httpx rejects an answer with one invalid line, and knows neither `auth-int`, SHA-512-256, an empty
algorithm nor two challenges in one line."""

import hashlib
import math
import re
import secrets
import ssl
import time
from base64 import b64encode
from collections.abc import Callable, Generator, Iterable
from dataclasses import dataclass
from typing import Any

import httpcore
import httpx

from ltm_ros.cameras.protocols.credentials import UnauthorisedError

_MOST_HEAD = 64 << 10
_HEAD_END = re.compile(rb"\r?\n\r?\n")
_NAME = re.compile(rb"[!#$%&'*+.^_`|~0-9A-Za-z-]+")
_CONTROL = re.compile(rb"[\x00-\x08\x0a-\x1f\x7f]")


def tolerated(head: bytes) -> bytes:
    """Return the head of an answer without its invalid lines, which end in an error elsewhere."""
    status, *lines = re.split(rb"\r?\n", head)
    kept: list[bytes] = [status]
    for line in re.sub(rb"\n[ \t]+", b" ", b"\n".join(lines)).split(b"\n"):
        name, colon, value = line.partition(b":")
        name, value = name.strip(), _CONTROL.sub(b"", value).strip()
        invalid = {
            b"content-length": not value.isdigit(),
            b"transfer-encoding": value.lower() != b"chunked",
        }.get(name.lower(), False)
        if colon and _NAME.fullmatch(name) and not invalid:
            kept.append(name + b": " + value)
    return b"\r\n".join(kept) + b"\r\n\r\n"


class _Stream(httpcore.NetworkStream):
    """A connection that changes the head of each answer by `tolerated`."""

    def __init__(self, stream: httpcore.NetworkStream, left: Callable[[float | None], float | None]) -> None:
        self._stream, self._left = stream, left
        self._head_follows = False

    def read(self, max_bytes: int, timeout: float | None = None) -> bytes:
        data = self._stream.read(max_bytes, self._left(timeout))
        if not self._head_follows:
            return data
        self._head_follows = False
        while data[:5] == b"HTTP/"[: len(data)] and len(data) < _MOST_HEAD:
            if (end := _HEAD_END.search(data)) is not None:
                return tolerated(data[: end.start()]) + data[end.end() :]
            if not (part := self._stream.read(max_bytes, self._left(timeout))):
                break
            data += part
        return data

    def write(self, buffer: bytes, timeout: float | None = None) -> None:
        self._head_follows = True
        self._stream.write(buffer, self._left(timeout))

    def close(self) -> None:
        self._stream.close()

    def start_tls(
        self, ssl_context: ssl.SSLContext, server_hostname: str | None = None, timeout: float | None = None
    ) -> httpcore.NetworkStream:
        stream = self._stream.start_tls(ssl_context, server_hostname, self._left(timeout))
        return _Stream(stream, self._left)

    def get_extra_info(self, info: str) -> Any:
        return self._stream.get_extra_info(info)


class CameraNetwork(httpcore.SyncBackend):
    """`until`: time of a monotonic clock at which every operation ends. A limit for each part is not enough: an answer
    that comes letter by letter would hold up its thread, and the watchdog would end the process of all cameras."""

    until = math.inf

    def left(self, timeout: float | None) -> float | None:
        """Return the seconds for one operation. Raises httpcore's ReadTimeout after the deadline."""
        seconds = min(math.inf if timeout is None else timeout, self.until - time.monotonic())
        if seconds <= 0:
            raise httpcore.ReadTimeout("the deadline has passed")
        return None if seconds == math.inf else seconds

    def connect_tcp(self, *given: Any, **named: Any) -> httpcore.NetworkStream:
        named["timeout"] = self.left(named.get("timeout"))
        return _Stream(super().connect_tcp(*given, **named), self.left)


class CameraTransport(httpx.HTTPTransport):
    """Args: keep_s: seconds for which a connection is kept."""

    def __init__(self, context: ssl.SSLContext, keep_s: float, network: CameraNetwork) -> None:
        # Instead of the base's, which has no parameter for the network.
        self._pool = httpcore.ConnectionPool(
            ssl_context=context, max_connections=2, keepalive_expiry=keep_s, network_backend=network
        )


@dataclass(frozen=True)
class Challenge:
    """A scheme of authentication that a camera offers. Names are in lower case."""

    scheme: str
    values: dict[str, str]

    @property
    def strength(self) -> int:
        """Return the rank of the scheme; 0: not supported."""
        if self.scheme == "basic":
            return 1
        qop = self.qops
        known = self.scheme == "digest" and "nonce" in self.values and (not qop or "auth" in qop or "auth-int" in qop)
        return 2 + list(_HASHES).index(self.hash_name) if known and self.hash_name in _HASHES else 0

    @property
    def hash_name(self) -> str:
        return self.values.get("algorithm", "").upper().removesuffix("-SESS") or "MD5"

    @property
    def qops(self) -> list[str]:
        return [word for word in re.split(r"[\s,]+", self.values.get("qop", "").lower()) if word]

    def __str__(self) -> str:
        return f"{self.scheme} {self.values.get('algorithm', '')}".rstrip() if self.scheme == "digest" else self.scheme


_HASHES = {"MD5": "md5", "SHA": "sha1", "SHA-512-256": "sha512_256", "SHA-512": "sha512", "SHA-256": "sha256"}
"""Names in `hashlib` by name in a challenge, the preferred one last."""
_PART = re.compile(r'([^\s=,"]+)(\s*=\s*(?:"((?:[^"\\]|\\.)*)"|([^\s,]*)))?')


def challenges(lines: Iterable[str]) -> list[Challenge]:
    """Return the challenges in the lines of WWW-Authenticate, each with one or several."""
    found: list[Challenge] = []
    for line in lines:
        for name, value, quoted, bare in _PART.findall(line):
            if not value:
                found.append(Challenge(name.lower(), {}))
            elif found:
                found[-1].values.setdefault(name.lower(), re.sub(r"\\(.)", r"\1", quoted) or bare)
    return found


class CameraAuth(httpx.Auth):
    """Answers the strongest challenge that the camera offers and `schemes` names. No password goes out before one,
    unless `schemes` is `basic` alone."""

    requires_request_body = True

    def __init__(self, user: str, password: str, schemes: tuple[str, ...] = ("digest", "basic")) -> None:
        self._user, self._password, self._schemes = user, password, schemes
        self._offer = Challenge("basic", {}) if schemes == ("basic",) else None
        self._count = 0

    def auth_flow(self, request: httpx.Request) -> Generator[httpx.Request, httpx.Response, None]:
        answered = self._offer
        if answered is not None:
            request.headers["authorization"] = self._answer(request, answered)
        response = yield request
        if response.status_code != 401:
            return
        lines = response.headers.get_list("www-authenticate")
        # Some cameras answer 401 without a challenge, and want a password all the same.
        offers = challenges(lines) or [Challenge(self._schemes[-1], {})]
        offer = max(offers, key=lambda one: one.strength if one.scheme in self._schemes else 0)
        if offer.scheme not in self._schemes or not offer.strength:
            names, known = ", ".join(map(str, offers))[:200], " or ".join(self._schemes)
            raise UnauthorisedError(
                f"the camera rejected user {self._user}: it offers {names}, which is no supported form of {known}. "
                "Select digest or basic in the camera's settings, or set authentication: auto"
            )
        same = answered is not None and answered.values.get("nonce") == offer.values.get("nonce")
        if same and offer.values.get("stale", "").lower() != "true":
            return
        self._offer, self._count = offer, 0
        request.headers["authorization"] = self._answer(request, offer)
        yield request

    def _answer(self, request: httpx.Request, offer: Challenge) -> str:
        if offer.scheme == "basic":
            return f"Basic {b64encode(f'{self._user}:{self._password}'.encode()).decode()}"
        given, qops = offer.values, offer.qops

        def digest(data: str | bytes) -> str:
            data = data if isinstance(data, bytes) else data.encode()
            return hashlib.new(_HASHES[offer.hash_name], data, usedforsecurity=False).hexdigest()

        self._count += 1
        realm, nonce = given.get("realm", ""), given["nonce"]
        cnonce, count = secrets.token_hex(8), f"{self._count:08x}"
        uri = request.url.raw_path.decode("ascii")
        first, second = digest(f"{self._user}:{realm}:{self._password}"), f"{request.method}:{uri}"
        session = given.get("algorithm", "").upper().endswith("-SESS")
        if session:
            first = digest(f"{first}:{nonce}:{cnonce}")
        qop = "" if not qops else "auth" if "auth" in qops else "auth-int"
        if qop == "auth-int":
            second += f":{digest(request.content)}"
        middle = f"{nonce}:{count}:{cnonce}:{qop}" if qop else nonce
        parts = {"username": self._user, "realm": realm, "nonce": nonce, "uri": uri}
        parts["response"] = digest(f"{first}:{middle}:{digest(second)}")
        parts |= {"cnonce": cnonce} if qop or session else {}
        parts |= {"opaque": given["opaque"]} if "opaque" in given else {}
        words = ['{}="{}"'.format(name, re.sub(r'(["\\])', r"\\\1", value)) for name, value in parts.items()]
        words += [f"algorithm={given['algorithm']}"] if given.get("algorithm") else []
        words += [f"qop={qop}", f"nc={count}"] if qop else []
        return f"Digest {', '.join(words)}"
