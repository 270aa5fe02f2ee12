"""The PTZ head that a site file states."""

from __future__ import annotations

from ltm_core.site.ptz_config import IsapiConfig, OnvifConfig, PtzConfig, ReolinkConfig, VapixConfig
from ltm_core.site.source_config import SourceConfig
from ltm_ros.cameras.ptz.connection import Connection
from ltm_ros.cameras.ptz.head import PtzHead
from ltm_ros.cameras.ptz.isapi_vapix import IsapiPtzHead, VapixPtzHead
from ltm_ros.cameras.ptz.onvif import OnvifPtzHead
from ltm_ros.cameras.ptz.reolink import ReolinkPtzHead


def open_ptz(config: PtzConfig, source: SourceConfig | None, connection: Connection | None = None) -> PtzHead:
    """Asks nothing yet. `connection`: one that there is already. Raises SourceError, and UnauthorisedError where the
    password cannot be read."""
    match config:
        case VapixConfig():
            return VapixPtzHead(config, source, connection)
        case IsapiConfig():
            return IsapiPtzHead(config, source, connection)
        case OnvifConfig():
            return OnvifPtzHead(config, source, connection)
        case ReolinkConfig():
            return ReolinkPtzHead(config, source, connection)
