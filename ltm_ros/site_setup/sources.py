"""List the data sources, and choose one by kind and place."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from pydantic import Field

from ltm_core.base.errors import ConfigError
from ltm_core.base.resources import config_path
from ltm_core.base.strict_model import StrictModel
from ltm_core.storage.config_io import checked, read_yaml
from ltm_ros.site_setup.request import Area, Fetched, FetchError, Kind, NoCoverageError, Plan, Progress, SourceConfig
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


@dataclass(frozen=True)
class Choice:
    """The source of a raster, with its plan. `passed_over`: why preferred sources are not used; `rest`: the others."""

    kind: Kind
    source: Source
    plan: Plan
    passed_over: Sequence[str]
    rest: Sequence[Source]

    def fetch(self, folder: Path, progress: Progress) -> Fetched:
        """Fetch the plan, or if every cell of it is unknown, that of the next source; `Fetched` names the source.

        Raises NoCoverageError, FetchError."""
        try:
            return self.source.fetch(self.plan, folder, progress)
        except NoCoverageError as error:
            reasons = [*self.passed_over, f"{self.source.name} is not used: {error}"]
            return choose(self.kind, self.plan.area, self.rest, reasons).fetch(folder, progress)


def choose(kind: Kind, area: Area, sources: Sequence[Source], passed_over: Sequence[str] = ()) -> Choice:
    """Return the first source that delivers a kind of raster for an area; the plan notes why others are not used.

    `passed_over`: why others were not used before. Raises NoCoverageError with the reason of each source if none can be
    used."""
    reasons, usable = list(passed_over), [source for source in sources if kind in source.kinds]
    for k, source in enumerate(usable):
        try:
            plan = source.plan(area)
        except FetchError as error:
            reasons.append(f"{source.name} is not used: {error}")
        else:
            plan = replace(plan, notes=(*reasons, *plan.notes))
            return Choice(kind, source, plan, reasons, usable[k + 1 :])
    listed = "".join(f"\n  {reason}" for reason in reasons)
    raise NoCoverageError(f"{kind}: no source for {area}; give your own file.{listed}")
