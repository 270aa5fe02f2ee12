"""The interface of data sources, and the sources that are Cloud Optimized GeoTIFFs: tiles, The National Map, STAC."""

import math
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from ltm_core.base.errors import RasterError
from ltm_core.base.redaction import plain, redacted
from ltm_core.base.types import BoolArray
from ltm_core.raster.dem import Bounds
from ltm_core.raster.raster_io import open_raster, read_band
from ltm_ros.site_setup.rasters import MOST_CELLS
from ltm_ros.site_setup.request import Area, Fetched, FetchError, NoCoverageError, Part, Plan, Progress, SourceConfig
from ltm_ros.site_setup.web import Web, check_room, in_words, put_into
from ltm_ros.site_setup.windows import fetch_window, plan_window

_PAGE = 100
_MOST_ITEMS = 1000
"""Maximum number of items of a catalogue for an area."""
_OLD_YEARS = 3
"""Age up to which a fuel map is used without a remark."""
_ALMOST_ALL = 0.99
"""Share of an area from which it counts as covered."""


@dataclass(frozen=True)
class Item:
    """A file of a catalogue. `box`: where it lies, if known; `tile`: see `Part`; `date`: ISO 8601, empty if unknown."""

    url: str
    name: str
    tile: str = ""
    box: Bounds | None = None
    date: str = ""


class Source:
    """A data set of a service. Subclasses say what there is (`_items`), or plan and fetch by themselves.

    `key_parameter`: requests for whole files pass the key as this one, which is kept out of plans and messages."""

    key_parameter = ""

    def __init__(self, name: str, config: SourceConfig, web: Web) -> None:
        self.name, self.config, self.web = name, config, web
        self.kinds, self.address, self.licence = config.kinds, config.address, config.licence
        self.resolution_m, self.vertical_crs, self.year = config.resolution_m, config.vertical_crs, config.year

    @property
    def key(self) -> str:
        """Return the key of the service from the environment; empty if it is not set."""
        return os.environ.get(self.config.key, "").strip() if self.config.key else ""

    def plan(self, area: Area) -> Plan:
        """Return what would be fetched, with sizes. May query the service.

        Raises NoCoverageError if the source cannot be used for the area, FetchError if the service fails."""
        self._check(area)
        plan = self._planned(area)
        age = 0 if plan.year is None else datetime.now(UTC).year - plan.year
        if "fuel" not in self.kinds or age <= _OLD_YEARS:
            return plan
        old = f"{self.name}: the fuel map shows {plan.year}, {age} years ago; fires since then are missing"
        return replace(plan, notes=(*plan.notes, old))

    def _check(self, area: Area) -> None:
        """Raise NoCoverageError if the configuration excludes an area, or a key is missing."""
        width, height = area.size_m
        west, south, east, north = area.bounds_lonlat
        # The cells of web maps shrink towards the poles.
        cell = self.resolution_m * (math.cos(math.radians((south + north) / 2)) if self.config.quadkey_zoom else 1.0)
        cells, km2 = width * height / cell**2, width * height / 1e6
        reason = ""
        if not any(w <= west and s <= south and east <= e and north <= n for w, s, e, n in self.config.coverage):
            reason = "the area is not within its coverage"
        elif cells > MOST_CELLS:
            reason = f"{cells / 1e6:.0f} million cells of {cell:.3g} m, at most {MOST_CELLS / 1e6:.0f} million"
        elif km2 > self.config.most_km2:
            reason = f"the area has {km2:.0f} km2, at most {self.config.most_km2:.0f} are delivered"
        elif self.config.key and not self.key:
            reason = f"the environment variable {self.config.key} is not set (get a key: {self.config.key_from})"
        if reason:
            raise NoCoverageError(reason)

    def fetch(self, plan: Plan, folder: Path, progress: Progress) -> Fetched:
        """Fetch a plan into `folder`; files appear there whole or not at all, and what is finished stays in the cache.

        A later part of the same tile is fetched only if the former ones have unknown cells. Raises NoCoverageError if
        every cell turns out to be unknown, as beyond a border; FetchError."""
        files, used, done, total = [], [], 0, plan.expected_bytes

        def advance(read: int, _: int) -> None:
            progress(done + read, total)

        check_room(self.web.cache, total)
        lacking: dict[str, BoolArray] = {}  # cells by tile
        for part in plan.parts:
            before = lacking.get(part.tile)
            if before is None or before.any():
                path, unknown = self._file(part, advance)
                if not unknown.all():
                    files.append(put_into(folder, path, part.name))
                    used.append(part)
                if before is not None and before.shape == unknown.shape:
                    unknown = unknown & before
                if part.tile:
                    lacking[part.tile] = unknown
            done += part.expected_bytes
            progress(done, total)
        if not files:
            raise NoCoverageError("every cell is unknown (sea, or outside the survey); choose another source")
        return self._fetched(plan, files, used)

    def _file(self, part: Part, progress: Progress) -> tuple[Path, BoolArray]:
        """Return the file of a part in the cache, and which of its cells are unknown. Raises FetchError."""
        if part.remote is not None and part.window is not None:
            tags = {"SOURCE": self.name, "LICENCE": self.licence}
            path = fetch_window(part.remote, part.window, self.web, progress, self.config.nodata, tags)
        else:
            secret = {self.key_parameter: self.key} if self.key_parameter else {}
            most, sha256 = 4 * part.expected_bytes, self.config.sha256
            path = self.web.download(part.url, progress, secret, remote=part.remote, sha256=sha256, most=most)
        try:
            with open_raster(path, driver="GTiff") as source:
                return path, read_band(source, 1)[1]
        except RasterError as error:
            with path.open("rb") as file:
                said = in_words(file.read(600))
            path.unlink()
            raise FetchError(f"{redacted(part.url)}: not a GeoTIFF ({said}); check the request") from error

    def _fetched(self, plan: Plan, files: list[Path], used: list[Part]) -> Fetched:
        urls = tuple(redacted(part.url) for part in used)
        about = self.name, self.licence, self.vertical_crs, plan.year, urls, self.config.above_ground
        return Fetched(tuple(files), *about)

    def _planned(self, area: Area) -> Plan:
        wide = area.padded(4 * self.resolution_m)
        items = sorted(self._items(wide), key=lambda item: item.date, reverse=True)
        if not items:
            raise NoCoverageError(f"{self.name} has no file for {area}")
        boxes = [item.box for item in items if item.box is not None]
        if len(boxes) == len(items) and (share := _share_covered(area, boxes)) < _ALMOST_ALL:
            raise NoCoverageError(f"{self.name} covers {share:.0%} of the area")
        parts: list[Part] = []
        for item in items:
            remote = self.web.remote(item.url)
            taken = any(part.name == item.name for part in parts)  # items in folders of their own may have one name
            name = f"{len(parts)}_{item.name}" if taken else item.name
            part = None if remote is None else plan_window(remote, area, name, item.tile, self.web)
            if part is not None:
                parts.append(part)
        if not parts:
            raise NoCoverageError(f"{self.name} has no file for {area}: sea, or outside the survey")
        missing = len(items) - len(parts) if not boxes else 0
        notes = [f"{self.name}: {missing} of {len(items)} tiles do not exist (sea)"] if missing else []
        years = [int(item.date[:4]) for item in items if re.match(r"\d{4}", item.date)]
        return Plan(area, tuple(parts), tuple(notes), self.year or max(years, default=None))

    def _items(self, area: Area) -> Iterator[Item]:
        """Return the files that may show an area. Raises FetchError."""
        raise NotImplementedError


class TileSource(Source):
    """Tiles of whole degrees, or of web maps, whose addresses follow from their places."""

    def _items(self, area: Area) -> Iterator[Item]:
        west, south, east, north = area.bounds_lonlat
        if self.config.quadkey_zoom:
            zoom = self.config.quadkey_zoom
            (left, top), (right, bottom) = _web_tile(west, north, zoom), _web_tile(east, south, zoom)
            names = [
                {"quadkey": "".join(str((x >> bit & 1) + 2 * (y >> bit & 1)) for bit in reversed(range(zoom)))}
                for y in range(top, bottom + 1)
                for x in range(left, right + 1)
            ]
        else:
            step = self.config.tile_degrees
            names = [
                _degree_names(column * step, row * step, step)
                for row in range(math.floor(south / step), math.ceil(north / step))
                for column in range(math.floor(west / step), math.ceil(east / step))
            ]
        for name in names:
            place = name.get("quadkey") or name["SOUTH"] + name["WEST"]
            yield Item(filled(self.address, name), f"{self.name}_{place}.tif")


class NationalMapSource(Source):
    """Files that the products API of The National Map lists."""

    def _items(self, area: Area) -> Iterator[Item]:
        query = {
            "datasets": self.config.collection, "bbox": _joined(area), "prodFormats": "GeoTIFF", "outputFormat": "JSON",
            "max": str(_PAGE),
        }  # fmt: skip
        for first in range(0, _MOST_ITEMS, _PAGE):
            items = list_in(self.web.json(self.address, {**query, "offset": str(first)}), "items", self.name)
            yield from (item for item in map(self._item, items) if item is not None)
            if len(items) < _PAGE:
                return

    def _item(self, about: Any) -> Item | None:
        try:
            url, box = str(about["downloadURL"]), about["boundingBox"]
            bounds = (float(box["minX"]), float(box["minY"]), float(box["maxX"]), float(box["maxY"]))
            date = str(about.get("publicationDate") or about.get("dateCreated") or "")
        except (KeyError, TypeError, ValueError):
            return None
        if not re.fullmatch(r"https?://[^\s?]+\.tiff?", url, re.IGNORECASE):
            return None
        tile = re.search(r"x\d+y\d+", url.rpartition("/")[2])
        return Item(url, _file_name(url), tile[0] if tile else "", bounds, date)


class StacSource(Source):
    """Assets of the items of a collection, from any STAC API."""

    def _items(self, area: Area) -> Iterator[Item]:
        query = {"collections": self.config.collection, "bbox": _joined(area), "limit": str(_PAGE)}
        url, params = f"{self.address.rstrip('/')}/search", query
        seen = 0
        while url:
            answer = self.web.json(url, params)
            features = list_in(answer, "features", self.name)
            yield from (item for item in map(self._item, features) if item is not None)
            seen += len(features)
            links = [link for link in answer.get("links", []) if link.get("rel") == "next"]
            further = links and links[0].get("method", "GET") == "GET" and features and seen < _MOST_ITEMS
            url, params = (str(links[0]["href"]), {}) if further else ("", {})

    def _item(self, about: Any) -> Item | None:
        try:
            href, box = str(about["assets"][self.config.asset]["href"]), about["bbox"]
            bounds = (float(box[0]), float(box[1]), float(box[len(box) // 2]), float(box[len(box) // 2 + 1]))
        except (KeyError, TypeError, ValueError, IndexError):
            return None
        bucket = re.fullmatch(r"s3://([a-z0-9.-]+)/(.+)", href)
        url = f"https://{bucket[1]}.s3.amazonaws.com/{bucket[2]}" if bucket else href
        if not re.match(r"https?://", url):
            return None
        date = str((about.get("properties") or {}).get("datetime") or "")
        return Item(url, _file_name(url), ",".join(f"{v:.3f}" for v in bounds), bounds, date)


class UrlSource(Source):
    """One GeoTIFF at a fixed address. With a checksum it is downloaded whole, because a window has none."""

    def _items(self, area: Area) -> Iterator[Item]:
        yield Item(self.address, _file_name(self.address))

    def _planned(self, area: Area) -> Plan:
        if not self.config.sha256:
            return super()._planned(area)
        remote = self.web.remote(self.address)
        if remote is None:
            raise NoCoverageError(f"{redacted(self.address)}: no such file")
        part = Part(remote.url, _file_name(self.address), remote.size, remote)
        return Plan(area, (part,), (), self.year)


def list_in(answer: Any, key: str, name: str) -> list[Any]:
    """Return the list below a key of a JSON answer. Raises FetchError if the service `name` answered otherwise."""
    values = answer.get(key) if isinstance(answer, dict) else None
    if not isinstance(values, list):
        raise FetchError(f"{name}: no {key} in the answer ({plain(str(answer), 200)}); try again later")
    return values


def filled(template: str, names: dict[str, str]) -> str:
    """Return an address with its placeholders filled in. Raises FetchError for one that has no value."""
    text = re.sub(r"\{(\w+)\}", lambda found: names.get(found[1], found[0]), template)
    if "{" in text:
        raise FetchError(f"{template}: unknown placeholder; known: {', '.join(f'{{{name}}}' for name in names)}")
    return text


def _degree_names(west: float, south: float, step: float) -> dict[str, str]:
    names: dict[str, str] = {}
    for name, value, digits, letters in (
        ("south", south, 2, "NS"), ("north", south + step, 2, "NS"), ("west", west, 3, "EW"),
    ):  # fmt: skip
        text = f"{letters[value < 0]}{abs(round(value)):0{digits}d}"
        names |= {name: text.lower(), name.upper(): text}
    return names


def _web_tile(lon: float, lat: float, zoom: int) -> tuple[int, int]:
    """Return column and row of the web map tile at a place."""
    across = 2**zoom
    sine = math.sin(math.radians(max(-85.05, min(lat, 85.05))))
    x, y = (lon + 180) / 360, 0.5 - math.log((1 + sine) / (1 - sine)) / (4 * math.pi)
    return min(int(x * across), across - 1), min(int(y * across), across - 1)


def _joined(area: Area) -> str:
    return ",".join(f"{value:.6f}" for value in area.bounds_lonlat)


def _file_name(url: str) -> str:
    """Return a safe file name for what a URL delivers."""
    name = re.sub(r"[^A-Za-z0-9._-]", "_", url.partition("?")[0].rstrip("/").rpartition("/")[2]).lstrip(".")
    return f"{name.rpartition('.tif')[0] or name or 'file'}.tif"


def _share_covered(area: Area, boxes: list[Bounds]) -> float:
    """Return the share of an area that lies in any of some boxes, at 40 x 40 points."""
    west, south, east, north = area.bounds_lonlat
    within = (np.arange(40) + 0.5) / 40
    x, y = np.meshgrid(west + within * (east - west), south + within * (north - south))
    return float(np.logical_or.reduce([(w <= x) & (x <= e) & (s <= y) & (y <= n) for w, s, e, n in boxes]).mean())
