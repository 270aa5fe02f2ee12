"""Convert heights between vertical datums: NAVD88, EGM2008, EGM96, the ellipsoid, and any other that PROJ knows.

Every datum is described by the height of its zero surface above the ellipsoid of ITRF2014, so that a conversion is the
difference of two such heights. NAD83 and ITRF2014 are 0.5 to 1.5 m apart in height; PROJ takes NAD83 and WGS 84 as
equal unless the way between them is stated, as it is here."""

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from pyproj import CRS, Transformer
from pyproj.aoi import AreaOfInterest
from pyproj.crs import CompoundCRS
from pyproj.transformer import TransformerGroup

from ltm_core.base.errors import ConfigError, RasterError
from ltm_core.base.types import Float64Array
from ltm_core.geometry.geodesy import name_of, read_crs

_ITRF2014 = "EPSG:7912"
_EPOCH = 2010.0
"""Year for which NAD83 and ITRF2014 are compared; their heights drift apart by a millimetre a year."""


@dataclass(frozen=True)
class Datum:
    """A vertical datum. `code`: its CRS, vertical, or geographic for ellipsoidal heights. `base`: geographic CRS to
    whose ellipsoid PROJ relates the heights."""

    name: str
    code: str
    base: str

    @property
    def ellipsoidal(self) -> bool:
        return self.code == self.base


ELLIPSOIDAL = Datum("the WGS 84 ellipsoid", "EPSG:4979", "EPSG:4979")
EGM2008 = Datum("EGM2008", "EPSG:3855", "EPSG:4979")
EGM96 = Datum("EGM96", "EPSG:5773", "EPSG:4979")
NAVD88 = Datum("NAVD88", "EPSG:5703", "EPSG:6319")
_BY_NAME = {"egm2008": EGM2008, "egm96": EGM96, "navd88": NAVD88, "ellipsoidal": ELLIPSOIDAL}
_BY_DATUM = {"EGM2008 geoid": EGM2008, "EGM96 geoid": EGM96, "North American Vertical Datum 1988": NAVD88}


class MissingGridError(RasterError):
    """PROJ has no grid for a conversion. `metres`: typical size of the error without it."""

    def __init__(self, given: Datum, wanted: Datum, grids: list[str]) -> None:
        self.metres = 30.0 if given.ellipsoidal or wanted.ellipsoidal else 1.0
        size = "20 to 50 m, at most 107 m" if self.metres > 1 else "about 1 m"
        remedy = "; ".join(f"pyproj sync --file {grid}" for grid in grids)
        super().__init__(
            f"heights above {given.name} cannot be converted to {wanted.name} here: "
            + (f"PROJ's grids are missing; install them: {remedy}" if grids else "PROJ has no grid for this place")
            + f". Without the conversion heights are {size} off"
        )


def datum_of(crs: CRS) -> Datum | None:
    """Return the vertical datum that a file's CRS states; None if it states none."""
    if crs.is_compound:
        vertical = crs.sub_crs_list[1]
        base = crs.geodetic_crs or read_crs(ELLIPSOIDAL.code)
        name = vertical.datum.name if vertical.datum else vertical.name
        if "ellipsoid" in f"{vertical.name} {name}".lower():
            return _ellipsoidal(base)
        return _BY_DATUM.get(name) or Datum(vertical.name, name_of(vertical), name_of(base.to_3d()))
    return _ellipsoidal(crs.geodetic_crs) if len(crs.axis_info) > 2 else None


def _ellipsoidal(base: Any) -> Datum:
    code = name_of(base.to_3d())
    return ELLIPSOIDAL if code == ELLIPSOIDAL.code else Datum(f"the ellipsoid of {base.name}", code, code)


def named_datum(text: str) -> Datum:
    """Return the datum of a name (navd88, egm2008, egm96, ellipsoidal) or of a CRS. Raises ConfigError."""
    if text.lower() in _BY_NAME:
        return _BY_NAME[text.lower()]
    crs = read_crs(text)
    bare = crs.is_vertical and not crs.is_compound
    found = _BY_DATUM.get(crs.datum.name if crs.datum else "") if bare else datum_of(crs)
    if found is None:
        raise ConfigError(f"vertical datum {text}: give {', '.join(_BY_NAME)} or a CRS with heights")
    return found


def site_datum(stated: Datum | None, lon: float, lat: float) -> Datum | None:
    """Return the datum of a site at a place whose finest DEM has heights above `stated`: the same, or for ellipsoidal
    heights the global geoid whose grid PROJ has."""
    if stated is None or not stated.ellipsoidal:
        return stated
    area = AreaOfInterest(lon, lat, lon, lat)
    return EGM96 if _route(EGM2008, area)[1] and not _route(EGM96, area)[1] else EGM2008


def correction(given: Datum, wanted: Datum, lon: Float64Array, lat: Float64Array) -> Float64Array:
    """Return the metres to add to heights above `given` to get heights above `wanted`.

    `lon`, `lat`: WGS 84 degrees, any shape. Raises MissingGridError."""
    if given == wanted:
        return np.zeros(np.shape(lon))
    area = AreaOfInterest(float(np.min(lon)), float(np.min(lat)), float(np.max(lon)), float(np.max(lat)))
    zeros, missing = [], []
    for datum in (given, wanted):
        way, grids = _route(datum, area)
        missing += grids
        if way is None:
            continue
        # The datum's zero surface above the ellipsoid of ITRF2014, metres.
        above = np.zeros(np.shape(lon)) if datum.ellipsoidal else way.transform(lon, lat, np.zeros(np.shape(lon)))[2]
        if datum.base != ELLIPSOIDAL.base:
            shift = Transformer.from_crs(datum.base, _ITRF2014, always_xy=True)
            above = shift.transform(lon, lat, above, np.full(np.shape(lon), _EPOCH))[2]
        zeros.append(np.asarray(above, np.float64))
    if len(zeros) < 2 or not np.isfinite(zeros[0] - zeros[1]).all():
        raise MissingGridError(given, wanted, missing)
    return zeros[0] - zeros[1]


def _route(datum: Datum, area: AreaOfInterest) -> tuple[Transformer | None, list[str]]:
    """Return the transformer from heights to those above the ellipsoid, or None and the grids that PROJ misses."""
    base = read_crs(datum.base)
    given = base if datum.ellipsoidal else CompoundCRS("heights", [base.to_2d(), datum.code])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # a better grid is missing: another one is used, or it is reported
        group = TransformerGroup(given, base, always_xy=True, area_of_interest=area, allow_ballpark=False)  # type: ignore[arg-type]
    if group.transformers:
        return group.transformers[0], []
    best = group.unavailable_operations[:1]
    return None, [grid.short_name for way in best for grid in way.grids if not grid.available]
