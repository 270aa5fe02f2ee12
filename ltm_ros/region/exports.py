"""Writes a region's map as Cloud Optimized GeoTIFFs with a STAC item while it changes, beside the work on frames."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor

from ltm_core.errors import LtmError
from ltm_core.fuel.site_map import site_evidence_map
from ltm_core.uplink.config import ExportConfig
from ltm_ros.fuel_map.export import export_site
from ltm_ros.fuel_map.source import FuelSource
from ltm_ros.region.aggregator import Aggregator
from ltm_ros.runtime.health import Health, cause_of


class RegionExports:
    """One export at a time, on a thread of its own, of the map as it is when it begins."""

    def __init__(self, config: ExportConfig, aggregator: Aggregator, health: Health) -> None:
        self._config, self._aggregator, self._health = config, aggregator, health
        self._empty = site_evidence_map(aggregator.site, aggregator.geometry, aggregator.labels).layers()
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="export")
        self._work: Future[None] | None = None
        self._due, self._next_s = True, 0.0

    def look(self, now_s: float, changed: bool) -> None:
        """Begin one where the map has changed and the last is long enough ago."""
        self._due |= changed
        if self._work is not None and not self._work.done():
            return
        if self._work is not None and (error := self._work.exception()) is not None:
            self._work = None
            if not isinstance(error, LtmError | OSError):
                raise error
            self._health.trouble(cause_of(error) if isinstance(error, LtmError) else "export", f"export: {error}")
            self._due = True
        if self._due and now_s >= self._next_s:
            self._due, self._next_s = False, now_s + self._config.every
            self._work = self._pool.submit(self._write, self._source())

    def close(self) -> None:
        """Write the last state."""
        if self._due:
            self._pool.submit(self._write, self._source())
        self._pool.shutdown()

    def _source(self) -> FuelSource:
        """The map of this moment: its layers are arrays of their own."""
        aggregator = self._aggregator
        evidence = aggregator.persistence.map
        geometry = aggregator.site.in_crs(aggregator.geometry)
        layers = evidence.layers()
        return FuelSource(aggregator.site, aggregator.labels, geometry, evidence.prior, layers, self._empty)

    def _write(self, source: FuelSource) -> None:
        export_site(source, self._config.folder, None, "layers", source.provenance().system.value, None, None)
        self._health.note("exported")
