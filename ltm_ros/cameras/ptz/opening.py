"""The head that a site file states."""

from __future__ import annotations

from ltm_core.site.ptz_config import IsapiConfig, OnvifConfig, PtzConfig, ReolinkConfig, VapixConfig
from ltm_core.site.source_config import SourceConfig
from ltm_ros.cameras.ptz.connection import Connection
from ltm_ros.cameras.ptz.head import Head
from ltm_ros.cameras.ptz.isapi_vapix import IsapiHead, VapixHead
from ltm_ros.cameras.ptz.onvif import OnvifHead
from ltm_ros.cameras.ptz.reolink import ReolinkHead


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
