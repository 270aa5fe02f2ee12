"""Query a tower's health port from the same machine, and find which process uses it."""

from __future__ import annotations

import http.client
import ipaddress
import json
import ssl
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

from ltm_core.base.errors import ConfigError, LtmError
from ltm_core.site.sections import HealthConfig
from ltm_core.site.site_io import load_site
from ltm_ros.runtime.ros_environment import secret
from ltm_ros.runtime.web_server import bind_error, refusal
from ltm_ros.tower.patient_server import read_token


class DoctorState(StrEnum):
    OK = "ok"
    OPTIONAL = "optional"
    """Missing, and needed only by some commands."""
    WARNING = "warning"
    """Works with limitations."""
    MISSING = "missing"
    """Missing, and the system does not work without it."""


@dataclass(frozen=True)
class DoctorFinding:
    area: str
    name: str
    state: DoctorState
    detail: str
    remedy: str = ""
    """Command that fixes it."""

    @classmethod
    def judged(
        cls, area: str, name: str, fine: object, detail: str, remedy: str, bad: DoctorState = DoctorState.WARNING
    ) -> DoctorFinding:
        """Return a finding that is ok, or has the state `bad` and the remedy."""
        return cls(area, name, DoctorState.OK if fine else bad, detail, "" if fine else remedy)


LARGEST = 16 << 20


def ask(config: HealthConfig, path: str) -> Any:
    """Return the JSON answer of a tower. Its certificate must be that of the site file. Raises ConfigError."""
    host = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(config.address, config.address)  # nosec B104
    place = f"{host}:{config.port}"
    headers = {"Host": f"[{host}]" if ipaddress.ip_address(host).version == 6 else host}
    connection: http.client.HTTPConnection
    if config.certificate is None:
        connection = http.client.HTTPConnection(host, config.port, timeout=10)
    else:
        context = ssl.create_default_context(cafile=str(secret(config.certificate)))
        context.check_hostname = False  # queried by its address; the certificate identifies it
        connection = http.client.HTTPSConnection(host, config.port, timeout=10, context=context)
    if config.token is not None:
        headers["Authorization"] = f"Bearer {read_token(config.token)}"
    try:
        connection.request("GET", path, headers=headers)
        answer = connection.getresponse()
        body = answer.read(LARGEST)
        if answer.status != 200:
            raise ConfigError(f"{place}: {answer.status} {body[:200].decode(errors='replace').strip()}")
        return json.loads(body)
    except (OSError, http.client.HTTPException, ValueError) as error:
        raise ConfigError(
            f"{place}: no tower answers ({error}): check that `ltm run` of this site is running"
        ) from error
    finally:
        connection.close()


def check_health_port(path: Path) -> Iterator[DoctorFinding]:
    """Check that the tower can answer monitoring systems; it runs without that."""
    name = "health port"
    try:
        site = load_site(path)
    except LtmError as error:
        yield DoctorFinding("machine", name, DoctorState.WARNING, str(error), f"ltm check {path}")
        return
    health = site.health
    if health is None or health.port == 0:
        return
    taken = bind_error(health.address, health.port)
    if taken is None:
        yield DoctorFinding(
            "machine", name, DoctorState.OK, f"{health.address}:{health.port} is free: no tower is running"
        )
        return
    try:
        said = ask(health, "/status.json")
        other = "" if said["site"] == site.name else f"used by the tower of {said['site']}"
    except LtmError as why:
        other = str(why)
    except (TypeError, KeyError):
        other = "another program answers on this port"
    if other:
        remedy = f"{refusal(health.address, health.port, taken)} of {path}; the tower runs without it, and retries"
        yield DoctorFinding("machine", name, DoctorState.WARNING, other, remedy)
    else:
        yield DoctorFinding("machine", name, DoctorState.OK, f"{site.name} answers on {health.address}:{health.port}")
