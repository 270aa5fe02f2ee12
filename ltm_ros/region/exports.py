"""Write a region's map as GeoTIFFs."""

from __future__ import annotations

import sys
from concurrent.futures import Future, ThreadPoolExecutor

from ltm_core.base.errors import LtmError
from ltm_core.fuel.prior import system_of
from ltm_core.pipeline.site_fuel import site_evidence_map
from ltm_core.uplink.config import ExportConfig
from ltm_ros.fuel_map.export import export_site
from ltm_ros.fuel_map.source import FuelSource
from ltm_ros.region.aggregator import Aggregator
from ltm_ros.runtime.health import Health, cause_of


class RegionExports:
    """Exports the current map, one export at a time, on a separate thread; failures are reported and tried again."""

    def __init__(self, config: ExportConfig, aggregator: Aggregator, health: Health) -> None:
        self._config, self._aggregator, self._health = config, aggregator, health
        self._empty = site_evidence_map(aggregator.site, aggregator.geometry, aggregator.labels).layers()
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="export")
        self._work: Future[None] | None = None
        self._due, self._next_s = True, 0.0

    def look(self, now_s: float, changed: bool) -> None:
        """Start an export if the map has changed and the last one is old enough."""
        self._due |= changed
        if self._work is not None and not self._work.done():
            return
        self._judge()
        if self._due and now_s >= self._next_s:
            self._due, self._next_s = False, now_s + self._config.every
            self._work = self._pool.submit(self._write, self._source())

    def close(self, changed: bool = False) -> None:
        """Write the last state if it is not written yet; `changed`: since the last `look`."""
        self._due |= changed
        self._pool.shutdown()
        self._judge()
        if self._due:
            try:
                self._write(self._source())
            except Exception as error:
                self._tell(error)

    def _judge(self) -> None:
        """Check the result of the last export; after a failure, the map is due again."""
        work, self._work = self._work, None
        error = None if work is None else work.exception()
        if error is not None:
            self._due = True
            self._tell(error)

    def _tell(self, error: BaseException) -> None:
        if isinstance(error, LtmError):
            self._health.trouble(cause_of(error), f"the map was not exported: {error}")
        else:  # an internal error, or one of a library
            sys.excepthook(type(error), error, error.__traceback__)
            self._health.trouble("export", f"the map was not exported ({type(error).__name__}: {error}); see the log")

    def _source(self) -> FuelSource:
        """Return the current map, with copies of its layers."""
        aggregator = self._aggregator
        evidence = aggregator.persistence.map
        geometry = aggregator.site.in_crs(aggregator.geometry)
        layers = evidence.layers()
        return FuelSource(aggregator.site, aggregator.labels, geometry, evidence.prior, layers, self._empty)

    def _write(self, source: FuelSource) -> None:
        export_site(source, self._config.folder, None, "layers", system_of(source.prior).value, None, None)
        self._health.note("exported")
