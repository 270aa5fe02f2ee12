"""Asks a tower's health node, from the same machine."""

from __future__ import annotations

import http.client
import ipaddress
import json
import ssl
from typing import Any

from ltm_core.errors import ConfigError
from ltm_core.site_sections import HealthConfig
from ltm_ros.health.web_server import read_token, secret

LARGEST = 16 << 20
ANY = ("0.0.0.0", "::")  # nosec B104 # compared with, not listened on


def ask(config: HealthConfig, path: str) -> Any:
    """The answer as JSON gives it. The certificate must be the one of the site file. Raises ConfigError."""
    host = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(config.address, config.address)  # nosec B104
    place = f"{host}:{config.port}"
    headers = {"Host": f"[{host}]" if ipaddress.ip_address(host).version == 6 else host}
    connection: http.client.HTTPConnection
    if config.certificate is None:
        connection = http.client.HTTPConnection(host, config.port, timeout=10)
    else:
        context = ssl.create_default_context(cafile=str(secret(config.certificate)))
        context.check_hostname = False  # it is asked for by its address; who holds the key of that certificate is it
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
        raise ConfigError(f"{place}: no tower answers ({error}): does `ltm run` of this site run?") from error
    finally:
        connection.close()
