"""Services that prepare files on request, and the situations in which they cannot, against services on loopback."""

import resource
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import get_args

import numpy as np
import pytest
import rasterio
from scenes.site_services import KEY, LAYERS, SiteServices, area_around, geotiff, grid, opened, silent

from ltm_core.base.errors import ConfigError, LtmError
from ltm_core.base.resources import project_path
from ltm_core.fuel.fuel_bands_io import open_bands
from ltm_ros.site_setup.request import Area, FetchError, Kind, NoCoverageError
from ltm_ros.site_setup.services import CoverageGrid, LandfireSource
from ltm_ros.site_setup.source import Source
from ltm_ros.site_setup.sources import choose, load_sources
from ltm_ros.site_setup.web import Web

HERE = area_around(-118.47, 34.09, 3000.0)
PLAIN_FILE = b"A file of no service. " * 40_000


@pytest.fixture(autouse=True)
def _no_keys(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(LandfireSource, "poll_s", 0.01)
    for name in ("OPENTOPOGRAPHY_API_KEY", "LANDFIRE_EMAIL"):
        monkeypatch.delenv(name, raising=False)


@pytest.fixture
def services() -> Iterator[SiteServices]:
    with SiteServices() as services:
        yield services


def only(name: str, listed: list[Source]) -> list[Source]:
    return [source for source in listed if source.name == name]


def fetched_codes(paths: tuple[Path, ...]) -> None:
    """Check that the codes lie where the service has them."""
    values, about = opened(paths[0])
    west, south, east, north = about.bounds
    assert [bound % 30 for bound in (west, south, east, north)] == [15.0] * 4
    x, y = grid(west, north, 30.0, about.width, about.height)
    np.testing.assert_array_equal(values, 101 + (np.round(x / 30.0) + np.round(y / 30.0)) % 9)


def test_open_topography_delivers_heights_with_the_datum_of_the_record(
    services: SiteServices, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("OPENTOPOGRAPHY_API_KEY", KEY)
    choice = choose("coarser", HERE, only("opentopography_cop30", services.loaded(tmp_path)))
    fetched = choice.fetch(tmp_path / "out", silent)
    values, about = opened(fetched.files[0])
    np.testing.assert_allclose(values, services.heights(*grid(*about.transform @ (0, 0), 1 / 3600, *about.shape[::-1])))
    west, south, east, north = HERE.bounds_lonlat
    assert about.bounds.left < west < east < about.bounds.right
    assert about.bounds.bottom < south < north < about.bounds.top
    assert (fetched.vertical_crs, fetched.year) == ("EPSG:3855", 2015)
    assert KEY not in f"{fetched} {choice.plan}"


def test_landfire_job_gives_one_file_for_each_layer_on_its_own_grid(
    services: SiteServices, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("LANDFIRE_EMAIL", "me@example.org")
    fetched = choose("fuel", HERE, services.loaded(tmp_path)).fetch(tmp_path / "out", silent)
    assert (fetched.source, fetched.year) == ("landfire", 2024)
    fetched_codes(fetched.files)
    (path,) = fetched.files
    quantities = {band.quantity for band in open_bands(path)}
    assert quantities == {"fbfm40", "fbfm13", "cover", "height", "base_height", "bulk_density"}


@pytest.mark.parametrize(
    ("known", "year"),
    [({2022: 1.0, 2024: 0.0, 2023: 1.0}, 2023), ({2023: 1.0, 2024: 0.5}, 2023), ({2023: 0.4, 2024: 0.5}, 2024)],
)
def test_the_newest_edition_that_is_complete_for_the_area_is_used(
    known: dict[int, float], year: int, services: SiteServices, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("LANDFIRE_EMAIL", "me@example.org")
    services.fuel_years = known
    assert choose("fuel", HERE, services.loaded(tmp_path)).fetch(tmp_path / "out", silent).year == year


def test_an_interrupted_job_is_continued_and_not_submitted_again(
    services: SiteServices, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("LANDFIRE_EMAIL", "me@example.org")
    services.job_states = ["Pending"]
    choice = choose("fuel", HERE, services.loaded(tmp_path))
    with monkeypatch.context() as soon:
        soon.setattr("ltm_ros.site_setup.services._JOB_S", 0.1)
        with pytest.raises(FetchError, match="not finished"):
            choice.fetch(tmp_path / "out", silent)
    services.job_states = ["Succeeded"]
    fetched_codes(choice.fetch(tmp_path / "out", silent).files)
    assert services.count("/job/submit") == 1


def test_without_an_address_fuels_come_from_the_coverage_service(services: SiteServices, tmp_path: Path) -> None:
    choice = choose("fuel", HERE, services.loaded(tmp_path))
    fetched = choice.fetch(tmp_path / "out", silent)
    assert fetched.source == "landfire_wcs"
    assert "LANDFIRE_EMAIL" in choice.plan.notes[0]
    assert [path.name for path in fetched.files] == [f"LF2024_{layer}_CONUS.tif" for layer in LAYERS]
    fetched_codes(fetched.files)


def test_own_sources_come_first_and_replace_single_keys(services: SiteServices, tmp_path: Path) -> None:
    heights = geotiff(np.ones((80, 90), np.float32), "EPSG:4326", -118.6, 34.2, 0.004)
    services.files["/cog/mine.tif"] = heights
    mine = {"kinds": ["dem"], "protocol": "url", "address": f"{services.url}/cog/mine.tif", "licence": "mine",
            "resolution_m": 400}  # fmt: skip
    listed = services.loaded(tmp_path, mine=mine, copernicus_glo30={"year": 2021})
    assert listed[0].name == "mine"
    assert next(s for s in listed if s.name == "copernicus_glo30").year == 2021
    fetched = choose("dem", HERE, listed).fetch(tmp_path / "out", silent)
    assert (fetched.source, fetched.licence, fetched.vertical_crs) == ("mine", "mine", None)
    with rasterio.open(fetched.files[0]) as raster:
        assert raster.tags()["SOURCE"] == "mine"


def keyed(monkeypatch: pytest.MonkeyPatch, key: str = KEY) -> None:
    monkeypatch.setenv("OPENTOPOGRAPHY_API_KEY", key)
    monkeypatch.setenv("LANDFIRE_EMAIL", "me@example.org")


def arrange(situation: str, services: SiteServices, monkeypatch: pytest.MonkeyPatch) -> dict[str, dict[str, object]]:
    """Make a situation; return the keys of the sources that belong to it."""
    if situation != "missing key":
        keyed(monkeypatch, "wrong" if situation == "wrong key" else KEY)
    match situation:
        case "quota":
            services.statuses["/ot/"], services.retry_after = [429] * 99, "0"
        case "down":
            services.statuses["/"] = [503] * 99
        case "unreachable":
            return {name: {"address": "http://127.0.0.1:9/x"} for name in ("opentopography_cop30", "landfire")}
        case "truncated":
            services.cut["/ot/"] = services.cut["/lfps/result"] = 99
        case "silent":
            services.stall_s = 1.0
        case "full disk":
            monkeypatch.setattr("ltm_ros.site_setup.web.free_bytes", lambda path: 1000)
        case "failed job":
            services.job_states = ["Executing", "Failed"]
        case "no region":
            services.fuel_years, services.statuses["/ot/"] = {}, [204] * 9
    return {}


@pytest.mark.parametrize(
    ("situation", "topography", "fuel"),
    [
        ("wrong key", "key", ""),
        ("missing key", "OPENTOPOGRAPHY_API_KEY", "LANDFIRE_EMAIL"),
        ("quota", "429", ""),
        ("down", "503", "503"),
        ("unreachable", "127.0.0.1", "127.0.0.1"),
        ("truncated", "127.0.0.1", "127.0.0.1"),
        ("silent", "127.0.0.1", "127.0.0.1"),
        ("full disk", "MB", "MB"),
        ("failed job", "", "ERROR 001"),
        ("no region", "204", "FBFM40"),
    ],
)
def test_a_situation_is_a_clear_error_and_leaves_no_file(
    situation: str, topography: str, fuel: str, services: SiteServices, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    further = arrange(situation, services, monkeypatch)
    listed = services.loaded(tmp_path, 0.2 if situation == "silent" else 5.0, **further)
    cases: list[tuple[Kind, str, str]] = [("dem", "opentopography_cop30", topography), ("fuel", "landfire", fuel)]
    for kind, name, said in cases:
        if said:
            with pytest.raises(LtmError, match=said) as error:
                choose(kind, HERE, only(name, listed)).fetch(tmp_path / "out", silent)
            assert KEY not in str(error.value)
    assert not [path for path in tmp_path.rglob("*") if path.suffix in (".tif", ".zip") or path.parent.name == "out"]


@pytest.mark.parametrize(
    ("area", "names"),
    [
        (area_around(-30.0, 20.0, 8000.0), "copernicus_glo30"),  # ocean
        (area_around(-118.47, 34.09, 1_000_000.0), "million|km2"),  # huge
        (area_around(-118.47, 34.09, 8000.0), "copernicus_glo30"),  # no tile on the server
    ],
)
def test_an_area_without_a_source_names_the_reason_of_each(
    area: Area, names: str, services: SiteServices, tmp_path: Path
) -> None:
    with pytest.raises(NoCoverageError, match=names) as error:
        choose("dem", area, services.loaded(tmp_path))
    elevation = [source for source in load_sources() if "dem" in source.kinds]
    assert all(source.name in str(error.value) for source in elevation)


@pytest.mark.parametrize(
    ("place", "elevation", "fuel"),
    [
        ((-118.47, 34.09), "usgs_3dep_10m", {"landfire": 2024}),
        ((-147.7, 64.8), "usgs_3dep_10m", {"landfire": 2022}),  # Alaska: not in the newest edition
        ((-155.6, 19.6), "usgs_3dep_10m_hawaii", {}),
        ((7.0, 44.0), "copernicus_glo30", {}),
        ((148.3, -36.5), "copernicus_glo30", {}),
    ],
)
def test_place_decides_the_source(
    place: tuple[float, float], elevation: str, fuel: dict[str, int], services: SiteServices, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    keyed(monkeypatch)
    services.fuel_years = {2022: 1.0, 2024: 1.0}
    area, (lon, lat) = area_around(*place, 3000.0), place
    west, south = int(np.floor(lon)), int(np.floor(lat))
    tile = geotiff(np.ones((360, 360), np.float32), "EPSG:4326", west, south + 1, 1 / 360)
    east_west, north_south = "we"[west >= 0], "sn"[south >= 0]
    if lon < -100:
        services.files[f"/cog/USGS_13_n{south + 1:02d}w{-west:03d}.tif"] = tile
    else:
        corner = f"{north_south}{abs(south):02d}_00_{east_west}{abs(west):03d}".upper()
        services.files[f"/cog/GLO30_{corner}.tif"] = tile
    listed = services.loaded(tmp_path)
    assert choose("dem", area, listed).source.name == elevation
    if fuel:
        choice = choose("fuel", area, listed)
        assert {choice.source.name: choice.plan.year} == fuel
    else:
        with pytest.raises(NoCoverageError):
            choose("fuel", area, listed)


def test_a_service_that_is_down_gives_way_to_the_next_source_with_a_note(
    services: SiteServices, tmp_path: Path
) -> None:
    services.files["/cog/USGS_13_n35w119.tif"] = geotiff(
        np.ones((360, 360), np.float32), "EPSG:4269", -119, 35.0, 1 / 360
    )
    services.statuses["/tnm/"] = [502] * 99
    choice = choose("dem", HERE, services.loaded(tmp_path))
    assert choice.source.name == "usgs_3dep_10m"
    assert "502" in choice.plan.notes[0]


def test_an_old_fuel_map_is_noted_with_its_year(services: SiteServices, tmp_path: Path) -> None:
    services.fuel_years = {2016: 1.0}
    listed = only("landfire_wcs", services.loaded(tmp_path, landfire_wcs={"year": 2016}))
    assert "2016" in choose("fuel", HERE, listed).plan.notes[0]


def test_requests_go_through_the_proxy_of_the_environment(
    services: SiteServices, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HTTP_PROXY", services.url)
    services.files["/f"] = PLAIN_FILE
    assert Web(tmp_path / "cache").get("http://elevation.invalid/f") == PLAIN_FILE


@pytest.mark.parametrize("proxy", ["socks5://127.0.0.1:1080", "nonsense://127.0.0.1:1"])
def test_a_proxy_that_cannot_be_used_is_a_clear_error(proxy: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ALL_PROXY", proxy)
    with pytest.raises(FetchError, match="PROXY"):
        Web()


@pytest.mark.parametrize("address", ["http://[bad/x", "http://127.0.0.1:999999/x", "http://xn--\u2603.invalid/x"])
def test_an_address_that_is_none_is_a_clear_error(address: str, services: SiteServices, tmp_path: Path) -> None:
    with pytest.raises(LtmError):
        choose("fuel", HERE, only("landfire_wcs", services.loaded(tmp_path, landfire_wcs={"address": address})))


@pytest.mark.parametrize(
    ("labels", "low", "high", "first", "steps"),
    [
        ("Long Lat", "-10 40", "0 50", "-9.9 49.9", ("0.2 0", "0 -0.2")),
        ("Lat Long", "40 -10", "50 0", "49.9 -9.9", ("0 0.2", "-0.2 0")),
    ],
)
def test_a_coverage_is_cut_at_the_edges_of_its_cells(
    labels: str, low: str, high: str, first: str, steps: tuple[str, str]
) -> None:
    xml = f"""<c:d xmlns:g="gml"><g:Envelope axisLabels="{labels}" srsName="urn:ogc:def:crs:EPSG::4326">
      <g:lowerCorner>{low}</g:lowerCorner><g:upperCorner>{high}</g:upperCorner></g:Envelope><g:pos>{first}</g:pos>
      <g:offsetVector>{steps[0]}</g:offsetVector><g:offsetVector>{steps[1]}</g:offsetVector></c:d>"""
    grid = CoverageGrid(xml, "here")
    assert grid.labels == ("Long", "Lat")
    bounds, cells = grid.cut(Area((-5.05, 44.95, -4.35, 45.25)), "here")
    assert bounds == pytest.approx((-5.6, 44.4, -3.8, 45.8))
    assert cells == 9 * 7


def test_the_page_lists_the_sources() -> None:
    page = project_path("docs/site.md").read_text(encoding="utf-8")
    listed = load_sources()
    assert {kind for source in listed for kind in source.kinds} == set(get_args(Kind))
    assert not [source.name for source in listed if f"`{source.name}`" not in page]


def test_names_and_keys_that_do_not_exist_are_errors(services: SiteServices, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="adress"):
        services.loaded(tmp_path, copernicus_glo30={"adress": "x"})
    (tmp_path / "bad.yaml").write_text("usgs_3dep_1m: {year: 2020}\n")
    with pytest.raises(ConfigError):
        load_sources(tmp_path / "bad.yaml")


def test_a_download_continues_where_it_broke_off(services: SiteServices, tmp_path: Path) -> None:
    services.files["/f"] = PLAIN_FILE
    web = Web(tmp_path / "cache", 0.01, 3.0)
    remote = web.remote(f"{services.url}/f")
    services.cut["/f"] = 2
    services.bytes_sent = 0
    path = web.download(f"{services.url}/f", silent, remote=remote)
    assert path.read_bytes() == PLAIN_FILE
    assert services.bytes_sent == len(PLAIN_FILE)
    assert web.download(f"{services.url}/f", silent, remote=remote) == path
    assert services.bytes_sent == len(PLAIN_FILE)


def test_a_file_with_a_wrong_checksum_is_not_kept(services: SiteServices, tmp_path: Path) -> None:
    services.files["/cog/mine.tif"] = geotiff(np.ones((80, 90), np.float32), "EPSG:4326", -118.6, 34.2, 0.004)
    mine = {"kinds": ["dem"], "protocol": "url", "address": f"{services.url}/cog/mine.tif", "licence": "mine",
            "resolution_m": 400, "sha256": "0" * 64}  # fmt: skip
    choice = choose("dem", HERE, services.loaded(tmp_path, mine=mine))
    with pytest.raises(FetchError, match="0000"):
        choice.fetch(tmp_path / "out", silent)
    assert not [path for path in tmp_path.rglob("*") if path.suffix in (".tif", ".part")]


def test_a_disk_that_fills_up_while_it_is_written_is_a_clear_error(services: SiteServices, tmp_path: Path) -> None:
    services.files["/f"] = PLAIN_FILE
    web = Web(tmp_path / "cache", 0.01, 3.0)
    limits, handler = resource.getrlimit(resource.RLIMIT_FSIZE), signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, limits[1]))
    try:
        with pytest.raises(FetchError, match="cache"):
            web.download(f"{services.url}/f", silent)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, handler)
