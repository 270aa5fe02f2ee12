"""What can be wrong with a camera. No message holds a secret, nor what another library said without redaction."""

from __future__ import annotations

from ltm_core.base.errors import LtmError


class SourceError(LtmError):
    """A camera did not give what it was asked for; it is asked again, after a while."""


class UnauthorisedError(SourceError):
    """A camera refuses the user or the password: to ask again soon would lock the account."""


class StuckPtzError(SourceError):
    """A PTZ head was sent elsewhere and does not go there."""


class PictureError(SourceError):
    """What a camera gave is no picture that can be used; the connection is well."""
