"""List the data sources, and choose one by kind and place."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from functools import partial
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


def choose(kind: Kind, area: Area, wanted: str | None = None, sources: Sequence[Source] | None = None) -> Source:
    """Return the first source that delivers a kind of raster for an area; why others were not used is in its plans.

    `wanted`: the name of the source to use. Raises ConfigError for an unknown name, NoCoverageError with the reason of
    each source if none can be used, FetchError if the wanted one fails."""
    candidates = [source for source in (load_sources() if sources is None else sources) if kind in source.kinds]
    if wanted is not None:
        named = [source for source in candidates if source.name == wanted]
        if not named:
            raise ConfigError(
                f"{wanted}: no source of {kind}; known: {', '.join(s.name for s in candidates) or 'none'}"
            )
        reason = named[0].covers(area)
        if reason:
            raise NoCoverageError(f"{wanted} cannot be used: {reason}")
        return named[0]
    return _first(kind, area, candidates, [])


def _first(kind: Kind, area: Area, candidates: Sequence[Source], reasons: list[str]) -> Source:
    """Return the first source that covers an area; `reasons` why others were passed over before."""
    for number, source in enumerate(candidates, start=1):
        try:
            reason = source.covers(area)
        except FetchError as error:
            reason = str(error)
        if not reason:
            chosen = copy(source)  # the same source may serve another kind, with other reasons
            chosen.passed_over = tuple(reasons)
            empty = [*reasons, f"{source.name} is not used: every cell of the area is unknown"]
            chosen.next_source = partial(_first, kind, area, candidates[number:], empty)
            return chosen
        reasons = [*reasons, f"{source.name} is not used: {reason}"]
    listed = "".join(f"\n  {reason}" for reason in reasons)
    raise NoCoverageError(f"no source of {kind} for {area}; give your own file.{listed}")
