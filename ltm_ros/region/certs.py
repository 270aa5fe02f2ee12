"""Make a small certificate authority for trials: certificates of a region's broker, map and towers.

It also writes the broker's configuration with the access rights."""

from __future__ import annotations

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
from ltm_core.uplink.config import AGGREGATOR
from ltm_core.uplink.envelope import NAME
from ltm_ros.region.mqtt_link import LARGEST_PACKET, ROOT

AUTHORITY: Final = "ca"
BROKER: Final = "broker"
_RESERVED: Final = (AUTHORITY, BROKER, AGGREGATOR)
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
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            return self._made(region, clients, hosts, address, port)
        except OSError as error:
            raise ConfigError(f"{error.filename or self.folder}: cannot be written ({error.strerror})") from error

    def _made(self, region: str, clients: Sequence[str], hosts: Sequence[str], address: str, port: int) -> list[Path]:
        new: list[Path] = []
        missing = [n for n in (BROKER, AGGREGATOR, *clients) if not (self.folder / f"{n}.crt").exists()]
        if missing:
            self._make_certificates(missing, hosts, new)
        for name, text in (("acl", acl(region)), ("mosquitto.conf", self.configuration(address, port))):
            path = self.folder / name
            if not path.exists():
                path.write_text(text, encoding="utf-8")
                new.append(path)
        return new

    def _make_certificates(self, names: Sequence[str], hosts: Sequence[str], new: list[Path]) -> None:
        authority_key, authority = self._authority(new)
        for name in names:
            if (self.folder / f"{name}.key").exists():
                raise ConfigError(f"{self.folder / name}.key has no certificate; move it, and run `ltm certs` again")
            key = ec.generate_private_key(ec.SECP256R1())
            usage = ExtendedKeyUsageOID.SERVER_AUTH if name == BROKER else ExtendedKeyUsageOID.CLIENT_AUTH
            builder = (
                self._builder(name)
                .issuer_name(authority.subject)
                .public_key(key.public_key())
                .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
                .add_extension(x509.ExtendedKeyUsage([usage]), critical=False)
                .add_extension(
                    x509.AuthorityKeyIdentifier.from_issuer_public_key(authority_key.public_key()), critical=False
                )
            )
            if name == BROKER:
                builder = builder.add_extension(
                    x509.SubjectAlternativeName([_host(host) for host in hosts]), critical=False
                )
            self._write(name, key, builder.sign(authority_key, hashes.SHA256()), new)

    def _authority(self, new: list[Path]) -> tuple[ec.EllipticCurvePrivateKey, x509.Certificate]:
        key_file, certificate_file = self.folder / f"{AUTHORITY}.key", self.folder / f"{AUTHORITY}.crt"
        if certificate_file.exists():
            if not key_file.exists():
                raise ConfigError(
                    f"{key_file}: the authority's key is missing, but needed for new certificates; put it back "
                    "while `ltm certs` runs, then remove it again"
                )
            try:
                key = serialization.load_pem_private_key(key_file.read_bytes(), password=None)
                certificate = x509.load_pem_x509_certificate(certificate_file.read_bytes())
            except ValueError as error:
                raise ConfigError(f"{self.folder}: contains no authority made by `ltm certs`") from error
            if not isinstance(key, ec.EllipticCurvePrivateKey):
                raise ConfigError(f"{key_file}: not made by `ltm certs`; give another folder")
            return key, certificate
        made = ec.generate_private_key(ec.SECP256R1())
        certificate = (
            self._builder("ltm trial authority")
            .issuer_name(_subject("ltm trial authority"))
            .public_key(made.public_key())
            .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
            .add_extension(x509.SubjectKeyIdentifier.from_public_key(made.public_key()), critical=False)
            .sign(made, hashes.SHA256())
        )
        self._write(AUTHORITY, made, certificate, new)
        return made, certificate

    def _builder(self, name: str) -> x509.CertificateBuilder:
        now = datetime.now(UTC)
        return (
            x509.CertificateBuilder()
            .subject_name(_subject(name))
            .serial_number(x509.random_serial_number())
            .not_valid_before(now - _BACKDATED)
            .not_valid_after(now + timedelta(days=self.days))
        )

    def _write(
        self, name: str, key: ec.EllipticCurvePrivateKey, certificate: x509.Certificate, new: list[Path]
    ) -> None:
        """Write the key first, readable only by its owner, because a certificate would count as complete; each file
        completely or not at all."""
        secret = key.private_bytes(
            serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
        )
        public = certificate.public_bytes(serialization.Encoding.PEM)
        for file_name, content, mode in ((f"{name}.key", secret, 0o600), (f"{name}.crt", public, 0o644)):
            partial = self.folder / f".{file_name}.new"
            partial.unlink(missing_ok=True)
            descriptor = os.open(partial, os.O_CREAT | os.O_WRONLY | os.O_EXCL | os.O_NOFOLLOW, mode)
            with os.fdopen(descriptor, "wb") as file:
                file.write(content)
                file.flush()
                os.fsync(descriptor)
            partial.replace(self.folder / file_name)
            new.append(self.folder / file_name)

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
# Else whoever comes as another client would end that one's connection.
use_username_as_clientid true
allow_anonymous false
acl_file {folder}/acl
user {getpass.getuser()}
# Towers and the map remember what matters: the broker may forget everything at any time.
persistence false
max_packet_size {LARGEST_PACKET}
max_queued_messages 10000
max_queued_bytes {64 << 20}
max_keepalive 600
"""


def acl(region: str) -> str:
    """What a certificate's name may do: a tower writes its own votes alone and reads what it is answered."""
    return f"""# Written by `ltm certs`. %u is the common name of the client's certificate.
user {AGGREGATOR}
topic read {ROOT}/{region}/votes/+
topic write {ROOT}/{region}/ack/+
topic write {ROOT}/{region}/aggregator

pattern write {ROOT}/{region}/votes/%u
pattern read {ROOT}/{region}/ack/%u
pattern read {ROOT}/{region}/aggregator
"""


def _subject(name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])


def _host(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        return x509.DNSName(host)
