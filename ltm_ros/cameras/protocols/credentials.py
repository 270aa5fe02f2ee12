"""Read the passwords of cameras, and define the errors that cameras cause."""

import base64
import os
from urllib.parse import quote, quote_plus

from pydantic import SecretStr

from ltm_core.base.errors import LtmError
from ltm_core.base.redaction import HIDDEN, redacted
from ltm_core.site.source_config import NetworkSettings, SecretConfig
from ltm_ros.runtime.ros_environment import FOLDER_VARIABLE, service_credential


class SourceError(LtmError):
    """A camera did not answer a request as expected; the request is repeated later."""


class UnauthorisedError(SourceError):
    """A camera rejected the user or password; early retries would lock the account."""


class PictureError(SourceError):
    """An image is not usable; the connection works."""


LONGEST = 4096


def read_secret(config: SecretConfig) -> SecretStr:
    """Read the password again for each connection, so that a change needs no restart. Raises UnauthorisedError that
    names the place."""
    if config.environment is not None:
        if value := os.environ.get(config.environment):
            return SecretStr(value)
        raise UnauthorisedError(f"{config.place} is not set: set it for the service that runs `ltm run`")
    path = config.file or service_credential(config.credential or "")
    if path is None:
        raise UnauthorisedError(
            f"{config.place} was not passed to this process ({FOLDER_VARIABLE}): put the file into "
            "/etc/ltm/credentials and restart the service, or add a LoadCredential="
        )
    try:
        with path.open(encoding="utf-8") as file:
            value = file.read(LONGEST).rstrip("\r\n")
    except (OSError, UnicodeDecodeError) as error:
        why = error.strerror if isinstance(error, OSError) else "it is not text"
        raise UnauthorisedError(f"{config.place} cannot be read ({why}): store the password there") from None
    if not value:
        raise UnauthorisedError(f"{config.place} is empty: store the password there")
    return SecretStr(value)


class Login:
    """A camera's user and password, and texts without them."""

    def __init__(self, user: str | None, password: SecretStr | None) -> None:
        self.user, self._password = user, password
        word = self.secret
        basic = base64.b64encode(f"{user or ''}:{word}".encode()).decode()
        spellings = {word, quote(word, safe=""), quote(word), quote_plus(word), repr(word)[1:-1], basic} if word else ()
        self._hidden = sorted(spellings, key=len, reverse=True)
        """The password as URLs, headers and reprs have it, the longest first."""

    @property
    def secret(self) -> str:
        """Return the password itself; empty: none."""
        return "" if self._password is None else self._password.get_secret_value()

    @classmethod
    def of(cls, settings: NetworkSettings) -> "Login":
        """Return the login. Raises UnauthorisedError if the password cannot be read."""
        return cls(settings.user, None if settings.password is None else read_secret(settings.password))

    def rejected(self, how: str) -> UnauthorisedError:
        """Return the error of a rejected login; `how`: the camera's answer."""
        if not self.user:
            return UnauthorisedError(f"the camera requires a login ({how}): set user and password")
        return UnauthorisedError(f"the camera rejected user {self.user} ({how}). Check the user name and password")

    def filled(self, url: str) -> str:
        """Return `url` with user and password inserted; the result is secret."""
        return url.replace("{user}", quote(self.user or "", safe="")).replace("{password}", quote(self.secret, safe=""))

    def redact(self, text: object) -> str:
        """Return a message of another library without the password in any encoding, and without similar secrets."""
        said = str(text)
        for spelling in self._hidden:
            said = said.replace(spelling, HIDDEN)
        return redacted(said)
