"""The web services of `ltm init` on loopback, with the protocols of the real ones: GeoTIFF tiles by range requests, the
products API of The National Map, a STAC API, OpenTopography, LANDFIRE's product service and a WCS 2.0."""

import hashlib
import io
import json
import math
import re
import threading
import time
import zipfile
from collections.abc import Callable, Mapping, Sequence
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import numpy as np
import rasterio
import yaml
from numpy.typing import NDArray
from rasterio.io import MemoryFile
from rasterio.transform import from_origin
from rasterio.warp import transform_bounds

from ltm_ros.site_setup.request import Area
from ltm_ros.site_setup.source import Source
from ltm_ros.site_setup.sources import load_sources
from ltm_ros.site_setup.web import Web

Formula = Callable[[NDArray[Any], NDArray[Any]], NDArray[Any]]
"""Values at the cell centres x, y in the raster's CRS."""
KEY = "0123456789abcdef"
LAYERS = ("FBFM40", "FBFM13", "CC", "CH", "CBH", "CBD")
_ADDRESSES = {
    "usgs_3dep_1m": "/tnm/products",
    "usgs_3dep_10m": "/cog/USGS_13_{north}{west}.tif",
    "usgs_3dep_10m_hawaii": "/cog/USGS_13_{north}{west}.tif",
    "copernicus_glo30": "/cog/GLO30_{SOUTH}_00_{WEST}.tif",
    "opentopography_cop30": "/ot/globaldem?demtype=COP30",
    "earth_search_glo30": "/stac",
    "meta_canopy_1m": "/cog/chm_{quadkey}.tif",
    "eth_canopy_10m": "/cog/ETH_{SOUTH}{WEST}.tif",
    "landfire": "/lfps",
    "landfire_wcs": "/wcs/conus_{year}#landfire_wcs__LF{year}_{layer}_CONUS",
    "landfire_wcs_alaska": "/wcs/ak_{year}#landfire_wcs__LF{year}_{layer}_AK",
    "landfire_wcs_hawaii": "/wcs/hi_{year}#landfire_wcs__LF{year}_{layer}_HI",
}


def area_around(lon: float, lat: float, radius: float) -> Area:
    """Return the area of a circle; `radius` in metres."""
    up = radius / 110_574.0
    side = up / math.cos(math.radians(abs(lat) + up))
    return Area((lon - side, lat - up, lon + side, lat + up))


def geotiff(
    values: NDArray[Any], crs: str, west: float, north: float, step: float, *, nodata: float | None = None,
    names: Sequence[str] = (), block: int = 128,
) -> bytes:  # fmt: skip
    """Return the bytes of a tiled, deflated GeoTIFF of an (H, W) or (bands, H, W) array."""
    bands = values if values.ndim == 3 else values[None]
    with MemoryFile() as memory:
        with memory.open(
            driver="GTiff", count=len(bands), height=bands.shape[1], width=bands.shape[2], dtype=bands.dtype, crs=crs,
            transform=from_origin(west, north, step, step), nodata=nodata, tiled=True, blockxsize=block,
            blockysize=block, compress="deflate", interleave="band",
        ) as sink:  # fmt: skip
            sink.write(bands)
            for band, name in enumerate(names, start=1):
                sink.set_band_description(band, name)
        return bytes(memory.getbuffer())


def grid(west: float, north: float, step: float, width: int, height: int) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return x and y of the cell centres, (H, W)."""
    x, y = west + (np.arange(width) + 0.5) * step, north - (np.arange(height) + 0.5) * step
    return np.meshgrid(x, y)


class _QuietServer(ThreadingHTTPServer):
    daemon_threads = True

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Clients that hang up are usual."""


class SiteServices:
    """All services on one port of loopback. What a test sets is how they behave."""

    def __init__(self) -> None:
        self.files: dict[str, bytes] = {}
        """Content by path, such as `/cog/USGS_13_n35w119.tif`."""
        self.products: list[dict[str, Any]] = []
        """Items of The National Map."""
        self.stac_items: list[dict[str, Any]] = []
        self.heights: Formula = lambda lon, lat: 1000.0 + 100.0 * (lon + 118.0) + 10.0 * (lat - 34.0)
        """OpenTopography's heights."""
        self.fuel_years = {2024: 1.0}
        """LANDFIRE's editions, and the share of the columns, from the west, that each one knows."""
        self.job_states = ["Pending", "Executing", "Succeeded"]
        self.statuses: dict[str, list[int]] = {}
        """Statuses of the next answers, by a part of the path; an empty list or no entry: 200."""
        self.cut: dict[str, int] = {}
        """How many answers end after half of the body, by a part of the path."""
        self.ranges = True
        self.stall_s = 0.0
        self.retry_after = ""
        self.requests: list[str] = []
        self.bytes_sent = 0
        self._polls: dict[str, int] = {}
        self._lock = threading.Lock()
        self._server = _QuietServer(("127.0.0.1", 0), _handler(self))
        self.url = f"http://127.0.0.1:{self._server.server_address[1]}"
        threading.Thread(target=self._server.serve_forever, args=(0.02,), daemon=True).start()

    def __enter__(self) -> "SiteServices":
        return self

    def __exit__(self, *_: object) -> None:
        self._server.shutdown()
        self._server.server_close()

    def sources(self, path: Path, **further: Mapping[str, Any]) -> Path:
        """Write a file of sources in which all shipped ones have their addresses here; `further` adds keys."""
        entries: dict[str, dict[str, Any]] = {name: {"address": self.url + at} for name, at in _ADDRESSES.items()}
        for name, keys in further.items():
            entries[name] = {**entries.get(name, {}), **keys}
        path.write_text(yaml.safe_dump({"sources": entries}, sort_keys=False))
        return path

    def loaded(self, folder: Path, timeout_s: float = 5.0, **further: Mapping[str, Any]) -> list[Source]:
        """Return the sources of `sources`, with a cache in a folder."""
        return load_sources(self.sources(folder / "own.yaml", **further), Web(folder / "cache", 0.01, timeout_s))

    def count(self, part: str) -> int:
        """Return the number of requests with `part` in their path."""
        return sum(part in request for request in self.requests)

    def add_product(self, name: str, content: bytes, date: str) -> None:
        """Add a file to The National Map's catalogue."""
        self.files[f"/cog/{name}"] = content
        with MemoryFile(content) as memory, memory.open() as source:
            west, south, east, north = transform_bounds(source.crs, "EPSG:4326", *source.bounds)
        self.products.append(
            {
                "downloadURL": f"{self.url}/cog/{name}",
                "publicationDate": date,
                "boundingBox": {"minX": west, "minY": south, "maxX": east, "maxY": north},
            }
        )

    def add_stac_item(self, name: str, content: bytes, date: str = "2021-04-22T00:00:00Z") -> None:
        """Add an item with one asset to the STAC collection."""
        self.files[f"/cog/{name}"] = content
        with MemoryFile(content) as memory, memory.open() as source:
            box = transform_bounds(source.crs, "EPSG:4326", *source.bounds)
        self.stac_items.append(
            {
                "type": "Feature",
                "id": name,
                "bbox": list(box),
                "properties": {"datetime": date},
                "assets": {"data": {"href": f"{self.url}/cog/{name}", "type": "image/tiff; profile=cloud-optimized"}},
            }
        )

    def answer(self, path: str, query: Mapping[str, str]) -> tuple[int, bytes, str]:
        """Return status, body and type of an answer."""
        if path in self.files:
            return 200, self.files[path], "image/tiff"
        if path == "/tnm/products":
            first, most = int(query["offset"]), int(query["max"])
            west, south, east, north = map(float, query["bbox"].split(","))
            hits = [
                item for item in self.products
                if (b := item["boundingBox"]) and b["minX"] < east and b["maxX"] > west
                and b["minY"] < north and b["maxY"] > south
            ]  # fmt: skip
            return _json(200, {"total": len(hits), "items": hits[first : first + most]})
        if path == "/stac/search":
            return self._stac(query)
        if path == "/ot/globaldem":
            return self._topography(query)
        if path.startswith("/lfps/"):
            return self._landfire(path.removeprefix("/lfps"), query)
        if path.startswith("/wcs/"):
            return self._coverage(query)
        return 404, b"<Error><Code>NoSuchKey</Code></Error>", "application/xml"

    def _stac(self, query: Mapping[str, str]) -> tuple[int, bytes, str]:
        page = int(query.get("page", "0"))  # one item a page
        link = {"rel": "next", "method": "GET", "href": f"{self.url}/stac/search?page={page + 1}"}
        more = page + 1 < len(self.stac_items)
        return _json(200, {"type": "FeatureCollection", "features": self.stac_items[page : page + 1],
                           "links": [link] if more else []})  # fmt: skip

    def _topography(self, query: Mapping[str, str]) -> tuple[int, bytes, str]:
        if query.get("API_Key") != KEY:
            return 401, b"<error>API Key Error: Please check your API key</error>", "application/xml"
        south, north, west, east = (float(query[name]) for name in ("south", "north", "west", "east"))
        if (north - south) * (east - west) > 20.0:
            text = "<error>\nError: The maximum area for COP30 is 450,000 km2. The selected area is larger\n</error>"
            return 400, text.encode(), "application/xml"
        step = 1 / 3600
        width, height = round((east - west) / step) + 1, round((north - south) / step) + 1
        heights = self.heights(*grid(west, north, step, width, height)).astype(np.float32)
        return 200, geotiff(heights, "EPSG:4326", west, north, step), "image/tiff"

    def fuel(self, bounds: Sequence[float], year: int, layers: Sequence[str]) -> bytes:
        """Return LANDFIRE's raster on its own grid (edges at 15 mod 30 m in EPSG:5070): codes are 101 to 109."""
        west, south = (15.0 + 30.0 * np.floor((v - 15.0) / 30.0) for v in bounds[:2])
        width, height = round((bounds[2] - west) / 30.0), round((bounds[3] - south) / 30.0)
        x, y = grid(west, south + 30.0 * height, 30.0, width, height)
        codes = (101 + (np.round(x / 30.0) + np.round(y / 30.0)) % 9).astype(np.int16)
        codes[:, round(self.fuel_years[year] * width) :] = 32767
        of_layer = {"FBFM40": codes, "CC": 10 * (codes - 101), "CH": 50 + 10 * (codes - 100)}
        bands = np.stack([of_layer.get(layer, codes - 100) for layer in layers])
        bands[:, codes == 32767] = 32767
        names = [f"LF{year}_{layer}_CONUS" for layer in layers]
        return geotiff(bands, "EPSG:5070", west, south + 30.0 * height, 30.0, nodata=32767, names=names)

    def _landfire(self, path: str, query: Mapping[str, str]) -> tuple[int, bytes, str]:
        if path == "/products":
            listed = [
                {"productName": layer, "theme": "Fuel", "layerName": f"LF{year}_{layer}", "acronym": layer,
                 "version": f"LF{year}", "conus": True, "ak": year < 2024, "hi": False, "geoAreas": "All"}
                for year in self.fuel_years for layer in (*LAYERS, "EVT")
            ]  # fmt: skip
            season = [{**some, "layerName": f"LF2025_{some['acronym']}_SP26", "version": "LF2025"} for some in listed]
            return _json(200, {"products": [*listed, *season]})
        if path == "/job/submit":
            if "@" not in query.get("Email", ""):
                return _json(400, {"message": "Email is required", "success": False})
            job = hashlib.sha256(json.dumps(dict(query)).encode()).hexdigest()[:12]
            self._polls[job] = 0
            bounds = [float(v) for v in query["Area_of_Interest"].split()]
            layers = query["Layer_List"].split(";")
            within = transform_bounds("EPSG:4326", "EPSG:5070", *bounds)
            raster = self.fuel(within, int(layers[0][2:6]), [n[7:] for n in layers])
            body = io.BytesIO()
            with zipfile.ZipFile(body, "w") as box:
                box.writestr("LF2024_metadata.xml", "<metadata/>")
                box.writestr(f"../j{job}.tif", raster)  # a client that trusts the name writes outside its folder
            self.files[f"/lfps/result/j{job}.zip"] = body.getvalue()
            return _json(200, {"jobId": job})
        if path == "/job/status":
            job = query["JobId"]
            if job not in self._polls:
                return _json(500, {"message": "JobId not found.", "success": False})
            state = self.job_states[min(self._polls[job], len(self.job_states) - 1)]
            self._polls[job] += 1
            said = [{"type": "esriJobMessageTypeError", "description": "ERROR 001: no data in this area"}]
            done = {"outputFile": f"{self.url}/lfps/result/j{job}.zip"} if state == "Succeeded" else {}
            return _json(200, {"jobId": job, "queuePosition": -1, "status": state, "messages": said, **done})
        return _json(404, {"message": "unknown", "success": False})

    def _coverage(self, query: Mapping[str, str]) -> tuple[int, bytes, str]:
        if query["request"] == "DescribeCoverage":
            text = """<wcs:CoverageDescriptions><wcs:CoverageDescription><gml:boundedBy>
              <gml:Envelope srsName="http://www.opengis.net/def/crs/EPSG/0/5070" axisLabels="X Y" uomLabels="m m"
              srsDimension="2"><gml:lowerCorner>-2362395 221265</gml:lowerCorner>
              <gml:upperCorner>2327655 3267405</gml:upperCorner></gml:Envelope></gml:boundedBy>
              <gml:domainSet><gml:RectifiedGrid dimension="2"><gml:origin><gml:Point srsName="EPSG:5070">
              <gml:pos>-2362380 3267390</gml:pos></gml:Point></gml:origin><gml:offsetVector>30.0 0.0</gml:offsetVector>
              <gml:offsetVector>0.0 -30.0</gml:offsetVector></gml:RectifiedGrid></gml:domainSet>
              </wcs:CoverageDescription></wcs:CoverageDescriptions>"""
            return 200, text.encode(), "application/xml"
        layer = re.fullmatch(r"landfire_wcs__LF(\d{4})_(\w+)_CONUS", query["coverageId"])
        if layer is None or int(layer[1]) not in self.fuel_years:
            text = "<ows:ExceptionReport><ows:ExceptionText>No such coverage</ows:ExceptionText></ows:ExceptionReport>"
            return 200, text.encode(), "application/xml"
        (west, east), (south, north) = (
            [float(v) for v in re.findall(r"-?[\d.]+", query[f"subset_{axis}"])] for axis in "XY"
        )
        return 200, self.fuel([west, south, east, north], int(layer[1]), [layer[2]]), "image/tiff"


def _json(status: int, value: object) -> tuple[int, bytes, str]:
    return status, json.dumps(value).encode(), "application/json"


def _handler(services: SiteServices) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_GET(self) -> None:
            parts = urlsplit(self.path)
            query = {key: values[0] for key, values in parse_qs(parts.query).items()}
            query |= {f"subset_{v[0]}": v[1:] for v in parse_qs(parts.query).get("subset", [])}
            with services._lock:
                services.requests.append(self.path)
                status = next((s.pop(0) for at, s in services.statuses.items() if at in self.path and s), 200)
                cut = next((at for at, left in services.cut.items() if at in self.path and left), None)
            time.sleep(services.stall_s)
            if status != 200:
                return self._send(status, b"<error>busy</error>", "application/xml")
            status, body, kind = services.answer(parts.path, query)
            return self._send(status, body, kind, cut, parts.path in services.files)

        def _send(self, status: int, body: bytes, kind: str, cut: str | None = None, is_file: bool = False) -> None:
            headers = {"Content-Type": kind}
            if services.retry_after and status in (429, 503):
                headers["Retry-After"] = services.retry_after
            if is_file and services.ranges:
                tag = f'"{hashlib.sha256(body).hexdigest()[:16]}"'
                headers |= {"ETag": tag, "Accept-Ranges": "bytes"}
                wanted = re.fullmatch(r"bytes=(\d+)-(\d*)", self.headers.get("Range", ""))
                if wanted and self.headers.get("If-Range", tag) == tag:
                    first, last = int(wanted[1]), min(int(wanted[2] or len(body) - 1), len(body) - 1)
                    headers["Content-Range"] = f"bytes {first}-{last}/{len(body)}"
                    status, body = 206, body[first : last + 1]
            headers["Content-Length"] = str(len(body))
            with services._lock:
                if cut is not None and len(body) > 1:
                    body, self.close_connection = body[: len(body) // 2], True
                    services.cut[cut] -= 1
                services.bytes_sent += len(body)
            self.send_response(status)
            for name, value in headers.items():
                self.send_header(name, value)
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_: object) -> None:
            pass

    return Handler


def opened(path: Path) -> tuple[NDArray[Any], Any]:
    """Return the first band of a file, and its metadata."""
    with rasterio.open(path) as source:
        return source.read(1), source


def silent(done: int, total: int) -> None:
    """Ignore the progress."""
