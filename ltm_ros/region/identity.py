"""Hold the identity of one side of the link: its certificate, and the authorities that it trusts."""

import ssl
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path
from typing import Final

from cryptography import x509
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID

from ltm_core.base.errors import ConfigError, MessageError
from ltm_core.uplink.config import BrokerConfig
from ltm_core.uplink.envelope import Envelope, packed, unpacked
from ltm_ros.runtime.ros_environment import secret

_REMEMBERED: Final = 256
"""Maximum number of certificates whose checked chain is cached."""
_HASH: Final = ec.ECDSA(hashes.SHA256())


class Identity:
    """Signs envelopes, and checks those of others. `name`: the common name of its certificate. Raises ConfigError for
    invalid files."""

    def __init__(self, config: BrokerConfig, name: str) -> None:
        self._config = config
        self._key_file = secret(config.key)
        certificates = _certificates(config.certificate)
        self._own = certificates[0].public_bytes(serialization.Encoding.DER)
        self._authorities = _certificates(config.ca)
        self._key = _key(self._key_file)
        if self._key.public_key() != certificates[0].public_key():
            raise ConfigError(f"{config.key} does not belong to {config.certificate}: give the matching key")
        if (found := common_name(certificates[0])) != name:
            raise ConfigError(
                f"{config.certificate} belongs to {found!r}, not to {name!r}: give the certificate of {name!r}"
            )
        self._issued = lru_cache(_REMEMBERED)(self._checked)

    def tls(self) -> ssl.SSLContext:
        """Return the TLS context for the broker: TLS 1.2 or newer, with certificates of both sides."""
        context = ssl.create_default_context(cafile=str(self._config.ca))
        context.minimum_version = ssl.TLSVersion.TLSv1_2
        try:
            context.load_cert_chain(self._config.certificate, self._key_file)
        except (ssl.SSLError, OSError) as error:
            raise ConfigError(f"{self._config.certificate}: cannot be used for TLS ({error})") from error
        return context

    def sealed(self, header: bytes, body: bytes = b"") -> bytes:
        """Return an envelope with our certificate and signature. Raises MessageError if it would be too large."""
        signed = packed(header, self._own, body)
        return signed + self._key.sign(signed, _HASH)

    def opened(self, content: bytes, name: str) -> Envelope:
        """Return the content of an envelope signed by `name`. Raises MessageError for any other."""
        envelope = unpacked(content)
        certificate, key = self._issued(envelope.certificate)
        begin, end = certificate.not_valid_before_utc, certificate.not_valid_after_utc
        signer = common_name(certificate)
        if not begin <= datetime.now(UTC) <= end:
            raise MessageError(
                f"the certificate of {signer!r} is valid from {begin} to {end}: renew it, or set the clock"
            )
        if signer != name:
            raise MessageError(f"an envelope of {name!r} is signed by {signer!r}")
        try:
            key.verify(envelope.signature, envelope.signed, _HASH)
        except InvalidSignature as error:
            raise MessageError(f"an envelope of {name!r} was modified after signing") from error
        return envelope

    def _checked(self, content: bytes) -> tuple[x509.Certificate, ec.EllipticCurvePublicKey]:
        """Return a certificate that one of our authorities has signed, and its key. Raises MessageError."""
        try:
            certificate = x509.load_der_x509_certificate(content)
            name, key = common_name(certificate), certificate.public_key()
            # Reading the period shows whether it can be read.
            _ = certificate.not_valid_before_utc, certificate.not_valid_after_utc
        except (ValueError, TypeError, x509.InvalidVersion, UnsupportedAlgorithm) as error:
            raise MessageError(f"an envelope's certificate cannot be read ({error})") from error
        if not any(_issued_by(certificate, authority) for authority in self._authorities):
            raise MessageError(f"an envelope's certificate, of {name!r}, is not from an authority in {self._config.ca}")
        if not isinstance(key, ec.EllipticCurvePublicKey):
            raise MessageError(f"the certificate of {name!r} has no elliptic curve key: make one with `ltm certs`")
        return certificate, key


def _issued_by(certificate: x509.Certificate, authority: x509.Certificate) -> bool:
    try:
        certificate.verify_directly_issued_by(authority)
    except (ValueError, TypeError, InvalidSignature, UnsupportedAlgorithm):
        return False
    return True


def common_name(certificate: x509.Certificate) -> str:
    """Return the common name; empty if there is none."""
    names = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    return str(names[0].value) if names else ""


def _certificates(path: Path) -> list[x509.Certificate]:
    try:
        return x509.load_pem_x509_certificates(path.read_bytes())
    except (OSError, ValueError) as error:
        why = error.strerror if isinstance(error, OSError) else "no certificate in PEM"
        raise ConfigError(f"{path}: cannot be read ({why}); for a trial, make one with `ltm certs`") from error


def _key(path: Path) -> ec.EllipticCurvePrivateKey:
    """Read the key. No error message contains the file's content."""
    try:
        key = serialization.load_pem_private_key(path.read_bytes(), password=None)
    except OSError as error:
        raise ConfigError(f"{path}: the key cannot be read ({error.strerror})") from error
    except (ValueError, TypeError):
        raise ConfigError(f"{path}: not a private key in PEM without a password") from None
    if not isinstance(key, ec.EllipticCurvePrivateKey):
        raise ConfigError(f"{path}: the key must be on an elliptic curve, such as P-256; `ltm certs` makes one")
    return key
