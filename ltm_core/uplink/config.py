"""Configure the link between towers and the map of their region; read region.yaml."""

from pathlib import Path
from typing import Annotated, Self

from pydantic import AfterValidator, Field, model_validator

from ltm_core.base.strict_model import Expert, StrictModel, beside
from ltm_core.storage.config_io import load_yaml
from ltm_core.uplink.envelope import NAME

AGGREGATOR = "aggregator"
"""Common name in the certificate of a region's map; no tower may have it."""


def _not_the_aggregator(name: str) -> str:
    if name == AGGREGATOR:
        raise ValueError(f"a tower cannot be named {AGGREGATOR!r}, which is the name of the region's map")
    return name


Name = Annotated[str, Field(pattern=NAME)]
TowerName = Annotated[Name, AfterValidator(_not_the_aggregator)]


class BrokerConfig(StrictModel):
    """MQTT 5 broker over TLS; each side has a certificate signed by the same authority."""

    host: str = Field(min_length=1, max_length=253)
    """Host name or address of the broker, as stated in its certificate."""
    port: int = Field(8883, ge=1, le=65535)
    """TCP port of the broker."""
    ca: Path
    """Certificate of the authority (PEM), relative to the file that names it."""
    certificate: Path
    """Certificate of this client (PEM, elliptic curve), relative to the file that names it; its common name identifies
    the client."""
    key: Path
    """Private key (PEM), relative to the file that names it. A systemd credential with the file's name takes
    precedence."""
    keepalive: Expert[int] = Field(15, ge=5, le=600)
    """Keep-alive interval in seconds; a connection that is silent for 1.5 times as long is closed."""


class UplinkConfig(StrictModel):
    """Section `region` of a site: its cameras' votes are sent to the map of a region through a local outbox."""

    name: Name
    """Name of the region."""
    tower: TowerName
    """Name of this tower, the common name of its certificate."""
    broker: BrokerConfig
    """Broker of the region."""
    outbox_bytes: Expert[int] = Field(1 << 30, ge=1 << 20)
    """Maximum size of the outbox in bytes; beyond it, the oldest evidence is thinned."""
    outbox_days: Expert[float] = Field(7.0, gt=0)
    """Days after which an unsent frame is dropped; a region accepts none that is older."""


class ExportConfig(StrictModel):
    """Export of the map as Cloud Optimized GeoTIFFs with a STAC item, rewritten after changes."""

    folder: Path
    """Folder of the exports, relative to region.yaml; created if only its last part is missing."""
    every: float = Field(600.0, ge=1.0)
    """Minimum seconds between two exports."""


class RegionConfig(StrictModel):
    """Content of region.yaml: the fuel map of many towers."""

    name: Name
    site: Path
    """Site file of the region's map with its CRS, terrain, prior map and labels. Its cameras are named TOWER_CAMERA."""
    broker: BrokerConfig
    towers: list[TowerName] = Field(min_length=1)
    """Common names of the certificates of the towers whose votes are accepted."""
    folder: Path
    """Folder of the map, relative to region.yaml; created if only its last part is missing."""
    export: ExportConfig | None = None
    max_ahead: float = Field(10.0, gt=0)
    """Maximum seconds by which a tower's clock may be ahead."""
    max_behind: float = Field(7 * 86400.0, gt=0)
    """Maximum delay of a frame in seconds."""

    @model_validator(mode="after")
    def _towers_told_apart(self) -> Self:
        for tower in self.towers:
            clash = [other for other in self.towers if other.startswith(f"{tower}_")]
            if clash or self.towers.count(tower) > 1:
                raise ValueError(
                    f"towers {tower!r} and {(clash or [tower])[0]!r}: TOWER_CAMERA would be ambiguous; rename one"
                )
        return self


def load_region(path: Path | str) -> RegionConfig:
    """Load region.yaml; relative paths are resolved against the file. Raises ConfigError, see `config_io`."""
    path = Path(path).expanduser().resolve()
    return beside(load_yaml(path, RegionConfig), path.parent)
