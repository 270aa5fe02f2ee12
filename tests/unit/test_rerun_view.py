"""The Rerun view: geometry of the scene, what a recording then holds, and what its server listens on."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections import defaultdict
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from ltm_core.camera import Camera
from ltm_core.dem import Dem
from ltm_core.errors import ConfigError, ImageError, RasterError, RecordingError
from ltm_core.fuel.codes import FuelSystem, fuel_models
from ltm_core.grid import GridGeometry
from ltm_core.pose import Pose
from ltm_core.site import Site
from ltm_core.vision.labels import LabelSet

pytest.importorskip("rerun", reason="the viewer's extra is not installed")

from ltm_ros.cli.view import view as view_command
from ltm_ros.rerun_view import RerunView, frames, scene
from ltm_ros.rerun_view.change import ChangePicture
from ltm_ros.rerun_view.screenshot import screenshot
from ltm_ros.rerun_view.server import RerunProcess, grpc_url, listens, web_url
from ltm_ros.rerun_view.tabs import with_tab

LABELS = LabelSet.load()
STAMP = 1_700_000_000_123_456_789


def hills(rows: int = 70, cols: int = 110, resolution: float = 30.0) -> Dem:
    geometry = GridGeometry(-1500.0, 1200.0, resolution, cols, rows)
    x, y = geometry.to_map(*np.mgrid[:rows, :cols])
    return Dem((400 + 90 * np.sin(x / 310) + 70 * np.cos(y / 230) + 0.05 * x).astype(np.float32), geometry)


def site(**cameras: dict[str, Any]) -> Site:
    return Site(
        name="ridge", crs="EPSG:32611", origin=(386_000.0, 3_796_000.0), dem={"path": "dem.tif"}, cameras=cameras
    )


def chunks(path: Path) -> dict[str, list[dict[str, Any]]]:
    """Rows of every entity of a recording: component -> value."""
    from rerun.chunk import RrdReader

    rows: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for chunk in RrdReader(str(path)).stream():
        batch = chunk.to_record_batch()
        columns = [
            column.cast("int64") if str(column.type).startswith("timestamp") else column for column in batch.columns
        ]
        for values in zip(*(column.to_pylist() for column in columns), strict=True):
            rows[str(chunk.entity_path)].append(dict(zip(batch.schema.names, values, strict=True)))
    return rows


def test_decimated_terrain_keeps_every_height_at_its_place() -> None:
    dem = hills()
    for most in (100_000, 3000, 700):
        coarse = scene.decimated(dem, most)
        rows, cols = coarse.elevation.shape
        assert 2 * (rows - 1) * (cols - 1) <= most
        x, y = coarse.geometry.to_map(*np.mgrid[:rows, :cols])
        np.testing.assert_allclose(dem.elevation_at(x, y), coarse.elevation, atol=1e-3)


def test_terrain_mesh_faces_up_and_skips_what_is_unknown() -> None:
    dem = hills()
    elevation = dem.elevation.copy()
    elevation[10, 20] = np.nan
    mesh = scene.terrain_mesh(Dem(elevation, dem.geometry))
    assert len(mesh.triangles) == 2 * 69 * 109 - 6, "a lone vertex belongs to six triangles"
    corners = mesh.vertices[mesh.triangles].astype(np.float64)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (normals[:, 2] > 0).all()
    assert np.isfinite(mesh.vertices).all()
    assert mesh.texcoords.min() > 0
    assert mesh.texcoords.max() < 1
    north_west = np.argmin(mesh.vertices[:, 0] - mesh.vertices[:, 1])
    np.testing.assert_allclose(mesh.texcoords[north_west], (0.5 / 110, 0.5 / 70), rtol=1e-4)


def test_large_terrain_stays_within_its_budget() -> None:
    rng = np.random.default_rng(1)
    dem = Dem(rng.normal(500, 20, (900, 2500)).astype(np.float32), GridGeometry(0.0, 0.0, 3.0, 2500, 900))
    mesh = scene.terrain_mesh(dem, 50_000)
    assert len(mesh.triangles) <= 50_000
    assert max(mesh.texture.shape[:2]) <= scene.MAX_TEXTURE


def test_fuel_cells_lie_just_above_the_drawn_terrain() -> None:
    dem = hills()
    geometry = GridGeometry(-600.0, 900.0, 30.0, 50, 40)
    layer = scene.FuelLayer(dem, geometry, LABELS)
    classes = np.full(geometry.shape, 255, np.uint8)
    classes[33, 45] = 3
    (tile,) = layer.changed(classes)
    assert tile.name == "r001_c001"
    x, y = geometry.to_map([32.5, 33.5], [44.5, 45.5])
    np.testing.assert_allclose(np.unique(tile.vertices[:, 0]), x, atol=1e-3)
    np.testing.assert_allclose(np.unique(tile.vertices[:, 1]), np.sort(y), atol=1e-3)
    above = tile.vertices[:, 2] - dem.elevation_at(tile.vertices[:, 0], tile.vertices[:, 1])
    np.testing.assert_allclose(above, 3.6, atol=1e-2)
    np.testing.assert_array_equal(tile.colors, [LABELS.colors[3]] * 4)
    corners = tile.vertices[tile.triangles].astype(np.float64)
    assert (np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] > 0).all()


def test_fuel_layer_gives_only_what_has_changed() -> None:
    geometry = GridGeometry(-600.0, 900.0, 30.0, 50, 40)
    layer = scene.FuelLayer(hills(), geometry, LABELS)
    classes = np.full(geometry.shape, 255, np.uint8)
    assert list(layer.changed(classes)) == []
    classes[2, 3] = classes[2, 40] = classes[35, 4] = 1
    assert [tile.name for tile in layer.changed(classes)] == ["r000_c000", "r000_c001", "r001_c000"]
    assert list(layer.changed(classes)) == []
    classes[2, 40] = 255
    (emptied,) = layer.changed(classes)
    assert emptied.name == "r000_c001"
    assert len(emptied.triangles) == len(emptied.vertices) == 0
    with pytest.raises(RasterError, match=r"\(40, 49\)"):
        list(layer.changed(classes[:, 1:]))


def test_eye_starts_behind_the_cameras_and_above_the_ground() -> None:
    dem = hills()
    eye = scene.overview_eye(dem, np.array([[0.0, 300.0, 500.0], [200.0, 300.0, 520.0]]), np.array([170.0, 190.0]), 900)
    assert eye.position[1] > 300, "both look south, so the eye is north of them"
    assert eye.target[1] < 300
    assert eye.position[2] > dem.elevation_at(*eye.position[:2]) or np.isnan(dem.elevation_at(*eye.position[:2]))
    alone = scene.overview_eye(dem, np.empty((0, 3)), np.empty(0), 900)
    assert alone.position[1] < alone.target[1]
    opposed = scene.overview_eye(dem, np.zeros((2, 3)), np.array([0.0, 180.0]), 900)
    assert np.isfinite([*opposed.position, *opposed.target]).all()


def test_points_are_thinned_and_finite() -> None:
    points = np.arange(3000, dtype=np.float64).reshape(1000, 3)
    points[::10] = np.nan
    kept = scene.thinned(points, 200)
    assert 100 < len(kept) <= 200
    assert np.isfinite(points[kept]).all()
    assert len(scene.thinned(points, 10_000)) == 900
    assert len(scene.thinned(np.empty((0, 3)), 5)) == 0


def test_shown_pinhole_projects_to_the_middle_of_the_same_place() -> None:
    """Rerun's pixel (0, 0) is the image's corner: half a pixel from ours, before and after shrinking."""
    camera = Camera(1920, 1080, 1400.0, 1410.0, 955.0, 544.0)
    pinhole = frames.pinhole(camera, 100.0)
    fx, _, _, _, fy, _, cx, cy, _ = np.array(pinhole.image_from_camera.as_arrow_array().to_pylist()[0])
    u, v = camera.project(np.array([3.0, -2.0, 10.0]))
    np.testing.assert_allclose([fx * 0.3 + cx, fy * -0.2 + cy], [(u + 0.5) / 2, (v + 0.5) / 2], atol=1e-3)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two cameras, one of them known from the site file, one frame each."""
    path = tmp_path_factory.mktemp("rrd") / "deep" / "site.rrd"
    calibration = {"width": 640, "height": 360, "hfov_deg": 50}
    pose = {"x": 386_300.0, "y": 3_796_400.0, "height_above_ground": 20.0, "azimuth_deg": 190.0}
    dem = hills()
    where = site(north={"calibration": calibration, "pose": pose}, south={})
    view = RerunView("ltm ridge", where, dem, LABELS, save=path)
    rng = np.random.default_rng(3)
    for name, azimuth in (("north", 190.0), ("south", 20.0)):
        camera = Camera.from_fov(1920, 1080, 50.0)
        view.log_pose(name, STAMP, Pose.from_angles((300.0, 400.0, 600.0), azimuth, -5.0), camera)
        rgb = np.full((1080, 1920, 3), (200, 100, 30), np.uint8)
        view.log_image(name, STAMP, rgb)
        depth = np.full((1080, 1920), 700.0, np.float32)
        depth[:300] = np.inf
        view.log_depth(name, STAMP, depth, camera)
        fused = depth.copy()
        fused[600:] = 690.0
        view.log_fusion(name, STAMP, fused, depth, network=None if name == "south" else depth[::4, ::4])
        labels = np.zeros((1080, 1920), np.uint8)
        labels[400:] = 3
        view.log_labels(name, STAMP, labels)
        view.log_points(name, STAMP, rng.normal(0, 300, (40_000, 3)), rng.integers(0, 255, (40_000, 3), np.uint8))
    geometry = where.fuel_geometry(dem)
    classes = np.full(geometry.shape, 255, np.uint8)
    classes[20:30, 40:55] = 2
    view.log_fuel_map(STAMP, classes, geometry)
    kinds = np.full((300, 450), 255, np.uint8)
    kinds[50:200, 60:250] = 0
    kinds[80:90, 100:140] = 1
    view.log_change(STAMP, kinds, GridGeometry(0.0, 300.0, 1.0, 450, 300))
    cells = np.array([[80, 100], [80, 101], [7, 3]], np.int32)
    points = np.array([[100.5, 219.5, 480.0], [101.5, 219.5, 481.0], [3.5, 292.5, 470.0]], np.float32)
    view.log_changed_cells(STAMP, cells, points, np.array([1, 1, 2], np.uint8))
    view.log_changed_cells(STAMP + 9, cells[1:2], points[1:2], np.array([0], np.uint8))
    view.log_diagnostics(STAMP, "/ridge/north/depth", {"rate_hz": 2.0, "latency_p95_ms": 81.5, "dropped": 0.0})
    view.log_text("WARN", "depth: slow")
    with pytest.raises(ImageError, match="south"):
        view.log_depth("south", STAMP, depth[:, :-1], camera)
    with pytest.raises(ImageError, match="south"):
        view.log_fusion("south", STAMP, depth[:, :-1], depth)
    view.close()
    return path


def test_recording_holds_scene_pictures_and_health(recording: Path) -> None:
    rows = chunks(recording)
    latency = [row["Scalars:scalars"] for row in rows["/health/latency_p95_ms/ridge/north/depth"] if "stamp" in row]
    assert latency == [[81.5]]
    assert rows["/log"][0]["TextLog:text"] == ["depth: slow"]
    assert len(rows["/map/terrain"][0]["Mesh3D:vertex_positions"]) == 70 * 110
    (tile, *_) = [row for name, found in rows.items() if name.startswith("/map/fuel/") for row in found]
    assert tile["Mesh3D:albedo_factor"][0] & 0xFF < 255, "one sees the terrain through the fuel layer"
    cells = sum(
        len(r["Mesh3D:triangle_indices"]) // 2 for n, f in rows.items() if n.startswith("/map/fuel/") for r in f
    )
    assert cells == 150
    for camera in ("north", "south"):
        (photo,) = rows[f"/map/cameras/{camera}/photo"]
        assert photo["stamp"] == STAMP
        shown = cv2.imdecode(np.array(photo["EncodedImage:blob"][0], np.uint8), cv2.IMREAD_COLOR)
        assert shown.shape == (540, 960, 3)
        assert np.abs(shown[..., ::-1].reshape(-1, 3).mean(axis=0) - (200, 100, 30)).max() < 6, "RGB, not BGR"
        (labels,) = rows[f"/map/cameras/{camera}/labels"]
        ids = np.array(labels["SegmentationImage:buffer"][0], np.uint8).reshape(540, 960)
        assert set(np.unique(ids)) == {0, 3}
        assert (ids[200:] == 3).all()
        assert len(rows[f"/map/points/{camera}"][0]["Points3D:positions"]) <= 15_000
        assert rows[f"/depth/{camera}"][0]["EncodedImage:media_type"] == ["image/jpeg"]
        difference = cv2.imdecode(
            np.array(rows[f"/fusion/{camera}/difference"][0]["EncodedImage:blob"][0], np.uint8), cv2.IMREAD_COLOR
        )
        assert difference[400].mean() > difference[200].mean() + 20, "ten metres apart is brighter than none"
        assert difference[50].mean() > 200, "the sky of both is sky"
    assert "/fusion/north/network" in rows
    assert "/fusion/south/network" not in rows
    context = rows["/"][0]["AnnotationContext:context"][0]
    names = {entry["class_id"]: entry["class_description"]["info"]["label"] for entry in context}
    assert names[3] == "tree"
    assert names[255] == "unlabelled"


def test_pictures_of_the_fuel_layers_keep_their_size(tmp_path: Path) -> None:
    """A row of JPEGs is a video to the viewer, and it refuses one whose frames differ in size."""
    where, dem = site(north={}), hills()
    view = RerunView("ltm ridge", where, dem, LABELS, save=tmp_path / "a.rrd")
    shape = where.fuel_geometry(dem).shape
    every = np.array(sorted(fuel_models().codes(FuelSystem.FBFM40)), np.int16)
    for moment, codes in enumerate((every[:1], every[10:30], every)):
        rasters = {name: np.ones(shape, np.uint8) for name in ("life_form", "entropy", "changed", "seen_by")}
        view.log_fuel_layers(STAMP + moment, {**rasters, "code": np.resize(codes, shape)})
    view.close()
    rows = chunks(tmp_path / "a.rrd")
    sizes = {
        cv2.imdecode(np.array(row["EncodedImage:blob"][0], np.uint8), cv2.IMREAD_COLOR).shape[0]
        for name in ("code", "life_form", "entropy", "seen_by")
        for row in rows[f"/fuel_layers/{name}"]
    }
    assert len(sizes) == 1


def test_a_node_has_one_colour_in_all_plots(recording: Path) -> None:
    rows = chunks(recording)
    colors = {
        tuple(row["SeriesLines:colors"])
        for name in ("rate_hz", "latency_p95_ms", "dropped")
        for row in rows[f"/health/{name}/ridge/north/depth"]
        if row.get("SeriesLines:colors")
    }
    assert len(colors) == 1
    assert len({frames.distinct_color(k) for k in range(40)}) == 40


def test_recording_holds_what_changed_and_forgets_what_changed_back(recording: Path) -> None:
    rows = chunks(recording)
    first, second = sorted(rows["/map/change"], key=lambda row: row["stamp"])
    assert len(first["Points3D:positions"]) == 3
    np.testing.assert_allclose(second["Points3D:positions"], [[100.5, 219.5, 480.0], [3.5, 292.5, 470.0]])


def test_changes_lie_in_the_map_and_stay_there_as_their_window_grows() -> None:
    under = GridGeometry(-100.0, 500.0, 20.0, 90, 70)
    kinds = np.full((30, 45), 255, np.uint8)
    kinds[8, 10] = 2
    for rows, cols in ((0, 0), (13, 7)):  # further cells to the north and west
        grown = np.pad(kinds, ((rows, 0), (cols, 0)), constant_values=255)
        window = GridGeometry(60.0 - 2.0 * cols, 300.0 + 2.0 * rows, 2.0, 45 + cols, 30 + rows)
        picture = ChangePicture.over(grown, window, under)
        (row, col) = np.argwhere(picture.kinds == 2)[0]
        place = np.array(picture.corner) + picture.pixel * (np.array([col, row]) + 0.5)
        np.testing.assert_allclose(place, [(60 + 21 + 100) / 20, (500 - 300 + 17) / 20])


def test_a_small_change_is_seen_in_a_picture_that_skips_cells() -> None:
    kinds = np.full((1700, 3300), 255, np.uint8)
    kinds[100:1600, 100:3200] = 0
    kinds[799:810, 1995:2006] = 2  # 30 square metres
    geometry = GridGeometry(0.0, 900.0, 0.5, 3300, 1700)
    picture = ChangePicture.over(kinds, geometry, geometry)
    assert max(picture.kinds.shape) <= 1600
    assert picture.kinds[803 // 3, 2000 // 3] == 2
    assert picture.kinds[803 // 3, 2000 // 3 + 3] == 0
    assert picture.kinds[20, 600] == 255
    assert picture.pixel == 3.0


def test_recording_is_small(recording: Path) -> None:
    assert recording.stat().st_size < 4e6


def test_layout_is_explicit_and_fetches_no_map(recording: Path) -> None:
    from rerun.chunk import RrdReader

    blueprints = RrdReader(str(recording)).blueprints()
    assert blueprints
    text = recording.read_bytes()
    assert b"3D" in text
    listing = subprocess.run(
        [sys.executable, "-m", "rerun_cli", "rrd", "print", "-vv", str(recording)], capture_output=True, text=True
    )
    assert "ViewBlueprint" in listing.stdout, listing.stderr[-500:]
    assert "MapBackground" not in listing.stdout
    assert "MapZoom" not in listing.stdout


def test_a_grid_with_other_edges_replaces_the_layer(tmp_path: Path) -> None:
    dem = hills()
    view = RerunView("ltm ridge", site(north={}), dem, LABELS, save=tmp_path / "a.rrd")
    for left in (-600.0, -300.0):
        classes = np.full((30, 40), 255, np.uint8)
        classes[3, 4] = 1
        view.log_fuel_map(STAMP + int(left), classes, GridGeometry(left, 900.0, 30.0, 40, 30))
    view.close()
    rows = chunks(tmp_path / "a.rrd")
    west = [min(v[0] for v in row["Mesh3D:vertex_positions"]) for row in rows["/map/fuel/r000_c000"]]
    assert west == [-480.0, -180.0]


@pytest.fixture
def ports() -> tuple[int, int]:
    with socket.socket() as a, socket.socket() as b:
        a.bind(("127.0.0.1", 0))
        b.bind(("127.0.0.1", 0))
        return a.getsockname()[1], b.getsockname()[1]


def listening(port: int) -> list[str]:
    """Local addresses, in hex as the kernel prints them, of the sockets that listen at a port."""
    found = []
    for table in ("tcp", "tcp6"):
        for line in Path(f"/proc/net/{table}").read_text().splitlines()[1:]:
            address, state = line.split()[1], line.split()[3]
            if state == "0A" and int(address.split(":")[1], 16) == port:
                found.append(address.split(":")[0])
    return found


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc/net")
def test_server_listens_on_loopback_only_and_ends_with_the_view(tmp_path: Path, ports: tuple[int, int]) -> None:
    web, grpc = ports
    view = RerunView("ltm ridge", site(north={}), hills(), LABELS, serve=True, web_port=web, grpc_port=grpc)
    try:
        assert view.url == web_url(web, grpc)
        assert listening(web) == ["0100007F"]
        assert listening(grpc) == ["0100007F"]
        with pytest.raises(ConfigError, match=f"port {web}"):
            RerunProcess.serve(web, grpc)
    finally:
        view.close()
    assert not listens(web)
    assert not listens(grpc)


@pytest.mark.skipif(sys.platform != "linux", reason="the parent-death signal is Linux's")
def test_server_ends_when_its_process_is_killed(ports: tuple[int, int]) -> None:
    web, grpc = ports
    code = (
        "import time\nfrom ltm_ros.rerun_view.server import RerunProcess\n"
        f"RerunProcess.serve({web}, {grpc})\nprint('up', flush=True)\ntime.sleep(60)\n"
    )
    owner = subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, cwd=Path(__file__).parents[2]
    )
    try:
        assert owner.stdout is not None
        assert owner.stdout.readline() == "up\n"
        assert listens(grpc)
    finally:
        os.kill(owner.pid, signal.SIGKILL)
        owner.wait()
    deadline = time.monotonic() + 10
    while listens(grpc) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not listens(grpc)


def test_an_unchanged_fuel_map_is_not_written_again(tmp_path: Path) -> None:
    view = RerunView("ltm ridge", site(north={}), hills(), LABELS, save=tmp_path / "a.rrd")
    geometry = GridGeometry(-600.0, 900.0, 30.0, 40, 30)
    classes = np.full((30, 40), 255, np.uint8)
    for moment in range(6):
        classes[3, 4] = 1 + moment // 3
        view.log_fuel_map(STAMP + moment, classes, geometry)
    view.close()
    rows = chunks(tmp_path / "a.rrd")
    assert [row["stamp"] - STAMP for row in rows["/fuel_map/classes"]] == [0, 3]
    assert [row["stamp"] - STAMP for row in rows["/map/fuel/r000_c000"]] == [0, 3]


@pytest.mark.parametrize(
    ("given", "error", "remedy"),
    [
        ({}, ConfigError, "either --site"),
        ({"site": Path("a.yaml"), "rrd": Path("b.rrd")}, ConfigError, "not both"),
        ({"rrd": Path("no/such.rrd")}, RecordingError, r"no/such\.rrd: no such recording"),
        ({"site": Path("a.yaml"), "screenshot": Path("a.png")}, ConfigError, "give --rrd"),
        ({"rrd": Path("a.rrd"), "tab": "Fuel"}, ConfigError, "--screenshot"),
    ],
)
def test_view_command_refuses_what_it_cannot_show(given: dict[str, Any], error: type[Exception], remedy: str) -> None:
    with pytest.raises(error, match=remedy):
        view_command(**given)


def test_urls_name_the_loopback() -> None:
    assert grpc_url(9876) == "rerun+http://127.0.0.1:9876/proxy"
    assert web_url(9090, 9876) == "http://127.0.0.1:9090/?url=rerun%2Bhttp%3A%2F%2F127.0.0.1%3A9876%2Fproxy"


def test_screenshot_refuses_what_it_cannot_draw(tmp_path: Path, recording: Path) -> None:
    with pytest.raises(RecordingError, match="no such recording"):
        screenshot(tmp_path / "none.rrd", tmp_path / "a.png")
    with pytest.raises(RecordingError, match=r"\.png"):
        screenshot(recording, tmp_path / "a.jpg")


def test_a_tab_is_chosen_by_its_name() -> None:
    told = {
        "/viewport": {"ViewportBlueprint": {"root_container": "a"}},
        "/container/a": {
            "ContainerBlueprint": {
                "active_tab": "container/b",
                "container_kind": "Tabs",
                "contents": ["container/b", "container/c", "view/d"],
            }
        },
        "/container/b": {"ContainerBlueprint": {"container_kind": "Vertical", "display_name": "Site"}},
        "/container/c": {"ContainerBlueprint": {"container_kind": "Grid", "display_name": "Fuel"}},
        "/view/d": {"ViewBlueprint": {"display_name": "Log"}},
    }
    for name, part in (("fuel", "container/c"), ("Log", "view/d"), ("Site", "container/b")):
        chosen = with_tab(told, name)
        assert chosen["/container/a"]["ContainerBlueprint"].pop("active_tab") == part
        chosen["/container/a"]["ContainerBlueprint"]["active_tab"] = "container/b"
        assert chosen == told, "nothing else changes"
    with pytest.raises(ConfigError, match="no tab 'Depth'; the recording has: Site, Fuel, Log"):
        with_tab(told, "Depth")
    with pytest.raises(ConfigError, match="no tabs"):
        with_tab({}, "Site")


@pytest.mark.slow
def test_screenshot_shows_the_recording(tmp_path: Path, recording: Path) -> None:
    if not list(Path("/usr/share/vulkan/icd.d").glob("*.json")):
        pytest.skip("needs a Vulkan driver: apt-get install mesa-vulkan-drivers libgl1-mesa-dri")
    shares = {}
    for tab in (None, "cameras", "Health"):
        path = tmp_path / f"deep/{tab}.png"
        screenshot(recording, path, (1200, 700), tab)
        picture = cv2.imread(str(path))[..., ::-1].astype(int)
        assert picture.shape[1] >= 1200
        shares[tab] = (np.abs(picture - (200, 100, 30)).max(axis=-1) < 12).mean()
    assert shares[None] > 0.01, "the camera's image is on the screen"
    assert shares["cameras"] > 2 * shares[None], "the images of both cameras, larger"
    assert shares["Health"] < 0.001
    with pytest.raises(ConfigError, match="Site, Cameras, Fuel, Health"):
        screenshot(recording, tmp_path / "none.png", tab="Depth")
