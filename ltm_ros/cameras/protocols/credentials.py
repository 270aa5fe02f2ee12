"""Read the passwords of cameras, and define the errors that cameras cause."""

from __future__ import annotations

import base64
import os
from pathlib import Path
from urllib.parse import quote, quote_plus

from ltm_core.base.errors import LtmError
from ltm_core.base.redaction import HIDDEN, redacted
from ltm_core.site.source_config import NetworkSettings, SecretConfig
from ltm_ros.runtime.ros_environment import FOLDER_VARIABLE, service_credential


class SourceError(LtmError):
    """A camera did not give what it was asked for; it is asked again, after a while."""


class UnauthorisedError(SourceError):
    """A camera refuses the user or the password: to ask again soon would lock the account."""


class StuckPtzError(SourceError):
    """A PTZ head was sent elsewhere and does not go there."""


class PictureError(SourceError):
    """What a camera gave is no picture that can be used; the connection is well."""


LONGEST = 4096


class Secret:
    """A value that no print, format or log shows."""

    __slots__ = ("_value",)

    def __init__(self, value: str) -> None:
        self._value = value

    def reveal(self) -> str:
        return self._value

    def __repr__(self) -> str:
        return HIDDEN

    __str__ = __repr__


def read_secret(config: SecretConfig) -> Secret:
    """Read anew at each connection, so that a changed password needs no restart. Raises UnauthorisedError that names
    the place."""
    if config.environment is not None:
        value = os.environ.get(config.environment)
        if not value:
            raise UnauthorisedError(f"{config.place} is not set: set it for the service that runs `ltm run`")
        return Secret(value)
    path = _path(config)
    try:
        with path.open(encoding="utf-8") as file:
            value = file.read(LONGEST).rstrip("\r\n")
    except (OSError, UnicodeDecodeError) as error:
        why = error.strerror if isinstance(error, OSError) else "it is no text"
        raise UnauthorisedError(f"{config.place} cannot be read ({why}): put the password there") from None
    if not value:
        raise UnauthorisedError(f"{config.place} is empty: put the password there")
    return Secret(value)


def _path(config: SecretConfig) -> Path:
    if config.file is not None:
        return config.file
    found = service_credential(config.credential or "")
    if found is None:
        raise UnauthorisedError(
            f"{config.place} was not given to this process ({FOLDER_VARIABLE}): put the file into "
            f"/etc/ltm/credentials and restart the service, or name it in a LoadCredential= of its own"
        )
    return found


class Login:
    """A camera's user and password, and text without them."""

    def __init__(self, user: str | None, password: Secret | None) -> None:
        self.user, self.password = user, password
        self._hidden = _spellings(user or "", password.reveal()) if password is not None else ()

    @classmethod
    def of(cls, settings: NetworkSettings) -> Login:
        """Raises UnauthorisedError where the password cannot be read."""
        return cls(settings.user, None if settings.password is None else read_secret(settings.password))

    def filled(self, url: str) -> str:
        """`url` with the user and the password in their places: a secret from here on."""
        password = self.password.reveal() if self.password is not None else ""
        return url.replace("{user}", quote(self.user or "", safe="")).replace("{password}", quote(password, safe=""))

    def redact(self, text: object) -> str:
        """What another library said, without the password in any spelling, and without what looks like one."""
        said = str(text)
        for spelling in self._hidden:
            said = said.replace(spelling, HIDDEN)
        return redacted(said)


def _spellings(user: str, password: str) -> tuple[str, ...]:
    """The password as it stands in URLs, headers and reprs, the longest first."""
    basic = base64.b64encode(f"{user}:{password}".encode()).decode()
    found = {password, quote(password, safe=""), quote(password), quote_plus(password), repr(password)[1:-1], basic}
    return tuple(sorted(found, key=len, reverse=True))
