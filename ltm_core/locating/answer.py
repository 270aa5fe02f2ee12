"""State a location in the coordinates and words that people use, and find places of the map in photos."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ltm_core.base.errors import RegionError
from ltm_core.base.types import Float64Array
from ltm_core.fuel.codes import fuel_models
from ltm_core.fuel.life_form import NODATA
from ltm_core.fuel.prior import FuelPrior
from ltm_core.geometry.geodesy import SiteFrame
from ltm_core.locating.locator import Ellipse, Location
from ltm_core.locating.sight_fan import sight_fan
from ltm_core.visibility.footprint import line_of_sight_vectors
from ltm_core.visibility.point_visibility import TOLERANCE, PointState, PointVisibility
from ltm_core.visibility.viewshed import PosedCamera

_MARGIN = 3.0  # ratio of an image's width to the uncertainty of a place for the image to show that place
_NARROWEST_DEG = 2.0


@dataclass(frozen=True)
class PlaceView:
    """View of a place by one camera.

    `pixel`: u, v in the image, hidden or not; None if outside. `state`: seen, hidden, outside or unknown. `lift`:
    metres above the place from which the camera sees it; NaN if unknown ground decides. `hidden_by`: x, y, z of the
    crest before it. `azimuth_deg` (from grid north), `pitch_deg`: where to turn. `hfov_deg`: field of view that
    contains the uncertainty. `distance`: horizontal, metres."""

    camera: str
    pixel: tuple[float, float] | None
    state: PointState
    lift: float
    hidden_by: tuple[float, float, float] | None
    azimuth_deg: float
    pitch_deg: float
    hfov_deg: float
    distance: float


def place_views(
    sight: PointVisibility, cameras: Sequence[PosedCamera], place: Float64Array, extent: float = 0.0
) -> list[PlaceView]:
    """Return the views of a place (3,) by all cameras, in their order. `extent`: uncertainty of the place in metres.
    Raises RegionError for a place without a height, as outside the DEM."""
    target = np.asarray(place, np.float64)
    if target.shape != (3,) or not np.isfinite(target).all():
        raise RegionError(f"a place needs three finite coordinates, got {target.tolist()}; check that it is on the DEM")
    views = []
    for camera in cameras:
        seen = sight.visible(camera.camera, camera.pose, target[None])
        vector = line_of_sight_vectors(camera.pose.position, target, sight.bend)
        level = math.hypot(vector[0], vector[1])
        state, lift, pixel = PointState(int(seen.states[0])), float(seen.lifts[0]), seen.pixels[0]
        there = state is not PointState.OUTSIDE and bool(np.isfinite(pixel).all())
        crest = _crest(sight, camera, target) if lift > TOLERANCE else None
        azimuth, pitch = math.degrees(math.atan2(vector[0], vector[1])), math.degrees(math.atan2(vector[2], level))
        hfov = math.degrees(2 * math.atan2(_MARGIN * extent, max(level, 1.0)))
        hfov = min(max(hfov, _NARROWEST_DEG), 120.0)
        at = (float(pixel[0]), float(pixel[1])) if there else None
        views.append(PlaceView(camera.name, at, state, lift, crest, azimuth % 360.0, pitch, hfov, level))
    return views


def _crest(sight: PointVisibility, camera: PosedCamera, place: Float64Array) -> tuple[float, float, float] | None:
    """Return the ground that stands highest in the line of sight, as finely as a fan has it; None if unknown."""
    x, y, z = (float(v) for v in camera.pose.position)
    distance, azimuth = math.hypot(place[0] - x, place[1] - y), math.atan2(place[0] - x, place[1] - y)
    fan = sight_fan(sight.dem, camera.pose.position, np.array([azimuth, azimuth + 1e-6]), max(distance, 10.0))
    heights = fan.heights[0].astype(np.float64)
    before = np.isfinite(heights) & (fan.ranges < distance)
    if not before.any():
        return None
    at = int(np.where(before, (heights - z) / fan.ranges - sight.bend * fan.ranges, -np.inf).argmax())
    r = float(fan.ranges[at])
    return x + r * math.sin(azimuth), y + r * math.cos(azimuth), float(heights[at])


SHARES = (0.5, 0.95)  # probabilities that the ellipses contain


@dataclass(frozen=True)
class PlaceName:
    """Names of a place. `x`, `y`: in `crs`. `mgrs`: to the metre, WGS 84."""

    crs: str
    x: float
    y: float
    lon: float
    lat: float
    mgrs: str | None
    """MGRS coordinate; None beyond 84 degrees north and 80 south, where MGRS has other grids."""
    elevation: float | None


@dataclass(frozen=True, eq=False)
class LocateResult:
    """Result of locating. `ellipses`: by SHARES, in the map frame. `fuel`: as `fuel_at`. `views`: of the mean place, by
    all cameras."""

    location: Location
    name: PlaceName
    elevation_sigma: float
    ellipses: tuple[Ellipse, ...]
    fuel: dict[str, Any] | None
    views: tuple[PlaceView, ...]
    smoke: bool


def answer(
    location: Location,
    sight: PointVisibility,
    frame: SiteFrame,
    cameras: Sequence[PosedCamera],
    prior: FuelPrior | None,
    smoke: bool,
) -> LocateResult:
    """Return the complete result of a location. `prior`: its geometry in the map frame."""
    posterior = location.posterior
    x, y = posterior.mean
    heights = sight.dem.elevation_at(posterior.places[:, 0], posterior.places[:, 1])
    known = np.isfinite(heights)
    weights = posterior.probability * known
    elevation = sigma = math.nan
    if weights.sum() > 0:
        elevation = float(sight.dem.elevation_at(x, y))
        mean = float(weights @ np.where(known, heights, 0.0) / weights.sum())
        elevation = mean if math.isnan(elevation) else elevation
        sigma = math.sqrt(float(weights @ np.where(known, heights - mean, 0.0) ** 2 / weights.sum()))
    ellipses = tuple(posterior.ellipse(share) for share in SHARES)
    views: tuple[PlaceView, ...] = ()
    if not math.isnan(elevation):
        views = tuple(place_views(sight, cameras, np.array([x, y, elevation]), ellipses[-1].major))
    name, fuel = place_name(frame, x, y, elevation), fuel_at(prior, x, y)
    return LocateResult(location, name, sigma, ellipses, fuel, views, smoke)


def place_name(frame: SiteFrame, x: float, y: float, elevation: float) -> PlaceName:
    """Return the names of a place in the map frame; `elevation` is NaN if unknown."""
    lon, lat = (float(v) for v in frame.to_lonlat(x, y))
    height = None if math.isnan(elevation) else elevation
    return PlaceName(frame.crs, x + frame.x_origin, y + frame.y_origin, lon, lat, _mgrs(lon, lat), height)


def _mgrs(lon: float, lat: float) -> str | None:
    from mgrs import MGRS

    if not -80.0 <= lat < 84.0:
        return None
    text = str(MGRS().toMGRS(lat, lon, MGRSPrecision=5))
    zone = len(text) - 12
    return f"{text[:zone]} {text[zone : zone + 2]} {text[zone + 2 : zone + 7]} {text[zone + 7 :]}"


def fuel_at(prior: FuelPrior | None, x: float, y: float) -> dict[str, Any] | None:
    """Return `code` and `name` of the prior's fuel model at a place of the map; None if unknown."""
    if prior is None:
        return None
    row, col = (int(v) for v in prior.geometry.cell_of(x, y))
    if not bool(prior.geometry.contains(row, col)) or prior.codes[row, col] == NODATA:
        return None
    code = int(prior.codes[row, col])
    return {"code": code, "name": fuel_models().name(code)}


def as_data(said: LocateResult, frame: SiteFrame) -> dict[str, Any]:
    """Return JSON-ready data: lengths in metres, angles in degrees from grid north, places in the site's CRS."""
    posterior, x0, y0 = said.location.posterior, frame.x_origin, frame.y_origin
    likeliest = posterior.likeliest
    data = {
        "likeliest": [likeliest[0] + x0, likeliest[1] + y0],
        "sigma": posterior.sigma,
        "elevation_sigma": said.elevation_sigma,
        "ellipses": [
            {"share": share, "semi_major": e.major, "semi_minor": e.minor, "azimuth_deg": e.azimuth_deg}
            for share, e in zip(SHARES, said.ellipses, strict=True)
        ],
        "modes": [{"share": m.share, "x": m.centre[0] + x0, "y": m.centre[1] + y0} for m in posterior.modes],
        "smoke": said.smoke,
        "least_visible_height": said.location.lift if said.smoke else None,
        "fuel": said.fuel,
        "agreement": None,
        "cameras": [view_data(view, frame) for view in said.views],
    }
    if (agreement := said.location.agreement) is not None:
        statistic = {"statistic": min(agreement.statistic, 1e6), "limit": agreement.limit}
        data["agreement"] = {"agree": agreement.agree, **statistic, "suspicion": agreement.suspicion}
    return {"place": asdict(said.name), **_rounded(data)}


def view_data(view: PlaceView, frame: SiteFrame) -> dict[str, Any]:
    """Return one camera's view of a place."""
    hidden = view.hidden_by
    data = {
        "camera": view.camera,
        "state": view.state.name.lower(),
        "pixel": view.pixel,
        "distance": view.distance,
        "bearing_deg": view.azimuth_deg,
        "pitch_deg": view.pitch_deg,
        "hfov_deg": view.hfov_deg,
        "least_visible_height": view.lift,
        "hidden_by": hidden and [hidden[0] + frame.x_origin, hidden[1] + frame.y_origin, hidden[2]],
    }
    return dict(_rounded(data))


def as_geojson(said: LocateResult, frame: SiteFrame, properties: dict[str, Any] | None = None) -> dict[str, Any]:
    """Return a FeatureCollection (RFC 7946): the mean place with all properties, the ellipses, and several modes."""

    def lonlat(points: Float64Array) -> list[list[float]]:
        return np.column_stack(frame.to_lonlat(points[:, 0], points[:, 1])).round(7).tolist()  # type: ignore[no-any-return]

    def feature(kind: str, coordinates: Any, values: dict[str, Any]) -> dict[str, Any]:
        return {"type": "Feature", "geometry": {"type": kind, "coordinates": coordinates}, "properties": values}

    place = [round(said.name.lon, 7), round(said.name.lat, 7)]
    features = [feature("Point", place, {"role": "place"} | (properties or {}) | as_data(said, frame))]
    for share, ellipse in zip(SHARES, said.ellipses, strict=True):
        features.append(feature("Polygon", [lonlat(ellipse.outline())], {"role": "ellipse", "share": share}))
    modes = said.location.posterior.modes
    for mode in modes if len(modes) > 1 else ():
        values = {"role": "mode", "share": round(mode.share, 4)}
        features.append(feature("Point", lonlat(np.array([mode.centre]))[0], values))
    return {"type": "FeatureCollection", "features": features}


def _rounded(value: Any) -> Any:
    """Return JSON-ready data with numbers rounded to four places; None for those that are not finite."""
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(item) for item in value]
    if isinstance(value, float):
        return round(float(value), 4) if math.isfinite(value) else None
    return value
