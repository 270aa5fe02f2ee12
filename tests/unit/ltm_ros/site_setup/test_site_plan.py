"""Sites from a point on the map, with sources that make their rasters here: planes in degrees."""

import errno
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
import rasterio
from scenes.site_services import geotiff, silent

from ltm_core.base.errors import ConfigError, LtmError, RasterError
from ltm_core.raster.dem import Dem
from ltm_core.site.site_io import load_site
from ltm_ros.site_setup.camera_list import parse_camera
from ltm_ros.site_setup.rasters import tiles_of
from ltm_ros.site_setup.request import Area, Fetched, FetchError, Kind, NoCoverageError, Part, Plan
from ltm_ros.site_setup.site_plan import SitePlan, Wish, carry_out, plan_site

PLACES = {
    "California": (-118.47, 34.09, "EPSG:32611"),
    "Australia": (149.1, -35.3, "EPSG:32755"),
    "Alaska": (-149.5, 61.2, "EPSG:32606"),
    "Hawaii": (-155.6, 19.6, "EPSG:32605"),
    "west of a zone's edge": (-120.001, 38.5, "EPSG:32610"),
    "east of a zone's edge": (-119.999, 38.5, "EPSG:32611"),
    "on a zone's edge": (-120.0, 38.5, "EPSG:32610"),
    "Norway": (13.8, 66.65, "EPSG:32633"),
}


def elevation(lon: Any, lat: Any) -> Any:
    return 900.0 + 2000.0 * (lon - np.floor(lon)) + 1000.0 * (lat - np.floor(lat))


def write_plane(path: Path, area: Area, step: float, values: Callable[[Any, Any], Any], dtype: str = "float32") -> Path:
    west, south, east, north = area.bounds_lonlat
    width, height = round((east - west) / step) + 2, round((north - south) / step) + 2
    lon, lat = np.meshgrid(west + (np.arange(width) - 0.5) * step, north - (np.arange(height) - 0.5) * step)
    path.write_bytes(geotiff(values(lon, lat).astype(dtype), "EPSG:4326", west - step, north + step, step))
    return path


class Maker:
    """A source that has every kind of raster, everywhere."""

    licence, address, vertical_crs = "public domain", "http://127.0.0.1/", "EPSG:3855"

    def __init__(self, name: str, kinds: Sequence[Kind], resolution_m: float, year: int = 2024) -> None:
        self.name, self.kinds, self.resolution_m, self.year = name, kinds, resolution_m, year
        self.reason = ""
        self.error: BaseException | None = None
        self.areas: list[Area] = []

    def plan(self, area: Area) -> Plan:
        if self.reason:
            raise NoCoverageError(self.reason)
        self.areas.append(area)
        return Plan(area, (Part("http://127.0.0.1/a.tif", "a.tif", 1000),), (), self.year)

    def fetch(self, plan: Plan, folder: Path, progress: Callable[[int, int], None]) -> Fetched:
        progress(500, 1000)
        if self.error is not None:
            (folder / "half.tif").write_bytes(b"II*")
            raise self.error
        fuel = "fuel" in self.kinds
        step = self.resolution_m / 111_320
        values = (lambda lon, lat: np.full(lon.shape, 102)) if fuel else elevation
        name = "LC24_F40.tif" if fuel else "a.tif"
        file = write_plane(folder / name, plan.area, step, values, "int16" if fuel else "float32")
        vertical = None if fuel else self.vertical_crs
        return Fetched((file,), self.name, self.licence, vertical, self.year, ("http://x/",))


@pytest.fixture
def makers() -> list[Any]:
    return [
        Maker("fine", ["dem"], 30.0),
        Maker("coarse", ["coarser"], 200.0),
        Maker("fuels", ["fuel"], 30.0, 2022),
    ]


def wish(out: Path, place: str = "California", **more: Any) -> Wish:
    lon, lat, _ = PLACES[place]
    camera = parse_camera(f"north={lon},{lat},height=20,azimuth=214,hfov=54")
    return Wish(**{"out": out, "name": "getty", "lonlat": (lon, lat), "radius": 1000.0, "cameras": [camera], **more})


def made(wanted: Wish, sources: Sequence[Any]) -> SitePlan:
    plan = plan_site(wanted, sources)
    carry_out(plan, silent)
    return plan


@pytest.mark.parametrize("place", PLACES)
def test_a_site_anywhere_has_its_zone_and_the_heights_of_its_sources(
    place: str, makers: list[Any], tmp_path: Path
) -> None:
    lon, lat, crs = PLACES[place]
    made(wish(tmp_path / "site", place), makers)
    site = load_site(tmp_path / "site/site.yaml")
    assert site.crs == crs
    dem = site.open_dem()
    x, y = site.frame.from_lonlat(lon + np.linspace(-0.008, 0.008, 9), lat + np.linspace(-0.005, 0.005, 9))
    assert np.hypot(x, y).max() < 2500  # near the origin
    expected = elevation(lon + np.linspace(-0.008, 0.008, 9), lat + np.linspace(-0.005, 0.005, 9))
    jump = np.abs(np.diff(expected)).max() > 50  # of a whole degree
    if not jump:
        np.testing.assert_allclose(dem.elevation_at(x, y), expected, atol=0.05)
    assert np.isfinite(dem.elevation_at(*site.frame.from_lonlat(lon, lat + 0.33))).all()  # the horizon, 37 km away
    assert site.fuel.prior is not None
    assert sorted(file.name for file in (tmp_path / "site/fuel").iterdir()) == ["fbfm40.tif"]
    assert sorted(file.name for file in tmp_path.iterdir()) == ["site"]


def test_rasters_are_cloud_optimised_and_carry_their_provenance(makers: list[Any], tmp_path: Path) -> None:
    made(wish(tmp_path / "site", radius=12_000.0), makers)
    with rasterio.open(tmp_path / "site/dem.tif") as source:
        tags, layout = source.tags(), source.tags(ns="IMAGE_STRUCTURE")
        assert layout["LAYOUT"] == "COG"
        assert source.overviews(1)
        assert (tags["SOURCE"], tags["YEAR"], tags["LICENCE"]) == ("fine", "2024", "public domain")
    assert tiles_of([tmp_path / "site/dem.tif"])[0].datum == tiles_of([tmp_path / "site/dem_coarse.tif"])[0].datum
    with rasterio.open(tmp_path / "site/fuel/fbfm40.tif") as source:
        assert set(np.unique(source.read(1))) == {102}
        assert source.tags()["YEAR"] == "2022"
    text = (tmp_path / "site/site.yaml").read_text()
    assert "EPSG:3855" in text
    assert "2022" in text


def test_own_rasters_are_not_fetched(makers: list[Any], tmp_path: Path) -> None:
    area = Area((-118.6, 33.99, -118.35, 34.2))
    own = write_plane(tmp_path / "own.tif", area, 1 / 3600, elevation)
    codes = write_plane(tmp_path / "codes.tif", area, 1 / 3600, lambda lon, lat: np.full(lon.shape, 147), "int16")
    tops = write_plane(tmp_path / "tops.tif", area, 1 / 3600, lambda lon, lat: elevation(lon, lat) + 12)
    files = {"dem": [own], "fuel": [codes], "surface": [tops]}
    made(wish(tmp_path / "site", files=files), makers)
    assert [maker.areas for maker in makers] == [[], [], []]
    site = load_site(tmp_path / "site/site.yaml")
    ground = site.open_dem()
    x, y = site.frame.from_lonlat(-118.47, 34.09)
    assert float(ground.elevation_at(x, y)) == pytest.approx(float(elevation(-118.47, 34.09)), abs=0.05)
    rise = float(site.open_surface(ground).elevation_at(x, y)) - float(ground.elevation_at(x, y))
    assert rise == pytest.approx(12, abs=0.05)


def test_canopy_heights_are_added_to_the_ground(makers: list[Any], tmp_path: Path) -> None:
    area = Area((-118.6, 33.99, -118.35, 34.2))
    canopy = write_plane(tmp_path / "chm.tif", area, 1 / 3600, lambda lon, lat: 10 + 5 * (lon > -118.47), "uint8")
    made(wish(tmp_path / "site", files={"surface": [canopy]}), makers)
    site = load_site(tmp_path / "site/site.yaml")
    ground = site.open_dem()
    x, y = site.frame.from_lonlat(np.array([-118.475, -118.465]), np.array([34.09, 34.09]))
    rise = site.open_surface(ground).elevation_at(x, y) - ground.elevation_at(x, y)
    np.testing.assert_allclose(rise, [10, 15], atol=0.1)


def test_the_crs_of_an_own_dem_is_the_sites(makers: list[Any], tmp_path: Path) -> None:
    dem = tmp_path / "dem.tif"
    heights = np.linspace(100, 300, 300 * 280, dtype=np.float32)
    dem.write_bytes(geotiff(heights.reshape(280, 300), "EPSG:26911", 363_000, 3_775_000, 10))
    made(wish(tmp_path / "site", files={"dem": [dem]}, lonlat=(-118.47, 34.09)), makers)
    assert load_site(tmp_path / "site/site.yaml").crs == "EPSG:26911"
    stored = Dem.open(tmp_path / "site/dem.tif")
    assert stored.geometry.resolution == 10
    assert np.isin(stored.elevation[5, 5], heights)  # no new value


def test_a_camera_outside_the_radius_stands_on_the_coarse_dem(makers: list[Any], tmp_path: Path) -> None:
    far = parse_camera("far=-118.40,34.09,height=20,azimuth=214,hfov=54")
    plan = made(wish(tmp_path / "site", cameras=[far]), makers)
    assert any("far" in remark for remark in plan.remarks)
    site = load_site(tmp_path / "site/site.yaml")
    pose = site.cameras["far"].pose
    assert pose is not None
    assert pose.pose(site.open_dem(), site.frame).position[2] == pytest.approx(
        float(elevation(-118.40, 34.09)) + 20, abs=1
    )
    west = makers[1].areas[0].bounds_lonlat[0]
    assert -118.40 - west > 40_000 / 111_320 / np.cos(np.radians(34.1))


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"lonlat": None}, "lonlat"),
        ({"name": ""}, "name"),
        ({"name": "Getty Fire"}, "Getty Fire"),
        ({"crs": "EPSG:4326"}, "4326"),
        ({"crs": "EPSG:32633"}, "32633"),
        ({"crs": "EPSG:nonsense"}, "nonsense"),
        ({"update": "fuel"}, "site.yaml"),
        ({"cameras": [parse_camera("a=34.09,-18.47,azimuth=1,hfov=50")]}, "camera a"),
        ({"cameras": [parse_camera("a=-118.47,34.09,azimuth=1,hfov=50")] * 2}, "camera a"),
        ({"cameras": [parse_camera("a=-118.47,34.09,hfov=50")]}, "azimuth"),
        ({"cameras": [parse_camera("a=-118.47,34.09,azimuth=3")]}, "hfov"),
        ({"files": {"dem": [Path("/nowhere/dem.tif")]}}, "dem.tif"),
        ({"files": {"fuel": [Path("/nowhere/fuel.tif")]}}, "fuel.tif"),
    ],
)
def test_a_wish_that_cannot_be_is_an_error_and_leaves_nothing(
    change: dict[str, Any], told: str, makers: list[Any], tmp_path: Path
) -> None:
    with pytest.raises(LtmError, match=told):
        made(wish(tmp_path / "site", **change), makers)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "error", [FetchError("truncated"), OSError(errno.ENOSPC, "No space left on device"), KeyboardInterrupt()]
)
def test_whatever_happens_while_fetching_leaves_nothing(
    error: BaseException, makers: list[Any], tmp_path: Path
) -> None:
    makers[2].error = error
    with pytest.raises(KeyboardInterrupt if isinstance(error, KeyboardInterrupt) else LtmError):
        made(wish(tmp_path / "site"), makers)
    assert list(tmp_path.iterdir()) == []
    makers[2].error = None
    made(wish(tmp_path / "site"), makers)  # it can be repeated


def test_a_disk_that_is_too_small_is_told_before_anything_is_fetched(
    makers: list[Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ltm_ros.site_setup.site_plan.free_bytes", lambda path: 2_000)
    makers[0].error = AssertionError("fetched")
    with pytest.raises(ConfigError, match="are free"):
        made(wish(tmp_path / "site"), makers)


def test_a_folder_with_other_things_is_kept(makers: list[Any], tmp_path: Path) -> None:
    (tmp_path / "photo.jpg").touch()
    with pytest.raises(ConfigError, match="not an empty folder"):
        made(wish(tmp_path), makers)
    assert [file.name for file in tmp_path.iterdir()] == ["photo.jpg"]


@pytest.mark.parametrize("key", ["dem", "coarser", "surface", "fuel"])
def test_an_update_adds_a_raster_and_keeps_the_rest(key: str, makers: list[Any], tmp_path: Path) -> None:
    out = tmp_path / "site"
    made(wish(out), makers)
    before = {file: file.read_bytes() for file in out.rglob("*.tif")}
    text = (out / "site.yaml").read_text() + "model: landscape_v5  # mine\n"
    (out / "site.yaml").write_text(text)
    newer = Maker("newer", get_args(Kind), 30.0, 2025)
    if key == "fuel":
        newer.kinds = ["fuel"]
    change = Wish(out, update=key, cameras=[parse_camera("south=-118.471,34.085,height=9,azimuth=3,hfov=60")])
    made(change, [newer])
    site = load_site(out / "site.yaml")
    assert set(site.cameras) == {"north", "south"}
    new = (out / "site.yaml").read_text()
    assert "# mine" in new
    assert "2025" in new
    assert all(file.read_bytes() == content for file, content in before.items())
    names = [dem.path.name for dem in (site.dem, *site.coarser)]
    assert names == {"dem": ["dem_2.tif", "dem_coarse.tif"], "coarser": ["dem.tif", "dem_coarse_2.tif"]}.get(
        key, ["dem.tif", "dem_coarse.tif"]
    )
    assert (site.surface is not None) == (key == "surface")
    assert site.fuel.prior is not None
    assert site.fuel.prior.path == out / ("fuel_2" if key == "fuel" else "fuel")
    assert np.isfinite(site.open_dem().elevation).all()


def test_an_update_that_fails_leaves_the_site(makers: list[Any], tmp_path: Path) -> None:
    out = tmp_path / "site"
    made(wish(out), makers)
    before = sorted(str(path) for path in out.rglob("*"))
    north = parse_camera("north=-118.471,34.085,height=9,azimuth=3,hfov=60")
    with pytest.raises(ConfigError, match="north"):
        made(Wish(out, update="fuel", cameras=[north]), makers)
    makers[2].error = FetchError("gone")
    with pytest.raises(FetchError):
        made(Wish(out, update="fuel"), makers)
    assert sorted(str(path) for path in out.rglob("*")) == before
    with pytest.raises(ConfigError, match="exists already"):
        plan_site(wish(out, cameras=[]), makers)


def test_a_fuel_map_of_another_place_is_an_error(makers: list[Any], tmp_path: Path) -> None:
    codes = write_plane(
        tmp_path / "codes.tif", Area((-117.0, 33.0, -116.9, 33.1)), 1 / 3600,
        lambda lon, lat: np.full(lon.shape, 147), "int16",
    )  # fmt: skip
    with pytest.raises(RasterError, match="codes"):
        made(wish(tmp_path / "site", files={"fuel": [codes]}), makers)
