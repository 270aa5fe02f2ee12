"""Mistakes of users, each through the command line: the message holds the place, the exit code says what kind it
is, there is no traceback, and nothing has been written.
"""

import socket
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from PIL import Image
from scenes.small_site import MAST, write_small_site

import ltm_ros.launching.site_check
from ltm_core.fuel.life_form import NODATA
from ltm_core.geometry.grid import GridGeometry
from ltm_core.raster.dem import Dem
from ltm_core.raster.raster_io import write_geotiff
from ltm_ros.cli import main
from ltm_ros.launching.site_check import examine

X, Y = 480_330.0, 4_150_290.0
"""Where the mast stands."""
FUELS = GridGeometry(480_015.0, 4_150_915.0, 30.0, 40, 30, "EPSG:26911")

Change = Callable[[Path], None]


def site_with(**changes: Any) -> Change:
    def write(folder: Path) -> None:
        path = folder / "site.yaml"
        site = yaml.safe_load(path.read_text())
        path.write_text(yaml.safe_dump(site | changes))

    return write


def mast_with(**changes: Any) -> Change:
    """Changes of the mast's pose; None takes a key out."""

    def write(folder: Path) -> None:
        path = folder / "site.yaml"
        site = yaml.safe_load(path.read_text())
        pose = site["cameras"]["mast"]["pose"] | changes
        site["cameras"]["mast"]["pose"] = {key: value for key, value in pose.items() if value is not None}
        path.write_text(yaml.safe_dump(site))

    return write


def fuels(**bands: float) -> Change:
    """A prior folder of single bands, each of one value everywhere."""

    def write(folder: Path) -> None:
        (folder / "fuels").mkdir()
        for name, value in bands.items():
            write_geotiff(folder / f"fuels/{name}.tif", np.full(FUELS.shape, value, np.int16), FUELS, nodata=NODATA)
        site_with(fuel={"prior": "fuels"})(folder)

    return write


def pose_file(width: int = 64, height: int = 40, **changes: Any) -> Change:
    def write(folder: Path) -> None:
        pose = {"x": X, "y": Y, "height_above_ground": 30, "azimuth_deg": 48, "pitch_deg": -12}
        lens = {"width": width, "height": height, "hfov_deg": 60}
        content = {"pose": pose | changes, "calibration": lens}
        (folder / "pose.yaml").write_text(yaml.safe_dump(content))

    return write


def portrait(folder: Path) -> None:
    """A photo whose EXIF turns it, and a pose file of the image as it is stored."""
    image = Image.fromarray(np.zeros((MAST.height, MAST.width, 3), np.uint8))
    exif = image.getexif()
    exif[0x0112] = 6
    exif.get_ifd(0x8769)[0x9003] = "2024:07:04 18:30:15"
    (folder / "photos").mkdir()
    image.save(folder / "photos/a.jpg", exif=exif.tobytes())
    (folder / "poses.csv").write_text(f"name,x,y,height_above_ground,azimuth_deg,fx\na.jpg,{X},{Y},30,48,210\n")
    pose_file(MAST.width, MAST.height)(folder)


def former_result(folder: Path) -> None:
    pose_file()(folder)
    (folder / "out").mkdir()
    (folder / "out/depth.tif").write_text("of another day")


def dem_with_nodata(folder: Path) -> None:
    import rasterio

    with rasterio.open(folder / "dem.tif", "r+") as sink:
        heights = sink.read(1)
        heights[:2, :3] = -9999.0
        sink.write(heights, 1)


def canopy_heights(folder: Path) -> None:
    dem = Dem.open(folder / "dem.tif")
    tops = np.where(np.arange(dem.geometry.width) % 4 == 0, 12.0, 0.0)
    Dem(np.broadcast_to(tops, dem.geometry.shape).astype(np.float32), dem.geometry).save(folder / "chm.tif")
    site_with(surface={"path": "chm.tif"})(folder)


def nothing(folder: Path) -> None:
    (folder / "file").touch()


def workspace(folder: Path) -> None:
    """A folder that colcon has built in: it has `log`, as a demo's has."""
    for name in ("log", "src"):
        (folder / "work" / name).mkdir(parents=True)
        (folder / "work" / name / "file").touch()


@dataclass(frozen=True)
class Mistake:
    name: str
    make: Change
    command: str
    says: tuple[str, ...]
    status: int = 1
    options: tuple[str, ...] = field(default=())


CHECK = "check site.yaml"
TRACE = "trace --dem dem.tif --pose pose.yaml --out out"
MISTAKES = [
    Mistake("azimuth off the circle", mast_with(azimuth_deg=999), CHECK, ("site.yaml", "999")),
    Mistake("a DEM in feet", fuels(fbfm40=102, dem=round(850 * 0.3048)), CHECK, ("dem.tif", "feet")),
    Mistake("undeclared nodata", dem_with_nodata, CHECK, ("dem.tif", "-9999"), 0),
    Mistake("canopy height model as surface", canopy_heights, CHECK, ("chm.tif", "canopy height model")),
    Mistake("no DEM there", site_with(dem={"path": "dom.tif"}), CHECK, ("dom.tif",)),
    Mistake("a swapped origin", site_with(origin=[4_150_015.0, 480_015.0]), CHECK, ("[480015, 4150015]",)),
    Mistake("a camera under the ground", mast_with(z=700.0, height_above_ground=None), CHECK, ("mast", "z = 700 m")),
    Mistake("another zone than the DEM's", site_with(crs="EPSG:26910"), "run site.yaml", ("EPSG:26911",), 78),
    Mistake("a misspelt key", site_with(depthmodel="x"), CHECK, ("depthmodel", "depth_model")),
    Mistake("a misspelt parameter", site_with(nodes={"capture": {"max_weit": 2}}), "run site.yaml", ("max_wait",), 78),
    Mistake("two revisions of the fuel codes", fuels(fbfm40b=102, fbfm40r5=102), CHECK, ("fbfm40b.tif, fbfm40r5.tif",)),
    Mistake("a wrong CRS in a pose file", pose_file(crs="EPSG:26910"), TRACE, ("EPSG:26910",)),
    Mistake("a photo that EXIF turns", portrait, TRACE, ("144 x 256",), options=("--image", "photos/a.jpg")),
    Mistake("a demo in a folder of other files", workspace, "demo --out work", ("work", "--out")),
    Mistake("a former result", former_result, TRACE, ("depth.tif", "--overwrite")),
    *(
        Mistake(f"no place to write, {command.split()[0]}", nothing, command, ("file", "not a folder"))
        for command in (
            "trace --dem dem.tif --pose pose.yaml --out file/out",
            "replay recording --site site.yaml --out file/out --offline",
            "run site.yaml --state file/map",
            "record --site site.yaml --out file/bag",
            "pose points points.csv --guess pose.yaml --out file/fitted.yaml",
            "viewshed --site site.yaml --out file/coverage.tif",
            "import photos --site site.yaml --out file/bag",
            "check site.yaml --out file/check.png",
        )
    ),
]


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def run_app(arguments: list[str], folder: Path, monkeypatch: pytest.MonkeyPatch) -> int:
    """The command as a user starts it, in this process; its exit status. Anything but an exit is a traceback."""
    monkeypatch.chdir(folder)
    monkeypatch.setenv("COLUMNS", "1000")
    monkeypatch.setattr(sys, "argv", ["ltm", *arguments])
    # In this process, so that thirty of them take seconds; `test_cli_run` has one in a process of its own.
    monkeypatch.setattr(ltm_ros.launching.site_check, "examined_apart", lambda *asked: examine(*asked).findings)
    with pytest.raises(SystemExit) as ended:
        main.app()
    return int(ended.value.code or 0)


@pytest.mark.parametrize("mistake", MISTAKES, ids=lambda mistake: mistake.name)
def test_mistake(
    mistake: Mistake, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write_small_site(tmp_path, recording=False)
    mistake.make(tmp_path)
    before = contents(tmp_path)
    status = run_app([*mistake.command.split(), *mistake.options], tmp_path, monkeypatch)
    written = capsys.readouterr()
    said = f"{written.out}\n{written.err}"
    for part in mistake.says:
        assert part in said
    assert status == mistake.status, said
    assert "Traceback" not in said
    assert contents(tmp_path) == before


def test_a_site_without_a_mistake(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """None of the above is said of a site that is as it should be."""
    write_small_site(tmp_path, recording=False)
    fuels(fbfm40=102, dem=850)(tmp_path)
    assert run_app(["check", "site.yaml", "--out", "check.png"], tmp_path, monkeypatch) == 0
    said = capsys.readouterr().out
    doubts = [line for line in said.splitlines() if " doubtful " in line or " wrong " in line]
    # The site's network is of the test alone, and so was never measured.
    assert all("/dev/shm" in line or "label errors" in line for line in doubts)
    assert "mast" in said
    assert "looks north-east (48 deg), 12 deg down" in said
    with Image.open(tmp_path / "check.png") as picture:
        assert picture.width > 1500
    assert run_app(["check", "site.yaml", "--out", "check.png"], tmp_path, monkeypatch) == 1
    assert "check.png: exists already" in capsys.readouterr().err


def test_a_port_that_is_taken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write_small_site(tmp_path, recording=False)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        site_with(nodes={"viewer": {"web_port": port}})(tmp_path)
        assert run_app(["run", "site.yaml", "--view"], tmp_path, monkeypatch) == 1
    said = capsys.readouterr().err
    assert f"port {port} on 127.0.0.1" in said
    assert "viewer.web_port" in said
