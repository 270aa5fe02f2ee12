"""Serve the labelling page on this machine; hold the photos of a folder and their labelled areas."""

import json
import secrets
import threading
import webbrowser
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from http import HTTPStatus
from importlib.resources import files
from io import BytesIO
from pathlib import Path
from typing import Any, Literal

import numpy as np
from PIL import Image
from pydantic import Field

from ltm_core.base.errors import ConfigError, LtmError
from ltm_core.base.strict_model import StrictModel
from ltm_core.pictures import to_jpeg
from ltm_core.storage.config_io import checked
from ltm_core.storage.image_io import orientation, photos_in, read_picture, read_rgb, stated_size
from ltm_core.vision.areas import (
    ERASED,
    MASKED,
    POLYGONS_FILE,
    NamedArea,
    areas_of,
    labels_of,
    read_areas,
    replace_file,
    stroke_areas,
    write_areas,
)
from ltm_core.vision.labels import LabelSet
from ltm_core.vision.mask_config import MOST_POINTS, Point
from ltm_core.vision.overlays import scene_of
from ltm_core.vision.segmenter import Segmenter
from ltm_ros.runtime.web_server import Route, WebResponse, WebServer

MOST_SHAPES = 5000


class _Polygon(StrictModel):
    kind: Literal["polygon"] = "polygon"
    name: str = Field(max_length=80)
    points: tuple[Point, ...] = Field(min_length=3, max_length=MOST_POINTS)


class _Stroke(StrictModel):
    kind: Literal["stroke"] = "stroke"
    name: str = Field(max_length=80)
    points: tuple[Point, ...] = Field(min_length=1, max_length=20_000)
    radius: float = Field(gt=0, le=2000)


class _Shapes(StrictModel):
    shapes: tuple[_Polygon | _Stroke, ...] = Field(max_length=MOST_SHAPES)


class LabelSession:
    """The labels of one folder. Photos are identified only by number, so that no name from a page becomes a path.
    Thread-safe. Raises ImageError if there are no photos, ConfigError for photos whose label images would have the
    same name, and for an invalid polygons.json."""

    def __init__(self, folder: Path, segmenter: Segmenter | None = None) -> None:
        self.folder = folder
        self._paths = photos_in(folder)
        if twice := [stem for stem, count in Counter(path.stem for path in self._paths).items() if count > 1]:
            raise ConfigError(f"{folder}: several photos are named {twice[0]}, and would share {twice[0]}_labels.png")
        self.labels = LabelSet.load() if segmenter is None else segmenter.labels
        self._segmenter = segmenter
        self._lock = threading.Lock()
        file = folder / POLYGONS_FILE
        self._areas: list[NamedArea] = list(read_areas(file)) if file.exists() else []

    def __len__(self) -> int:
        return len(self._paths)

    def overview(self) -> dict[str, Any]:
        """Return JSON-ready: photos with their number of areas, classes with colours, whether there is a network."""
        with self._lock:
            counts = [sum(area.image == path.name for area in self._areas) for path in self._paths]
        named = *zip(self.labels.names, self.labels.colors, strict=True), (MASKED, (20, 20, 24))
        return {
            "folder": self.folder.resolve().name,
            "photos": [{"name": path.name, "areas": count} for path, count in zip(self._paths, counts, strict=True)],
            "classes": [{"name": name, "color": list(color)} for name, color in named],
            "erased": ERASED,
            "network": self._segmenter is not None,
        }

    def photo(self, number: int) -> bytes:
        """Return a photo as JPEG, upright. Raises ConfigError for an invalid number, ImageError."""
        return to_jpeg(read_rgb(self._path(number)), quality=92)

    def areas(self, number: int) -> list[dict[str, Any]]:
        """Return the areas in the page's format and order."""
        name = self._path(number).name
        with self._lock:
            return _shapes([area for area in self._areas if area.image == name])

    def suggested(self, number: int) -> list[dict[str, Any]]:
        """Return the network's areas. Raises ConfigError without a network."""
        path = self._path(number)
        if self._segmenter is None:
            raise ConfigError("no network: start `ltm label` without --model none")
        with self._lock:
            found = self._segmenter.segment(scene_of(read_rgb(path)))
        return _shapes(areas_of(path.name, found.labels, self.labels.names))

    def save(self, number: int, content: object) -> list[dict[str, Any]]:
        """Write polygons.json and NAME_labels.png; return the stored areas, strokes as outlines. Raises ConfigError for
        another format, and for unknown classes."""
        path = self._path(number)
        shapes = checked(_Shapes, content, "areas").shapes
        known = {*self.labels.names, MASKED, ERASED}
        if unknown := sorted({shape.name for shape in shapes} - known):
            raise ConfigError(f"unknown class {unknown[0]!r}; classes: {', '.join(sorted(known))}")
        data = read_picture(path)
        width, height = stated_size(data, str(path))
        if orientation(data, path) in (5, 6, 7, 8):
            width, height = height, width
        areas: list[NamedArea] = []
        for shape in shapes:
            if isinstance(shape, _Stroke):
                areas += stroke_areas(path.name, shape.name, shape.points, shape.radius, height, width)
            else:
                areas.append(NamedArea(image=path.name, kind=shape.name, polygon=shape.points))
        png = BytesIO()
        Image.fromarray(labels_of(areas, height, width, self.labels)).save(png, "PNG", optimize=True)
        with self._lock:
            self._areas = [area for area in self._areas if area.image != path.name] + areas
            write_areas(self.folder / POLYGONS_FILE, self._areas)
            replace_file(self.folder / f"{path.stem}_labels.png", png.getvalue())
        return _shapes(areas)

    def _path(self, number: int) -> Path:
        if not 0 <= number < len(self._paths):
            raise ConfigError(f"there is no photo {number}; there are {len(self._paths)}")
        return self._paths[number]


def _shapes(areas: Sequence[NamedArea]) -> list[dict[str, Any]]:
    return [{"kind": "polygon", "name": area.kind, "points": np.array(area.polygon).tolist()} for area in areas]


MOST_BYTES = 8 << 20
"""Size limit of a request."""
REQUEST_S = 600.0
"""Time limit of a request: on a slow machine the network needs a while for a large photo."""


class PageServer(WebServer):
    """Serve a page and its data on the loopback interface; its `url` holds a random token. `page`: HTML in which NONCE
    marks its own script and style. `answers`: by method and path below the page, as "GET photos", what returns a JPEG
    or a value to send as JSON; for PUT, given the value of the JSON that was received. `tiles`: origin of a map that
    the page may load images from, such as https://tiles.example; "": none."""

    def __init__(self, page: str, answers: Mapping[str, Callable[..., Any]], port: int = 0, tiles: str = "") -> None:
        root = f"/{secrets.token_urlsafe(24)}/"
        rooted = {name.replace(" ", f" {root}", 1): _route(name, answer) for name, answer in answers.items()}
        rooted[f"GET {root}"] = lambda _: _page(page, tiles)
        super().__init__(rooted, port=port, body_bytes=MOST_BYTES, request_s=REQUEST_S)
        self.url += root


class LabelServer(PageServer):
    """Serve a folder's photos and their areas."""

    def __init__(self, session: LabelSession, port: int = 0) -> None:
        answers: dict[str, Callable[..., Any]] = {"GET photos": session.overview}
        for number in range(len(session)):
            answers[f"GET photo/{number}"] = partial(session.photo, number)
            answers[f"GET areas/{number}"] = partial(session.areas, number)
            answers[f"GET suggested/{number}"] = partial(session.suggested, number)
            answers[f"PUT areas/{number}"] = partial(session.save, number)
        super().__init__(files("ltm_ros.labelling").joinpath("page.html").read_text("utf-8"), answers, port)


def serve(make: Callable[[int], PageServer], port: int, browser: bool) -> None:
    """Serve a page until Ctrl-C. Raises ConfigError if the port cannot be used."""
    try:
        server = make(port)
    except OSError as error:
        raise ConfigError(f"--port {port}: cannot be used ({error.strerror}); 0 takes a free one") from error
    print(f"{server.url}\nCtrl-C ends it", flush=True)
    if browser:
        webbrowser.open(server.url)
    try:
        threading.Event().wait()
    except KeyboardInterrupt:
        print("ended")
    finally:
        server.close()


def _route(name: str, answer: Callable[..., Any]) -> Route:
    def respond(body: bytes) -> WebResponse:
        try:
            value = answer(json.loads(body)) if name.startswith("PUT ") else answer()
            return WebResponse(value, "image/jpeg") if isinstance(value, bytes) else WebResponse.json(value)
        except (LtmError, json.JSONDecodeError, UnicodeDecodeError, RecursionError) as error:
            return WebResponse.error(HTTPStatus.BAD_REQUEST, str(error))
        except OSError as error:
            return WebResponse.error(HTTPStatus.INSUFFICIENT_STORAGE, f"cannot be written: {error.strerror}")

    return respond


def _page(page: str, tiles: str) -> WebResponse:
    nonce = secrets.token_urlsafe(16)
    policy = (
        f"default-src 'none'; script-src 'nonce-{nonce}'; style-src 'nonce-{nonce}'; img-src 'self' data: {tiles}; "
        "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )
    return WebResponse(page.replace("NONCE", nonce).encode(), "text/html; charset=utf-8", policy=policy)
