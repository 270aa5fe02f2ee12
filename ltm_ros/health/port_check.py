"""Who has the port on which a tower answers monitoring systems: for `ltm doctor`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from ltm_core.errors import LtmError
from ltm_core.site_io import load_site
from ltm_ros.doctor_finding import Condition, Finding
from ltm_ros.health.ports import bind_error, refusal
from ltm_ros.health.web_client import ask


def check_health_port(path: Path) -> Iterator[Finding]:
    """Whether the tower of a site file can answer monitoring systems: without that it runs all the same."""
    name = "health port"
    try:
        site = load_site(path)
    except LtmError as error:
        yield Finding("machine", name, Condition.WARNING, str(error), f"ltm check {path}")
        return
    health = site.health
    if health is None or health.port == 0:
        return
    taken = bind_error(health.address, health.port)
    if taken is None:
        yield Finding("machine", name, Condition.OK, f"{health.address}:{health.port} is free: no tower runs")
        return
    try:
        said = ask(health, "/status.json")
        other = "" if said["site"] == site.name else f"the tower of {said['site']} has it"
    except LtmError as why:
        other = str(why)
    except (TypeError, KeyError):
        other = "what answers there is no tower"
    if other:
        remedy = f"{refusal(health.address, health.port, taken)} of {path}; the tower runs without, and tries again"
        yield Finding("machine", name, Condition.WARNING, other, remedy)
    else:
        yield Finding("machine", name, Condition.OK, f"{site.name} answers on {health.address}:{health.port}")
