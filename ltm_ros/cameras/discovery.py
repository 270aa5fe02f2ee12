"""Discover cameras on one network by WS-Discovery (ONVIF). Source: OASIS WS-Discovery 1.0 (draft of April 2005), ONVIF
Core Specification 7.

Only the network of the given interface is queried, once. Answers are limited in number, size and time."""

from __future__ import annotations

import ipaddress
import socket
import time
import uuid
from dataclasses import dataclass
from urllib.parse import unquote

from ltm_core.base.errors import ConfigError
from ltm_core.base.redaction import plain
from ltm_ros.cameras.protocols.credentials import SourceError
from ltm_ros.cameras.ptz.head import found, parsed_xml, split_address

GROUP, PORT = "239.255.255.250", 3702
MOST_ANSWERS = 256
MOST_BYTES = 64 << 10


@dataclass(frozen=True)
class Discovered:
    """A discovered camera. `address`: of its device service, as it reports; `host`: the sender of its answer."""

    host: str
    address: str
    name: str
    hardware: str


def discover(
    interface: str, seconds: float = 4.0, group: str = GROUP, port: int = PORT
) -> tuple[list[Discovered], int]:
    """Return the cameras that answer within `seconds` on the network of `interface`, an IPv4 address of this computer,
    and the number of invalid answers. Raises ConfigError if the address is not this computer's."""
    try:
        ours = ipaddress.IPv4Address(interface)
    except ValueError:
        raise ConfigError(
            f"{interface!r} is not an IPv4 address: give this computer's address on the cameras' network"
        ) from None
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
        try:
            asking.bind((str(ours), 0))
            asking.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, ours.packed)
            asking.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 1)
            asked = f"urn:uuid:{uuid.uuid4()}"
            asking.sendto(_question(asked), (group, port))
        except OSError as error:
            raise ConfigError(
                f"interface {interface} cannot be used ({error.strerror}): give an IPv4 address of this computer"
            ) from error
        return _answers(asking, asked, seconds)


def _answers(asking: socket.socket, asked: str, seconds: float) -> tuple[list[Discovered], int]:
    known: dict[str, Discovered] = {}
    wrong = 0
    until = time.monotonic() + seconds
    for _ in range(4 * MOST_ANSWERS):
        left = until - time.monotonic()
        if left <= 0 or len(known) >= MOST_ANSWERS:
            break
        asking.settimeout(left)
        try:
            body, (host, _) = asking.recvfrom(MOST_BYTES)
        except OSError:
            break
        try:
            camera = camera_in(body, host, asked)
        except SourceError:
            wrong += 1
            continue
        known.setdefault(camera.address, camera)
    return sorted(known.values(), key=lambda camera: ipaddress.IPv4Address(camera.host)), wrong


def camera_in(body: bytes, host: str, asked: str) -> Discovered:
    """Return the camera in the answer of `host` to message `asked`. Raises SourceError if it is invalid."""
    root = parsed_xml(body)
    relates, addresses, scopes = found(root, "RelatesTo"), found(root, "XAddrs"), found(root, "Scopes")
    if relates is None or (relates.text or "").strip() != asked or addresses is None:
        raise SourceError("an answer to another request")
    places = [place for place in (addresses.text or "").split() if place.startswith(("http://", "https://"))]
    if not places:
        raise SourceError("an answer without an address")
    # A camera on two networks reports both addresses.
    own = next((place for place in places if split_address(place).hostname == host), places[0])
    words = ((scopes.text if scopes is not None else None) or "").split()
    return Discovered(host, plain(own, 200), _scope(words, "name"), _scope(words, "hardware"))


def _scope(words: list[str], key: str) -> str:
    mark = f"onvif://www.onvif.org/{key}/"
    return plain(next((unquote(word[len(mark) :]) for word in words if word.startswith(mark)), ""), 60)


def _question(asked: str) -> bytes:
    return (
        '<?xml version="1.0" encoding="UTF-8"?>'
        '<s:Envelope xmlns:s="http://www.w3.org/2003/05/soap-envelope" '
        'xmlns:a="http://schemas.xmlsoap.org/ws/2004/08/addressing" '
        'xmlns:d="http://schemas.xmlsoap.org/ws/2005/04/discovery" '
        'xmlns:n="http://www.onvif.org/ver10/network/wsdl">'
        f"<s:Header><a:MessageID>{asked}</a:MessageID>"
        "<a:To>urn:schemas-xmlsoap-org:ws:2005:04:discovery</a:To>"
        "<a:Action>http://schemas.xmlsoap.org/ws/2005/04/discovery/Probe</a:Action></s:Header>"
        "<s:Body><d:Probe><d:Types>n:NetworkVideoTransmitter</d:Types></d:Probe></s:Body></s:Envelope>"
    ).encode()
