"""List the data sources, and choose one by kind and place."""

from collections.abc import Sequence
from copy import copy
from pathlib import Path

from pydantic import Field

from ltm_core.base.errors import ConfigError
from ltm_core.base.resources import config_path
from ltm_core.base.strict_model import StrictModel
from ltm_core.storage.config_io import checked, read_yaml
from ltm_ros.site_setup.request import Area, FetchError, Kind, NoCoverageError, SourceConfig
from ltm_ros.site_setup.services import CoverageSource, LandfireSource, OpenTopographySource
from ltm_ros.site_setup.source import NationalMapSource, Source, StacSource, TileSource, UrlSource
from ltm_ros.site_setup.web import Web

_ADAPTERS: dict[str, type[Source]] = {
    "tiles": TileSource,
    "tnm": NationalMapSource,
    "stac": StacSource,
    "url": UrlSource,
    "opentopography": OpenTopographySource,
    "landfire": LandfireSource,
    "wcs": CoverageSource,
}


class SourcesConfig(StrictModel):
    """The content of `config/sources.yaml`, and of a user's file of sources."""

    sources: dict[str, SourceConfig] = Field(min_length=1)
    """The sources by name, preferred ones first."""


def load_sources(own: Path | None = None, web: Web | None = None) -> list[Source]:
    """Return all sources, preferred ones first.

    `own`: a user's file. It has the form of `config/sources.yaml`; keys of a known source replace the shipped ones,
    and further sources come before the shipped ones. Raises ConfigError."""
    path = config_path("sources.yaml")
    entries = dict(read_yaml(path)["sources"])
    if own is not None:
        content = read_yaml(own)
        stated = content.get("sources") if isinstance(content, dict) else None
        if not isinstance(stated, dict) or not all(isinstance(value, dict) for value in stated.values()):
            raise ConfigError(f"{own}: expected `sources:` with the keys of each source below its name")
        new = {name: value for name, value in stated.items() if name not in entries}
        entries = new | {name: {**value, **stated.get(name, {})} for name, value in entries.items()}
    config = checked(SourcesConfig, {"sources": entries}, str(own or path))
    client = web or Web()
    return [_ADAPTERS[entry.protocol](name, entry, client) for name, entry in config.sources.items()]


def choose(kind: Kind, area: Area, sources: Sequence[Source], passed_over: Sequence[str] = ()) -> Source:
    """Return the first source that delivers a kind of raster for an area; why others were not used is in its plans.

    `passed_over`: why others were not used before. Raises NoCoverageError with the reason of each source if none can be
    used."""
    reasons, rest = list(passed_over), [source for source in sources if kind in source.kinds]
    while rest:
        source = rest.pop(0)
        try:
            source.plan(area)
        except FetchError as error:
            reasons.append(f"{source.name} is not used: {error}")
        else:
            break
    else:
        listed = "".join(f"\n  {reason}" for reason in reasons)
        raise NoCoverageError(f"no source of {kind} for {area}; give your own file.{listed}")

    def following(reason: str) -> Source:
        return choose(kind, area, rest, [*reasons, f"{source.name} is not used: {reason}"])

    chosen = copy(source)  # the same source may serve another kind, with other reasons
    chosen.passed_over, chosen.next_source = tuple(reasons), following
    return chosen
