"""Pictures of locations: the posterior and its ellipses over shaded relief; places drawn over a camera's picture."""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from ltm_core.base.types import Float64Array, RgbImage
from ltm_core.geometry.grid import GridGeometry
from ltm_core.locating.locator import Ellipse, Posterior
from ltm_core.pictures.legend import INK, PAPER, Text, apart, draw_texts, ramp_legend, with_legend
from ltm_core.pictures.maps import (
    SHIFT,
    MapCamera,
    cells_under,
    finished,
    furnished,
    padded,
    relief,
    view_of,
    view_pixels,
)
from ltm_core.pictures.photo_overlays import panel, with_axes
from ltm_core.raster.dem import Dem
from ltm_core.visibility.point_visibility import PointState

_WIDTH = 760
_WHITE = (255, 255, 255)
_LEAST_VIEW = 300.0  # minimum width in metres of the detail map
_SQUARE = (0.7, 0.7)  # minimum width and height of a map, as a share of the other
_ALIKE = 0.5  # share of the whole map's width above which the detail map is left out
_HEAT = np.array([[255, 238, 160], [253, 174, 72], [226, 74, 51], [128, 8, 60]], np.float64)
_BLUE = (20, 60, 190)
STATE_COLORS = {
    PointState.VISIBLE: (50, 120, 225),
    PointState.HIDDEN: (245, 150, 30),
    PointState.UNKNOWN: (150, 150, 160),
    PointState.OUTSIDE: (150, 150, 160),
}


def location_picture(
    dem: Dem,
    posterior: Posterior,
    ellipses: Sequence[tuple[str, Ellipse]],
    cameras: Sequence[MapCamera],
    offset: tuple[float, float],
    heading: str,
) -> RgbImage:
    """Return the cameras with their lines of sight and the posterior, and beside it the posterior closely unless that
    shows much the same, (H, W, 3); all in the map frame. `ellipses`: with their names, smallest first. `offset`: of the
    map frame, for the axes."""
    dense = posterior.places[posterior.densest(0.99)]
    close = padded(np.concatenate([dense, ellipses[-1][1].outline()]), 0.12, _LEAST_VIEW, _SQUARE)
    places = [close[:2], close[2:], *(camera.position for camera in cameras)]
    whole = padded(np.array(places), 0.08, _LEAST_VIEW, _SQUARE)
    maps = [("Cameras, lines of sight and probability", whole), ("Probability and its ellipses", close)]
    if close[2] - close[0] > _ALIKE * (whole[2] - whole[0]):
        maps = maps[:1]
    drawn = []
    for title, bounds in maps:
        view = view_of(bounds, _WIDTH)
        picture = _heated(relief(dem, view), posterior, view)
        for camera in cameras:
            line = view_pixels(view, np.array([camera.position, posterior.mean]))
            for color, width in ((_WHITE, 3), (INK, 1)):
                cv2.polylines(picture, [line], False, color, width, cv2.LINE_AA, SHIFT)
        reach = 0.3 * (bounds[2] - bounds[0])
        x_min, y_min, x_max, y_max = bounds
        near = [c for c in cameras if x_min <= c.position[0] <= x_max and y_min <= c.position[1] <= y_max]
        picture = furnished(picture, view, [replace(camera, reach=reach) for camera in near])
        _draw(picture, view, ellipses, posterior.mean)
        if bounds == maps[-1][1]:
            picture = _named(picture, view, ellipses)
        drawn.append((title, finished(with_axes(picture, view, offset), view, _heat_legend())))
    return panel(drawn, columns=2, width=max(picture.shape[1] for _, picture in drawn), heading=heading)


def _heat_legend() -> RgbImage:
    """Return the colours by the probability of a cell and all that are more probable."""
    names = ("99 %", "90 %", "75 %", "50 %", "25 %")
    places = (0.01, 0.1, 0.25, 0.5, 0.75)
    text = "Probability that the place is in a cell of this or a darker colour"
    title = draw_texts(np.full((22, _WIDTH, 3), PAPER, np.uint8), [(text, 14, 14, "lm")], 14, INK)
    return with_legend(
        title, ramp_legend(_WIDTH, _heat_colors(np.linspace(0, 1, 256)), list(zip(names, places, strict=True)))
    )


def _heat_colors(heat: Float64Array) -> RgbImage:
    place = heat * (len(_HEAT) - 1)
    colors = [np.interp(place, np.arange(len(_HEAT)), _HEAT[:, channel]) for channel in range(3)]
    return np.stack(colors, axis=-1).astype(np.uint8)


def places_picture(photo: RgbImage, places: Sequence[tuple[str, tuple[float, float], PointState]]) -> RgbImage:
    """Return a photo with places of the map: blue seen, orange hidden by terrain, grey if unknown ground decides."""
    picture = photo.copy()
    size = max(13, round(photo.shape[1] / 80))
    line = max(1, size // 8)
    labels: list[Text] = []
    for name, (u, v), state in places:
        centre = round(u * 2**SHIFT), round(v * 2**SHIFT)
        for color, width in ((_WHITE, line + 2), (STATE_COLORS[state], line)):
            cv2.circle(picture, centre, (size // 2) << SHIFT, color, width, cv2.LINE_AA, SHIFT)
        labels.append((name, u + size * 0.8, v, "lm"))
    return draw_texts(picture, apart(labels, size, photo.shape[0]), size, INK, halo=PAPER)


def _heated(picture: RgbImage, posterior: Posterior, view: GridGeometry) -> RgbImage:
    """Return the cells coloured by the share of the probability in more probable ones, alike on every map."""
    before = np.concatenate([[0.0], np.cumsum(posterior.probability)[:-1]])
    chosen = before < 0.99
    cells = np.zeros(posterior.geometry.shape)
    cells[posterior.rows[chosen], posterior.cols[chosen]] = 1 - before[chosen]
    row, col, inside = cells_under(posterior.geometry, view)
    heat = np.where(inside, cells[row, col], 0.0)
    # Cells smaller than a pixel: the most probable shows.
    row, col = view.cell_of(*posterior.places[chosen].T)
    inside = view.contains(row, col)
    np.maximum.at(heat, (row[inside], col[inside]), (1 - before[chosen])[inside])
    shown = heat > 0
    mixed = np.clip(_heat_colors(heat) * (0.45 + 0.55 * picture / 255.0), 0, 255) * 0.75 + picture * 0.25
    return np.where(shown[..., None], mixed, picture).astype(np.uint8)


def _draw(
    picture: RgbImage, view: GridGeometry, ellipses: Sequence[tuple[str, Ellipse]], mean: tuple[float, float]
) -> None:
    for number, (_, ellipse) in enumerate(ellipses):
        points = view_pixels(view, ellipse.outline(180))
        for color, width in ((_WHITE, 4 - number), (_BLUE, 2 - min(number, 1))):
            cv2.polylines(picture, [points], True, color, width, cv2.LINE_AA, SHIFT)
    row, col = (round(float(v)) for v in view.to_grid(*mean))
    for color, size, width in ((_WHITE, 20, 5), (_BLUE, 18, 2)):
        cv2.drawMarker(picture, (col, row), color, cv2.MARKER_CROSS, size, width, cv2.LINE_AA)


def _named(picture: RgbImage, view: GridGeometry, ellipses: Sequence[tuple[str, Ellipse]]) -> RgbImage:
    texts: list[Text] = []
    for name, ellipse in ellipses:
        top = max(ellipse.outline(180).tolist(), key=lambda place: place[1])
        row, col = view.to_grid(*top)
        texts.append((name, min(max(float(col), 40), view.width - 40), max(float(row) - 4, 14), "mb"))
    return draw_texts(picture, texts, 14, _BLUE, halo=PAPER)
