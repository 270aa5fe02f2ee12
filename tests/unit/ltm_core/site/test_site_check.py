from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scenes.networks import write_classifier, write_swapping_head

from ltm_core.base.errors import SiteVerdict
from ltm_core.geometry.camera import Camera
from ltm_core.geometry.grid import GridGeometry
from ltm_core.geometry.pose import Pose
from ltm_core.raster.dem import Dem
from ltm_core.site.camera_check import check_views
from ltm_core.site.networks import labels_state
from ltm_core.site.site_check import SiteCheck, check_site
from ltm_core.visibility.viewshed import PosedCamera

FINE = GridGeometry(346_500.0, 3_784_000.0, 10.0, 120, 100, "EPSG:32611")
COARSE = GridGeometry(345_000.0, 3_785_500.0, 50.0, 70, 60, "EPSG:32611")


def checked(folder: Path, height: float, **changes: Any) -> SiteCheck:
    """Of a gentle slope at `height`, with a coarser raster around it that says 900 m."""
    rows, cols = np.mgrid[0:100, 0:120]
    Dem((height + 0.1 * rows + 0.05 * cols).astype(np.float32), FINE).save(folder / "fine.tif")
    Dem(np.full(COARSE.shape, 900.0, np.float32), COARSE).save(folder / "coarse.tif")
    site = {
        "name": "ridge",
        "crs": "EPSG:32611",
        "origin": [346_000.0, 3_783_000.0],
        "dem": [{"path": "fine.tif"}, {"path": "coarse.tif"}],
        "cameras": {"north": {}, "south": {}},
    }
    (folder / "site.yaml").write_text(yaml.safe_dump(site | changes))
    return check_site(folder / "site.yaml")


def said(check: SiteCheck, verdict: SiteVerdict) -> list[tuple[str, str]]:
    return [(f.name, f.said) for f in check.findings if f.verdict is verdict]


def test_a_site_as_it_should_be(tmp_path: Path) -> None:
    check = checked(tmp_path, 890.0)
    assert not said(check, SiteVerdict.WRONG)
    assert not said(check, SiteVerdict.DOUBTFUL)
    assert {f.area for f in check.findings} == {"site", "terrain", "cameras", "fuel", "networks"}
    assert ("north", "calibration and pose are read from topics") in said(check, SiteVerdict.OK)


@pytest.mark.parametrize(
    ("key", "wrong"), [("model", "landscape_v5_depth"), ("depth_model", "landscape_v5"), ("model", "tcmonodepth")]
)
def test_a_network_of_the_wrong_kind_is_an_error(tmp_path: Path, key: str, wrong: str) -> None:
    ((name, message),) = said(checked(tmp_path, 890.0, **{key: wrong}), SiteVerdict.WRONG)
    assert name == key
    assert wrong in message
    assert f"`{'depth_model' if key == 'model' else 'model'}`" in message


def test_heights_that_do_not_go_with_the_coarser_raster(tmp_path: Path) -> None:
    ((name, message),) = said(checked(tmp_path, 890 / 0.3048), SiteVerdict.WRONG)
    assert name == "dem"
    assert "fine.tif: 3.2" in message
    assert "fine.tif from feet" in message
    ((_, message),) = said(checked(tmp_path, 1_080.0), SiteVerdict.DOUBTFUL)
    assert "coarse.tif in the median; check place, unit and datum" in message


def test_only_the_cameras_that_run_are_looked_at(tmp_path: Path) -> None:
    buried = {"pose": {"x": 346_700.0, "y": 3_783_900.0, "z": 500.0, "azimuth_deg": 40.0}}
    checked(tmp_path, 890.0, cameras={"north": buried, "south": {}})
    assert [name for name, _ in said(check_site(tmp_path / "site.yaml"), SiteVerdict.WRONG)] == ["north"]
    assert not check_site(tmp_path / "site.yaml", ["south"]).wrong
    ((_, message),) = said(check_site(tmp_path / "site.yaml", ["west"]), SiteVerdict.WRONG)
    assert "ridge has no camera 'west'; it has north, south" in message


@pytest.mark.parametrize(
    ("z", "x", "verdict", "part"),
    [
        (120.0, 50.0, SiteVerdict.OK, "2 different views, 20.0 m above"),
        (90.0, 50.0, SiteVerdict.WRONG, "10.00 m under the ground"),
        (390.0, 50.0, SiteVerdict.DOUBTFUL, "as feet it would be 119 m"),
        (120.0, 5_000.0, SiteVerdict.DOUBTFUL, "beside the DEM, which covers x 0 to 120"),
    ],
)
def test_views_of_a_recording(z: float, x: float, verdict: SiteVerdict, part: str) -> None:
    dem = Dem(np.full((8, 12), 100.0, np.float32), GridGeometry(0.0, 80.0, 10.0, 12, 8))
    views = [
        PosedCamera("tower", Camera.from_fov(32, 20, 60.0), Pose.from_angles((x, 40.0, height), 30.0))
        for height in (z + 5.0 if z == 120.0 else z, z)
    ]
    (finding,) = check_views(views, dem)
    assert (finding.name, finding.verdict) == ("tower", verdict)
    assert part in finding.said


HEAD = {"x": 347_000.0, "y": 3_783_500.0, "height_above_ground": 20.0, "azimuth_deg": 30.0}


def test_a_head_is_doubted_until_it_is_calibrated(tmp_path: Path) -> None:
    ((name, message),) = said(checked(tmp_path, 890.0, cameras={"north": {"mount": HEAD}}), SiteVerdict.DOUBTFUL)
    assert name == "north"
    assert "not calibrated: directions are uncertain by 1." in message
    known = HEAD | {"covariance_deg2": (np.eye(4) * 0.02**2).tolist()}
    check = checked(tmp_path, 890.0, cameras={"north": {"mount": known}})
    assert not said(check, SiteVerdict.DOUBTFUL)
    assert ("north", "PTZ head 20.0 m above the ground, directions to 0.03 deg") in said(check, SiteVerdict.OK)


@pytest.mark.parametrize(
    ("camera", "classes", "doubted"),
    [
        ({"mount": HEAD}, ("caption", "mast"), True),
        ({"mount": HEAD}, ("caption", "lens"), False),
        ({}, ("caption", "mast"), False),
    ],
)
def test_a_mask_of_a_head_that_hides_the_same_of_every_view(
    tmp_path: Path, camera: dict[str, Any], classes: tuple[str, str], doubted: bool
) -> None:
    mask = [{"class": name, "polygon": [[10 * i, 0], [10 * i + 9, 0], [10 * i, 40]]} for i, name in enumerate(classes)]
    sized = {"calibration": {"width": 200, "height": 120, "hfov_deg": 60.0}, "mask": mask}
    check = checked(tmp_path, 890.0, cameras={"north": camera | sized, "south": {}})
    ((_, message),) = [
        found for found in said(check, SiteVerdict.DOUBTFUL if doubted else SiteVerdict.OK) if "mask" in found[0]
    ]
    assert message.startswith("hides ")
    assert ("same pixels in every view" in message) is doubted


CALIBRATION = {
    "classes": ["sky", "grass"],
    "confusion": [[1.0, 0.0], [0.0, 1.0]],
    "measured_on": "photos",
    "photographs": 5,
}


def test_a_head_that_no_network_has_is_told_with_its_cameras_place(tmp_path: Path) -> None:
    check = checked(
        tmp_path, 890.0, expert={"label_heads": "heads"}, cameras={"north": {"label_head": "chaparral"}, "south": {}}
    )
    ((_, message),) = [found for found in said(check, SiteVerdict.WRONG) if found[0] == "label head chaparral"]
    assert str(tmp_path / "heads" / "chaparral.yaml") in message
    network = write_classifier(tmp_path, maps=True)
    write_swapping_head(tmp_path / "heads" / "chaparral.yaml", network)
    cameras = {"north": {"label_head": "chaparral"}, "south": {}}
    check = checked(tmp_path, 890.0, expert={"label_heads": "heads"}, model="colors.yaml", cameras=cameras)
    ((_, message),) = [found for found in said(check, SiteVerdict.DOUBTFUL) if found[0] == "label errors"]
    assert "colors.yaml, label head chaparral: unmeasured" in message


def test_a_head_for_one_view_is_not_for_two_cameras(tmp_path: Path) -> None:
    network = write_classifier(tmp_path, maps=True)
    write_swapping_head(tmp_path / "heads" / "mast.yaml", network, one_view=True, calibration=CALIBRATION)
    for cameras, verdict in (
        ({"north": {"label_head": "mast"}, "south": {}}, SiteVerdict.OK),
        ({"north": {"label_head": "mast"}, "south": {"label_head": "mast"}}, SiteVerdict.DOUBTFUL),
    ):
        check = checked(tmp_path, 890.0, expert={"label_heads": "heads"}, model="colors.yaml", cameras=cameras)
        ((_, message),) = [found for found in said(check, verdict) if found[0] == "label head mast"]
        assert message.endswith("train one for each") is (verdict is SiteVerdict.DOUBTFUL)


@pytest.mark.parametrize(
    ("changes", "state"),
    [
        ({}, "measured on photos"),
        ({"model": "colors.yaml"}, "unmeasured"),
        ({"nodes": {"segmentation": {"model": "mosaic_r4_ade20k31"}}}, "unmeasured"),
        ({"cameras": {"north": {"label_head": "near"}, "east": {}}}, "measured on photos"),
        (
            {
                "cameras": {"n": {"label_head": "chaparral"}},
                "model": "colors.yaml",
                "expert": {"label_heads": "heads"},
            },
            "unmeasured",
        ),
    ],
)
def test_a_site_states_what_the_labels_that_vote_were_measured_on(
    tmp_path: Path, changes: dict[str, Any], state: str
) -> None:
    network = write_classifier(tmp_path, maps=True)
    write_swapping_head(tmp_path / "heads" / "chaparral.yaml", network)
    check = checked(tmp_path, 890.0, **changes)
    assert check.site is not None
    assert labels_state(check.site) == state
    doubts = [name for name, _ in said(check, SiteVerdict.DOUBTFUL) if name == "label errors"]
    assert bool(doubts) == (state == "unmeasured")
