"""Make a small certificate authority for trials: certificates of a region's broker, map and towers.

It also writes the broker's configuration with the access rights."""

import getpass
import ipaddress
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Final

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from ltm_core.base.errors import ConfigError
from ltm_core.storage.disk_io import sync
from ltm_core.uplink.config import AGGREGATOR
from ltm_core.uplink.envelope import NAME
from ltm_ros.region.mqtt_link import LARGEST_PACKET, ROOT

AUTHORITY: Final = "ca"
BROKER: Final = "broker"
_RESERVED: Final = (AUTHORITY, BROKER, AGGREGATOR)
_Issuer = tuple[ec.EllipticCurvePrivateKey, x509.Certificate]
_BACKDATED: Final = timedelta(minutes=5)
"""Backdating of certificates, so that a clock slightly behind accepts a new one."""


@dataclass(frozen=True)
class TrialAuthority:
    """The authority in `folder`, created if missing; whoever has its key can impersonate any tower. `days`: validity of
    new certificates."""

    folder: Path
    days: int

    def make(self, region: str, clients: Sequence[str], hosts: Sequence[str], address: str, port: int) -> list[Path]:
        """Write missing files and keep existing ones; return the new files. `clients`: towers.
        `hosts`: names of the broker for clients. `address`, `port`: where it listens. Raises ConfigError."""
        for name in (region, *clients):
            if not re.fullmatch(NAME, name) or name in _RESERVED:
                raise ConfigError(
                    f"{name!r}: a name consists of a-z, 0-9 and _, begins with a letter, and is none of "
                    f"{', '.join(_RESERVED)}"
                )
        new: list[Path] = []
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            names = [n for n in (BROKER, AGGREGATOR, *clients) if not (self.folder / f"{n}.crt").exists()]
            authority = self._authority(new) if names else None
            for name in names:
                server = name == BROKER
                usage = ExtendedKeyUsageOID.SERVER_AUTH if server else ExtendedKeyUsageOID.CLIENT_AUTH
                extensions: list[x509.ExtensionType] = [x509.ExtendedKeyUsage([usage])]
                extensions += [x509.SubjectAlternativeName([_host(host) for host in hosts])] if server else []
                self._create(name, name, authority, extensions, new)
            for name, text in (("acl", acl(region)), ("mosquitto.conf", self.configuration(address, port))):
                path = self.folder / name
                if not path.exists():
                    path.write_text(text, encoding="utf-8")
                    new.append(path)
        except OSError as error:
            raise ConfigError(f"{error.filename or self.folder}: cannot be written ({error.strerror})") from error
        return new

    def _authority(self, new: list[Path]) -> _Issuer:
        key_file, certificate_file = self.folder / f"{AUTHORITY}.key", self.folder / f"{AUTHORITY}.crt"
        if not certificate_file.exists():
            return self._create(AUTHORITY, "ltm trial authority", None, [], new)
        if not key_file.exists():
            raise ConfigError(
                f"{key_file}: the authority's key is missing, but needed for new certificates; put it back while "
                "`ltm certs` runs, then remove it again"
            )
        try:
            key = serialization.load_pem_private_key(key_file.read_bytes(), password=None)
            certificate = x509.load_pem_x509_certificate(certificate_file.read_bytes())
        except ValueError as error:
            raise ConfigError(f"{self.folder}: contains no authority made by `ltm certs`") from error
        if not isinstance(key, ec.EllipticCurvePrivateKey):
            raise ConfigError(f"{key_file}: not made by `ltm certs`; give another folder")
        return key, certificate

    def _create(
        self, name: str, subject: str, issuer: _Issuer | None, extensions: list[x509.ExtensionType], new: list[Path]
    ) -> _Issuer:
        """Create and write a key and its certificate, which `issuer` signs (None: the key itself, for an authority).

        The key is written first, readable only by its owner, because a certificate would count as complete; each file
        completely or not at all. Raises ConfigError if there is a key, which may be in use elsewhere."""
        if (self.folder / f"{name}.key").exists():
            raise ConfigError(f"{self.folder / name}.key has no certificate; move it away, then both are created")
        key, now = ec.generate_private_key(ec.SECP256R1()), datetime.now(UTC)
        signer = issuer[0] if issuer else key
        identifier = (
            x509.AuthorityKeyIdentifier.from_issuer_public_key(signer.public_key())
            if issuer
            else x509.SubjectKeyIdentifier.from_public_key(key.public_key())
        )
        constraints = x509.BasicConstraints(ca=issuer is None, path_length=None if issuer else 0)
        own_name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, subject)])
        builder = (
            x509.CertificateBuilder()
            .subject_name(own_name)
            .issuer_name(issuer[1].subject if issuer else own_name)
            .public_key(key.public_key())
            .serial_number(x509.random_serial_number())
            .not_valid_before(now - _BACKDATED)
            .not_valid_after(now + timedelta(days=self.days))
            .add_extension(constraints, critical=True)
        )
        for extension in (identifier, *extensions):
            builder = builder.add_extension(extension, critical=False)
        certificate = builder.sign(signer, hashes.SHA256())
        secret = key.private_bytes(
            serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
        )
        public = certificate.public_bytes(serialization.Encoding.PEM)
        for file_name, content, mode in ((f"{name}.key", secret, 0o600), (f"{name}.crt", public, 0o644)):
            partial = self.folder / f".{file_name}.new"
            partial.unlink(missing_ok=True)
            flags = os.O_CREAT | os.O_WRONLY | os.O_EXCL | os.O_NOFOLLOW
            with os.fdopen(os.open(partial, flags, mode), "wb") as file:
                file.write(content)
            sync(partial)
            partial.replace(self.folder / file_name)
            new.append(self.folder / file_name)
        return key, certificate

    def configuration(self, address: str, port: int) -> str:
        """Return mosquitto's configuration; clients are identified by their certificates, which are required."""
        folder = self.folder.resolve()
        return f"""# Written by `ltm certs`: a broker for the link between towers and their region's map.
listener {port} {address}
cafile {folder}/{AUTHORITY}.crt
certfile {folder}/{BROKER}.crt
keyfile {folder}/{BROKER}.key
tls_version tlsv1.2
require_certificate true
use_identity_as_username true
# Otherwise a client could end the connection of another by using its name.
use_username_as_clientid true
allow_anonymous false
acl_file {folder}/acl
user {getpass.getuser()}
# The broker needs to keep nothing: the towers and the map store all frames.
persistence false
max_packet_size {LARGEST_PACKET}
max_queued_messages 10000
max_queued_bytes {64 << 20}
max_keepalive 600
"""


def acl(region: str) -> str:
    """Return the access rights by certificate name: a tower writes only its own votes, and reads their answers."""
    return f"""# Written by `ltm certs`. %u is the common name of the client's certificate.
user {AGGREGATOR}
topic read {ROOT}/{region}/votes/+
topic write {ROOT}/{region}/ack/+
topic write {ROOT}/{region}/aggregator

pattern write {ROOT}/{region}/votes/%u
pattern read {ROOT}/{region}/ack/%u
pattern read {ROOT}/{region}/aggregator
"""


def _host(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        return x509.DNSName(host)
