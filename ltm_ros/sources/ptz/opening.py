"""The head that a site file states."""

from __future__ import annotations

from ltm_core.ptz_config import IsapiConfig, OnvifConfig, PtzConfig, ReolinkConfig, VapixConfig
from ltm_core.source_config import SourceConfig
from ltm_ros.sources.ptz.connection import Connection
from ltm_ros.sources.ptz.head import Head
from ltm_ros.sources.ptz.isapi import IsapiHead
from ltm_ros.sources.ptz.onvif import OnvifHead
from ltm_ros.sources.ptz.reolink import ReolinkHead
from ltm_ros.sources.ptz.vapix import VapixHead


def open_head(config: PtzConfig, source: SourceConfig | None, connection: Connection | None = None) -> Head:
    """Asks nothing yet. `connection`: one that there is already. Raises SourceError, and UnauthorisedError where the
    password cannot be read."""
    match config:
        case VapixConfig():
            return VapixHead(config, source, connection)
        case IsapiConfig():
            return IsapiHead(config, source, connection)
        case OnvifConfig():
            return OnvifHead(config, source, connection)
        case ReolinkConfig():
            return ReolinkHead(config, source, connection)
