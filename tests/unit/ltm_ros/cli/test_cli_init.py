"""`ltm init` against the data services on loopback."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import rasterio
from scenes.site_services import SiteServices, geotiff, grid
from typer.testing import CliRunner, Result

from ltm_core.base.errors import ConfigError, LtmError
from ltm_core.site.site_io import load_site
from ltm_ros.cli.main import cli

LON, LAT = -118.47, 34.09


def height(lon: np.ndarray, lat: np.ndarray) -> np.ndarray:
    return 300.0 + 4000.0 * (lon + 118.6) + 2000.0 * (lat - 33.9)


@pytest.fixture
def services(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[SiteServices]:
    """Elevation in NAD83 degrees and, coarser, in WGS 84 degrees; LANDFIRE's codes."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("LANDFIRE_EMAIL", "a@b.c")
    monkeypatch.setattr("ltm_ros.site_setup.services.LandfireSource.poll_s", 0.01)
    with SiteServices() as running:
        fine = height(*grid(-118.53, 34.15, 1 / 10800, 1300, 1300)).astype(np.float32)
        running.files["/cog/USGS_13_n35w119.tif"] = geotiff(fine, "EPSG:4269", -118.53, 34.15, 1 / 10800)
        for south in (33, 34):
            for west in (118, 119):
                coarse = height(*grid(-west, south + 1, 1 / 400, 400, 400)).astype(np.float32)
                name = f"/cog/GLO30_N{south}_00_W{west}.tif"
                running.files[name] = geotiff(coarse, "EPSG:4326", -west, south + 1, 1 / 400)
        yield running


def init(services: SiteServices, tmp_path: Path, *more: str, given: str = "") -> Result:
    sources = services.sources(tmp_path / "sources.yaml")
    arguments = ["init", "--out", str(tmp_path / "getty"), "--sources", str(sources), *more]
    return CliRunner().invoke(cli, arguments, input=given, catch_exceptions=False)


NEW = ("--lonlat", f"{LON},{LAT}", "--name", "getty", "--radius", "1.5km")
NORTH = ("--camera", f"north={LON},{LAT},height=20,azimuth=214,hfov=54")


def test_a_point_on_the_map_becomes_a_checked_site(services: SiteServices, tmp_path: Path) -> None:
    result = init(services, tmp_path, *NEW, *NORTH)
    assert result.exit_code == 0, result.output
    assert f"ltm run {tmp_path}/getty/site.yaml" in result.output.replace("\n", "")
    assert (tmp_path / "getty/check.png").read_bytes()[:4] == b"\x89PNG"
    site = load_site(tmp_path / "getty/site.yaml")
    assert site.crs == "EPSG:32611"
    dem = site.open_dem()
    x, y = site.frame.from_lonlat(LON, LAT)
    assert float(dem.elevation_at(x, y)) == pytest.approx(height(LON, LAT), abs=0.1)
    assert dem.geometry.resolution == 10
    far = site.frame.from_lonlat(LON, LAT + 0.34)
    assert float(dem.elevation_at(*far)) == pytest.approx(height(LON, LAT + 0.34), abs=1)
    with rasterio.open(tmp_path / "getty/fuel/fbfm40.tif") as source:
        assert set(np.unique(source.read(1))) <= {*range(101, 110)}
    assert site.fuel.prior is not None


def test_a_dry_run_states_sizes_and_fetches_nothing(services: SiteServices, tmp_path: Path) -> None:
    result = init(services, tmp_path, *NEW, "--dry-run")
    assert result.exit_code == 0
    assert "MB" in result.output
    assert "usgs_3dep_10m" in result.output
    assert not (tmp_path / "getty").exists()
    assert services.count("job/submit") == 0


def test_much_data_is_fetched_only_after_a_yes(
    services: SiteServices, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ltm_ros.cli.init._ASK_FROM", 1000)
    assert init(services, tmp_path, *NEW, given="n\n").exit_code == 1
    assert not (tmp_path / "getty").exists()
    assert init(services, tmp_path, *NEW, given="y\n").exit_code == 0


def test_sources_are_listed(services: SiteServices) -> None:
    result = CliRunner().invoke(cli, ["init", "--sources", "list"], env={"COLUMNS": "300"})
    assert result.exit_code == 0
    for name in ("usgs_3dep_1m", "copernicus_glo30", "landfire", "EPSG:5703"):
        assert name in result.output
    assert services.requests == []


def test_cameras_of_a_list_outside_the_radius_are_left_out(services: SiteServices, tmp_path: Path) -> None:
    rows = f"name,lon,lat,azimuth,hfov\nnear,{LON},{LAT},10,50\nfar,{LON - 1},{LAT},,\n"
    (tmp_path / "cameras.csv").write_text(rows)
    result = init(services, tmp_path, *NEW, "--cameras", str(tmp_path / "cameras.csv"))
    assert result.exit_code == 0, result.output
    assert set(load_site(tmp_path / "getty/site.yaml").cameras) == {"near"}
    (tmp_path / "cameras.csv").write_text(rows.splitlines()[0] + f"\nfar,{LON - 1},{LAT},,\n")
    with pytest.raises(ConfigError, match=r"cameras\.csv"):
        init(services, tmp_path, *NEW, "--cameras", str(tmp_path / "cameras.csv"))


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("--lonlat", "34.09", "--name", "a"), "34.09"),
        (("--lonlat", "34.09,-118.47", "--name", "a"), "latitude"),
        ((*NEW[:4], "--radius", "8"), "--radius 8"),
        ((*NEW[:4], "--radius", "8000km"), "8000km"),
        (("--lonlat", "-140.0,34.0", "--name", "sea"), "copernicus_glo30"),
        (("--update", "fuel"), "site.yaml"),
    ],
)
def test_wrong_options_are_errors(
    arguments: tuple[str, ...], told: str, services: SiteServices, tmp_path: Path
) -> None:
    with pytest.raises(LtmError, match=told):
        init(services, tmp_path, *arguments)
    assert not (tmp_path / "getty").exists()


def test_a_site_without_a_horizon_says_which_service_failed(
    services: SiteServices, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ltm_ros.site_setup.web.time.sleep", lambda seconds: None)
    services.statuses["GLO30"] = [503] * 1000
    result = init(services, tmp_path, *NEW)
    assert result.exit_code == 0
    assert "503" in result.output
    assert load_site(tmp_path / "getty/site.yaml").coarser == ()
