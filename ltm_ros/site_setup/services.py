"""Sources that prepare a file on request: OpenTopography, LANDFIRE's product service, Web Coverage Services."""

import math
import re
import time
import zipfile
import zlib
from dataclasses import replace
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import urlencode

import rasterio

from ltm_core.base.errors import RasterError
from ltm_core.base.redaction import plain, redacted
from ltm_core.raster.dem import Bounds
from ltm_core.raster.raster_io import open_raster, read_band
from ltm_ros.site_setup.request import (
    METRES_PER_DEGREE,
    Area,
    Fetched,
    FetchError,
    NoCoverageError,
    Part,
    Plan,
    Progress,
)
from ltm_ros.site_setup.source import Source, filled, list_in
from ltm_ros.site_setup.web import check_room, digest, in_words, put_into

_JOB_S = 1800.0
"""Time limit of a job, seconds."""
_MOST_EXPANDED = 2 << 30
"""Maximum size of the rasters in an archive, bytes."""
_ALMOST_ALL = 0.95
"""Share of known cells from which an edition is complete for an area."""
_CONUS, _ALASKA, _HAWAII = "conus", "ak", "hi"
_FUEL_CRS = {_CONUS: "5070", _ALASKA: "3338"}
"""EPSG codes of LANDFIRE's own grids; the service would resample to a grid of its own otherwise."""
_LATITUDE_OF_ALASKA, _LONGITUDE_OF_HAWAII = 51.0, -150.0


class OpenTopographySource(Source):
    """The global and USGS elevation APIs of OpenTopography."""

    key_parameter = "API_Key"

    def _planned(self, area: Area) -> Plan:
        west, south, east, north = area.padded(4 * self.resolution_m).bounds_lonlat
        bounds = f"south={south:.6f}&north={north:.6f}&west={west:.6f}&east={east:.6f}"
        url = f"{self.address}{'&' if '?' in self.address else '?'}{bounds}&outputFormat=GTiff"
        cells = (east - west) * (north - south) * (METRES_PER_DEGREE / self.resolution_m) ** 2
        return Plan(area, (Part(url, f"{self.name}.tif", round(4 * cells) + (1 << 16)),), (), self.year)


class CoverageSource(Source):
    """Coverages of any Web Coverage Service 2.0, cut on their own grid so that nothing is resampled.

    The address has `{layer}` as its coverage; the service's description states CRS, axes and cells."""

    def _planned(self, area: Area) -> Plan:
        parts = []
        for layer in self.config.layers or ("",):
            address = filled(self.address, {"layer": layer, "year": str(self.year)})
            base, _, coverage = address.partition("#")
            query = {"service": "WCS", "version": "2.0.1", "request": "DescribeCoverage", "coverageId": coverage}
            about = self.web.get(base, query).decode("utf-8", "replace")
            grid = CoverageGrid(about, f"{redacted(base)}, coverage {coverage}")
            (left, bottom, right, top), cells = grid.cut(area, self.name)
            x, y = grid.labels
            asked = urlencode(query | {"request": "GetCoverage"})
            subsets = f"subset={x}({left:.10g},{right:.10g})&subset={y}({bottom:.10g},{top:.10g})"
            url = f"{base}{'&' if '?' in base else '?'}{asked}&{subsets}&format=image/tiff"
            parts.append(Part(url, f"{coverage.rpartition('__')[2]}.tif", 2 * cells + 4096))
        return Plan(area, tuple(parts), (), self.year)


class CoverageGrid:
    """Grid of a coverage as DescribeCoverage states it. Raises FetchError."""

    def __init__(self, xml: str, place: str) -> None:
        envelope = re.search(r"<(?:\w+:)?Envelope\b[^>]*>", xml)
        crs = re.search(r'srsName="[^"]*?(?:EPSG/[^/"]*/|EPSG::?)(\d+)"', envelope[0]) if envelope else None
        labels = re.search(r'axisLabels="([^"]+)"', envelope[0]) if envelope else None
        numbers = {name: _numbers(xml, name) for name in ("lowerCorner", "upperCorner", "pos", "offsetVector")}
        found = [len(values) >= (4 if name == "offsetVector" else 2) for name, values in numbers.items()]
        if crs is None or labels is None or len(labels[1].split()) != 2 or not all(found):
            raise FetchError(f"{place}: the answer describes no grid ({in_words(xml.encode())}); check the address")
        self.crs, names = f"EPSG:{crs[1]}", labels[1].split()
        x = 0 if names[0].lower() in ("x", "e", "east", "easting", "lon", "long", "longitude") else 1
        self.labels = (names[x], names[1 - x])
        low, high, first, steps = numbers.values()  # GML has them in the order of the axes
        self.step = max(abs(steps[x]), abs(steps[x + 2])), max(abs(steps[1 - x]), abs(steps[3 - x]))
        self.low, self.high = (low[x], low[1 - x]), (high[x], high[1 - x])
        self.origin = first[x] - self.step[0] / 2, first[1 - x] - self.step[1] / 2

    def cut(self, area: Area, name: str) -> tuple[Bounds, int]:
        """Return the whole cells that cover an area, as bounds, and their number. Raises NoCoverageError."""
        from rasterio.warp import transform_bounds

        bounds = transform_bounds("EPSG:4326", self.crs, *area.bounds_lonlat, densify_pts=21)
        edges = []
        for axis in (0, 1):
            step, origin = self.step[axis], self.origin[axis]
            first = math.floor((bounds[axis] - origin) / step) - 2
            last = math.ceil((bounds[axis + 2] - origin) / step) + 2
            edges.append((max(origin + first * step, self.low[axis]), min(origin + last * step, self.high[axis])))
        (left, right), (bottom, top) = edges
        if left >= right or bottom >= top:
            raise NoCoverageError(f"{name} has no data for {area}")
        return (left, bottom, right, top), round((right - left) / self.step[0] * (top - bottom) / self.step[1])


def _numbers(xml: str, name: str) -> list[float]:
    """Return the numbers in all elements of a name, in order."""
    texts = re.findall(rf"<(?:\w+:)?{name}\b[^>]*>([^<]*)<", xml)
    try:
        return [float(word) for text in texts for word in text.split()]
    except ValueError:
        return []


class LandfireSource(Source):
    """LANDFIRE's product service: a job is submitted, polled and downloaded as an archive of one raster."""

    poll_s = 5.0
    """Pause between queries of a job's state, seconds."""

    def _planned(self, area: Area) -> Plan:
        layers = self._layers(area)
        if not layers:
            raise NoCoverageError(f"{self.name} lists no layer of {', '.join(self.config.layers)} for {area}")
        year = max(layers)
        width, height = area.size_m
        size = 2 * len(layers[year]) * round(width * height / self.resolution_m**2) + (1 << 16)
        parts = [
            Part(";".join(layers[y]), f"LF{y}.zip", size if y == year else 0) for y in sorted(layers, reverse=True)
        ]
        return Plan(area, tuple(parts), (), year)

    def _layers(self, area: Area) -> dict[int, list[str]]:
        """Return the names of the wanted layers by year, of years that have all that the newest has."""
        found: dict[int, dict[str, str]] = {}
        for product in list_in(self.web.json(f"{self.address}/products"), "products", self.name):
            if not (isinstance(product, dict) and product.get(_region(area))):
                continue
            layer, acronym = str(product.get("layerName")), str(product.get("acronym"))
            year = re.search(r"20\d\d", layer) or re.search(r"20\d\d", str(product.get("version")))
            # Seasonal editions have a suffix (LF2025_FBFM40_SP26), and many regions have none.
            if year and acronym in self.config.layers and re.fullmatch(rf"\w*?{acronym}", layer):
                found.setdefault(int(year[0]), {})[acronym] = layer
        most = max((len(layers) for layers in found.values()), default=0)
        order = self.config.layers
        return {y: [ls[a] for a in order if a in ls] for y, ls in found.items() if len(ls) == most}

    def fetch(self, plan: Plan, folder: Path, progress: Progress) -> Fetched:
        """Fetch the newer of two editions that knows almost all of the area, else the one that knows more.

        An edition is published region by region. Raises NoCoverageError, FetchError."""
        best, most = None, 0.0
        check_room(folder, plan.expected_bytes)
        for part in plan.parts[:2]:
            raster = self._raster(self._archive(part, plan.area, progress), part)
            with open_raster(raster, driver="GTiff") as source:
                known = 1.0 - float(read_band(source, 1)[1].mean())
            if known > most:
                best, most = (part, raster), known
            if known > _ALMOST_ALL:
                break
        if best is None:
            raise NoCoverageError(f"{self.name}: every cell of the area is unknown; choose another source")
        part, raster = best
        with rasterio.open(raster, "r+") as sink:
            for band, layer in enumerate(part.url.split(";"), start=1):
                if not sink.descriptions[band - 1]:
                    sink.set_band_description(band, layer)
            sink.update_tags(SOURCE=self.name, LICENCE=self.licence)
        year = part.name[2:6]
        file = put_into(folder, raster, f"LF{year}.tif")
        asked = replace(part, url=f"{self.address}/job/submit?Layer_List={part.url}")
        return self._fetched(replace(plan, year=int(year)), [file], [asked])

    def _archive(self, part: Part, area: Area, progress: Progress) -> Path:
        """Return the archive of a job; one that was submitted by an interrupted run is continued."""
        west, south, east, north = area.padded(4 * self.resolution_m).bounds_lonlat
        query = {"Layer_List": part.url, "Area_of_Interest": f"{west:.6f} {south:.6f} {east:.6f} {north:.6f}"}
        if _region(area) in _FUEL_CRS:
            query["Output_Projection"] = _FUEL_CRS[_region(area)]
        self.web.make_cache()
        noted = self.web.cache / f"{digest(self.address, sorted(query.items()))}.job"
        url = self._finished(noted)
        if url is None:
            answer = self.web.json(f"{self.address}/job/submit", {"Email": self.key, **query})
            job = answer.get("jobId") if isinstance(answer, dict) else None
            if not isinstance(job, str):
                raise FetchError(f"{self.name}: the job was rejected ({plain(str(answer), 300)}); change the area")
            noted.write_text(job)
            url = self._finished(noted)
        remote = None if url is None else self.web.remote(url)
        if url is None or remote is None:  # archives are deleted after some days
            noted.unlink(missing_ok=True)
            raise FetchError(f"{self.name}: the result of the job is gone from the server; run the command again")
        return self.web.download(url, progress, remote=remote)

    def _finished(self, noted: Path) -> str | None:
        """Wait for a job, and return the address of its result; None if there is no such job. Raises FetchError."""
        if not (job := noted.read_text() if noted.exists() else ""):
            return None
        end = time.monotonic() + _JOB_S
        while time.monotonic() < end:
            try:
                answer = self.web.json(f"{self.address}/job/status", {"JobId": job})
            except FetchError as error:
                if "not found" in str(error):
                    noted.unlink(missing_ok=True)
                    return None
                raise
            state = answer.get("status") if isinstance(answer, dict) else None
            if state == "Succeeded" and re.match(r"https?://", str(answer.get("outputFile"))):
                return str(answer["outputFile"])
            if state not in ("Pending", "Submitted", "Executing"):
                noted.unlink(missing_ok=True)
                raise FetchError(
                    f"{self.name}: job {plain(job, 60)}: {plain(str(state), 40)} ({_reason(answer)}); change the area"
                )
            time.sleep(self.poll_s)
        raise FetchError(
            f"{self.name}: job {plain(job, 60)} is not finished after {_JOB_S:.0f} s; run the command again"
        )

    def _raster(self, archive: Path, part: Part) -> Path:
        """Extract the raster of an archive into the cache; it has a band for each layer. Raises FetchError."""
        raster = archive.with_suffix(".tif")
        try:
            with zipfile.ZipFile(archive) as box:
                members = [m for m in box.infolist() if PurePosixPath(m.filename).suffix.lower() == ".tif"]
                if len(members) != 1 or members[0].file_size > _MOST_EXPANDED:
                    raise FetchError(f"{self.name}: {len(members)} rasters in the archive, expected 1; try again later")
                check_room(self.web.cache, members[0].file_size)
                raster.unlink(missing_ok=True)  # it may be linked from a folder of results
                raster.write_bytes(box.read(members[0]))
            with open_raster(raster, driver="GTiff") as source:
                if source.count != part.url.count(";") + 1:
                    raise FetchError(f"{self.name}: {source.count} bands for {part.url}; try again later")
        except OSError as error:
            raster.unlink(missing_ok=True)
            raise FetchError(f"{raster}: cannot be written ({error.strerror}); make room on the disk") from error
        except (zipfile.BadZipFile, zlib.error, EOFError, RuntimeError, RasterError) as error:
            archive.unlink(missing_ok=True)
            raster.unlink(missing_ok=True)
            raise FetchError(f"{self.name}: the archive is damaged ({error}); run the command again") from error
        return raster


def _region(area: Area) -> str:
    west, south, east, north = area.bounds_lonlat
    if (south + north) / 2 > _LATITUDE_OF_ALASKA:
        return _ALASKA
    return _HAWAII if (west + east) / 2 < _LONGITUDE_OF_HAWAII else _CONUS


def _reason(answer: Any) -> str:
    messages = answer.get("messages") if isinstance(answer, dict) else None
    texts = [str(m.get("description") if isinstance(m, dict) else m) for m in messages or []]
    wrong = [text for text in texts if "ERROR" in text.upper()] or texts[-1:]
    return plain("; ".join(wrong), 300) or "no reason stated"
