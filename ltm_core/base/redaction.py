"""Keep secrets out of text and files: remove passwords and control characters for display, reject URLs with secrets."""

import ipaddress
import re
from collections.abc import Sequence
from typing import Any
from urllib.parse import parse_qsl, urlsplit

SECRET_KEYS = ("password", "passwd", "pass", "pwd", "token", "secret", "api_key", "apikey", "auth", "loginpas")
"""Names of parameters that hold a password in URLs and files; case is ignored."""
HIDDEN = "***"

_USER_INFO = re.compile(r"(?<=://)[^/\s'\"<>]*@")
_PARAMETER = re.compile(rf"(?i)\b({'|'.join(SECRET_KEYS)})(\s*[=:]\s*)(?!\{{)[^\s&'\",;)\]}}]+")


def redacted(text: str) -> str:
    """Return `text` without the user part of URLs and without the values of password-like parameters."""
    return _PARAMETER.sub(rf"\1\2{HIDDEN}", _USER_INFO.sub(f"{HIDDEN}@", text))


def shown(value: Any, keys: Sequence[int | str] = (), length: int = 80) -> str:
    """Return an invalid value of a configuration as an error may show it; `keys` is its place in the file."""
    if any(_secret(key) for key in keys):
        return HIDDEN
    return redacted(f"{_masked(value)!r:.{length}}")


def _secret(key: object) -> bool:
    return isinstance(key, str) and key.lower() in SECRET_KEYS


def _masked(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: HIDDEN if _secret(key) else _masked(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_masked(item) for item in value]
    if not isinstance(value, str):
        return value
    # Whole, for what is cut off afterwards could end before the sign by which a user part is known; and to the last
    # such sign, because an unquoted password may contain it.
    scheme, found, rest = value.partition("://")
    if found and "@" in rest:
        value = f"{scheme}://{HIDDEN}@{rest.rpartition('@')[2]}"
    return redacted(value)


def plain(text: str, most: int = 1000) -> str:
    """Return at most `most` characters of `text` without control characters."""
    return "".join(letter if letter.isprintable() else "?" for letter in text[:most])


def url_without_secrets(url: str, schemes: tuple[str, ...]) -> str:
    """Return a URL of one of the schemes unchanged. Raises ValueError for another one, and if it contains a secret."""
    parts = urlsplit(url)
    if parts.scheme not in schemes or not parts.hostname:
        raise ValueError(f"expected a URL that begins with {' or '.join(f'{scheme}://' for scheme in schemes)}")
    if "@" in parts.netloc:
        raise ValueError(
            "a URL in a site file must not contain user and password: write them as `user: NAME` and "
            "`password: {environment: NAME}` (or file, credential)"
        )
    if parts.port == 0 or re.search(r"[\s\\]", parts.netloc):  # a port above 65535 raises ValueError here
        raise ValueError("expected a host name or address, and a port of 1 to 65535 if any")
    for name, value in parse_qsl(parts.query, keep_blank_values=True):
        if name.lower() in SECRET_KEYS and value != "{password}":
            raise ValueError(
                f"the URL's parameter {name} holds a secret: write {name}={{password}} there, and "
                "`password: {environment: NAME}` (or file, credential) beside it"
            )
    return url


def is_loopback(host: str) -> bool:
    """Return whether a host name or address is that of this computer."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
