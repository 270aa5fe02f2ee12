from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
import yaml
from scenes.free_port import free_port
from scenes.small_site import NAME, write_small_site

from ltm_core.site.sections import HealthConfig
from ltm_ros.runtime.web_server import WebResponse
from ltm_ros.tower.doctor import DoctorState, check_tower
from ltm_ros.tower.health_client import open_health_server


@pytest.fixture
def port_site(tmp_path: Path) -> tuple[Path, HealthConfig]:
    """A site file whose port of health is free when the test begins."""
    site, port = write_small_site(tmp_path, recording=False).path, free_port()
    site.write_text(site.read_text() + yaml.safe_dump({"health": {"port": port}}))
    return site, HealthConfig(port=port)


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        ({"site": NAME}, ""),
        ({"site": "elsewhere"}, "the tower of elsewhere"),
        ({"status": "up"}, "another program answers"),
        (["up"], "another program answers"),
        (None, "no tower answers"),
    ],
)
def test_who_has_the_port_of_health(port_site: tuple[Path, HealthConfig], answer: Any, said: str) -> None:
    site, config = port_site
    page = WebResponse(b"<html>") if answer is None else WebResponse.json(answer)
    with closing(open_health_server(config, {"GET /status.json": lambda _: page})):
        (port,) = check_tower(site)
    assert said in port.detail
    if not said:
        assert (port.state, port.remedy) == (DoctorState.OK, "")
        return
    assert port.state is DoctorState.WARNING
    assert f"127.0.0.1:{config.port} cannot be opened (Address already in use)" in port.remedy
    assert f"of {site}; the tower runs without it, and retries" in port.remedy


def test_a_site_file_that_cannot_be_read_is_missing(tmp_path: Path) -> None:
    (found,) = check_tower(tmp_path / "none.yaml")
    assert (found.name, found.state) == ("site file", DoctorState.MISSING)
    assert "none.yaml" in found.detail
