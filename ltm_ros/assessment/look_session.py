"""Hold the sampled cells of a plan for the page on which an interpreter names what grows there."""

import threading
from collections.abc import Callable
from datetime import UTC, datetime
from functools import lru_cache, partial
from importlib.resources import files
from pathlib import Path
from typing import Any, Final
from urllib.parse import urlsplit

import numpy as np
from pydantic import Field

from ltm_core.base.errors import ConfigError
from ltm_core.base.strict_model import StrictModel, problem_text
from ltm_core.base.types import UInt8Array
from ltm_core.fuel.life_form import life_form_labels
from ltm_core.pictures import to_jpeg
from ltm_core.pictures.maps import relief, view_of
from ltm_core.raster.dem import Dem
from ltm_core.raster.raster_io import open_raster
from ltm_core.site.site import Site
from ltm_core.storage.config_io import checked
from ltm_core.vision.labels import LabelSet
from ltm_ros.assessment.answers_io import FORM_NAMES, Answer, Certainty, Plan, SampledCell, read_answers, write_answers
from ltm_ros.assessment.cell_photos import PHOTOS, CellPhoto, PhotoIndex
from ltm_ros.labelling.server import PageServer

KEYS: Final = dict(zip("gstbwux", FORM_NAMES, strict=True))
"""Keys of the life forms."""
_MAP_M, _IMAGERY_M, _PIXELS = 3000.0, 400.0, 640
"""Sides of the map and of the orthophoto on the ground, metres, and in pixels."""
_KEPT_CELLS = 4


class _Given(StrictModel):
    life_form: str = Field("", max_length=20)
    certainty: Certainty
    seconds: float


class LookSession:
    """The cells of a plan and one interpreter's answers. The page identifies cells only by their place in the plan.
    `imagery`: GeoTIFF, or URL of map tiles with {z}, {x}, {y}, which the browser loads; "": none. The map's own answer
    is not read. Thread-safe. Raises ConfigError for an invalid name, file or URL."""

    def __init__(self, plan: Plan, site: Site, photos: PhotoIndex, interpreter: str, imagery: str = "") -> None:
        self._plan, self._file = plan, plan.answers_file(interpreter)
        self.interpreter = interpreter
        answers = read_answers(self._file) if self._file.exists() else []
        self._answers = {answer.cell: answer for answer in answers}
        self.tiles = _tiles(imagery)
        self._orthophoto = None if self.tiles or not imagery else Path(imagery)
        if self._orthophoto is not None:
            _orthophoto(self._orthophoto, plan.cells[0], plan.crs)
        dem = site.open_dem()
        self._dem, self._origin = Dem(dem.elevation, dem.geometry), site.origin
        self._labels = life_form_labels(LabelSet.load())
        self._lock = threading.RLock()
        self._best = lru_cache(_KEPT_CELLS)(lambda number: photos.best(plan.cells[number], plan.cell_m))

    def __len__(self) -> int:
        return len(self._plan.cells)

    def overview(self) -> dict[str, Any]:
        """Return JSON-ready: the life forms with keys and colours, and the answers given until now."""
        colors = dict(zip(self._labels.names, self._labels.colors, strict=True))
        with self._lock:
            answers = [self._shape(self._answers.get(cell.cell)) for cell in self._plan.cells]
        return {
            "interpreter": self.interpreter,
            "forms": [{"key": key, "name": name, "color": list(colors[name])} for key, name in KEYS.items()],
            "answers": answers,
            "orthophoto": self._orthophoto is not None,
            "orthophoto_m": _IMAGERY_M,
            "tiles": self.tiles,
        }

    def cell(self, number: int) -> dict[str, Any]:
        """Return JSON-ready: where a cell is, its outline in its photos and on the map (shares of its side)."""
        cell = self._plan.cells[number]
        x, y = cell.x - self._origin[0], cell.y - self._origin[1]
        photos = []
        for photo in self._photos_of(number):
            east, north = (photo.pose.position[:2] - (x, y)) / _MAP_M
            taken = datetime.fromtimestamp(photo.stamp_ns // 10**9, UTC)
            photos.append(
                {
                    "camera": photo.camera_name,
                    "time": f"{taken:%Y-%m-%d %H:%M} UTC",
                    "range_m": round(photo.range_m),
                    "outline": photo.outline.round(1).tolist(),
                    "size": [photo.camera.width, photo.camera.height],
                    "from": [0.5 + float(east), 0.5 - float(north)],
                }
            )
        return {"lon": cell.lon, "lat": cell.lat, "cell_m": self._plan.cell_m, "map_m": _MAP_M, "photos": photos}

    def photo(self, number: int, place: int) -> bytes:
        """Return one of a cell's photos as JPEG. Raises ConfigError if it has fewer."""
        photos = self._photos_of(number)
        if place >= len(photos):
            raise ConfigError(f"cell {number} has {len(photos)} photos")
        return photos[place].jpeg

    def map(self, number: int) -> bytes:
        """Return the relief around a cell as JPEG."""
        cell = self._plan.cells[number]
        x, y, half = cell.x - self._origin[0], cell.y - self._origin[1], _MAP_M / 2
        return to_jpeg(relief(self._dem, view_of((x - half, y - half, x + half, y + half), _PIXELS)))

    def imagery(self, number: int) -> bytes:
        """Return the user's orthophoto around a cell as JPEG. Raises ConfigError without one."""
        if self._orthophoto is None:
            raise ConfigError("no orthophoto: start `ltm assess look` with --imagery FILE")
        return to_jpeg(_orthophoto(self._orthophoto, self._plan.cells[number], self._plan.crs))

    def save(self, number: int, content: object) -> dict[str, Any] | None:
        """Write an answer to the interpreter's file at once. Raises ConfigError for an invalid one, OSError."""
        given = checked(_Given, content, "answer")
        cell, now = self._plan.cells[number].cell, datetime.now(UTC).isoformat(timespec="seconds")
        try:
            answer = Answer(cell, given.life_form, given.certainty, round(given.seconds, 1), now)
        except ValueError as error:
            raise ConfigError(problem_text(error)) from error
        with self._lock:
            answers = self._answers | {cell: answer}
            write_answers(self._file, answers.values())
            self._answers = answers
        return self._shape(answer)

    def _photos_of(self, number: int) -> list[CellPhoto]:
        with self._lock:
            return self._best(number)

    @staticmethod
    def _shape(answer: Answer | None) -> dict[str, Any] | None:
        return None if answer is None else {"life_form": answer.life_form, "certainty": answer.certainty}


class LookServer(PageServer):
    """Serve the page of a session."""

    def __init__(self, session: LookSession, port: int = 0) -> None:
        answers: dict[str, Callable[..., Any]] = {"GET cells": session.overview}
        for number in range(len(session)):
            answers[f"GET cell/{number}"] = partial(session.cell, number)
            answers[f"GET map/{number}"] = partial(session.map, number)
            answers[f"GET imagery/{number}"] = partial(session.imagery, number)
            answers[f"PUT answer/{number}"] = partial(session.save, number)
            for place in range(PHOTOS):
                answers[f"GET photo/{number}/{place}"] = partial(session.photo, number, place)
        page = files("ltm_ros.assessment").joinpath("look.html").read_text("utf-8")
        parts = urlsplit(session.tiles)
        super().__init__(page, answers, port, f"{parts.scheme}://{parts.netloc}" if session.tiles else "")


def _tiles(imagery: str) -> str:
    """Return the URL of map tiles with {z}, {x}, {y}; "": it is none. Raises ConfigError for a URL without them."""
    if not imagery.startswith(("http://", "https://")):
        return ""
    url = imagery
    for wmts, xyz in (("{TileMatrix}", "{z}"), ("{TileCol}", "{x}"), ("{TileRow}", "{y}")):
        url = url.replace(wmts, xyz)
    host = urlsplit(url).netloc
    if not all(part in url for part in ("{z}", "{x}", "{y}")) or not host or set(host) & set(" ;,'\"{}@"):
        raise ConfigError(
            f"--imagery {imagery}: give the URL of Web Mercator tiles, such as https://HOST/{{z}}/{{x}}/{{y}}.png"
        )
    return url


def _orthophoto(path: Path, cell: SampledCell, crs: str) -> UInt8Array:
    """Return the part of a GeoTIFF around a cell (P, P, 3); black outside. Raises RasterError, ConfigError for another
    file."""
    from rasterio.enums import Resampling
    from rasterio.transform import from_bounds
    from rasterio.vrt import WarpedVRT

    half = _IMAGERY_M / 2
    transform = from_bounds(cell.x - half, cell.y - half, cell.x + half, cell.y + half, _PIXELS, _PIXELS)
    size = {"width": _PIXELS, "height": _PIXELS, "resampling": Resampling.bilinear}
    with open_raster(path) as source:
        if source.crs is None or set(source.dtypes) != {"uint8"}:
            raise ConfigError(f"--imagery {path}: expected a georeferenced image of 8 bits; convert it with GDAL")
        bands = (1, 2, 3) if source.count >= 3 else (1, 1, 1)
        with WarpedVRT(source, crs=crs, transform=transform, **size) as warped:
            return np.ascontiguousarray(np.moveaxis(warped.read(bands), 0, -1), np.uint8)
