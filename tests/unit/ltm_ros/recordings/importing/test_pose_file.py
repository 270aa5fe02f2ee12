from pathlib import Path

import pytest

from ltm_core.base.errors import ConfigError
from ltm_ros.recordings.importing.photo import read_pose_file


def csv_file(folder: Path, text: str) -> Path:
    path = folder / "poses.csv"
    path.write_text(text)
    return path


def test_csv_with_spaces_a_byte_order_mark_and_blank_lines(tmp_path: Path) -> None:
    text = (
        "\ufeffname, x, y, z, azimuth_deg, fx, k1, stamp\n\na.jpg, 446722.0, 7396671.0, 770, 230.77, 6017, -0.1155,\n"
    )
    (pose,) = read_pose_file(csv_file(tmp_path, text)).values()
    assert (pose.name, pose.pose.x, pose.pose.y, pose.pose.z) == ("a.jpg", 446722.0, 7396671.0, 770.0)
    assert (pose.pose.azimuth_deg, pose.pose.azimuth_ref, pose.calibration.fx, pose.calibration.k1) == (
        230.77,
        "grid",
        6017.0,
        -0.1155,
    )
    assert (pose.pose.pitch_deg, pose.stamp, pose.calibration.k2) == (None, None, 0.0)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("name,yaw\na.jpg,3\n", "yaw.*known: name, camera, stamp, x"),
        ("name,Azimuth_deg\na.jpg,3\n", "Azimuth_deg"),
        ("name,x,x\na.jpg,3,4\n", "duplicates"),
        ("x,y\n1,2\n", "row 1:\n  name: missing"),
        ("name,x,y\na.jpg,1\n", "row 1: the number of values"),
        ("name,x,y\na.jpg,1,2,3\n", "row 1: the number of values"),
        ("name,azimuth_deg\na.jpg,north\n", "azimuth_deg: .*'north'"),
        ("name,azimuth_deg\na.jpg,nan\n", "azimuth_deg"),
        ("name,x\na.jpg,3\n", "give both x and y"),
        ("name,lat\na.jpg,3\n", "give both lon and lat"),
        ("name,x,y,lon,lat\na.jpg,1,2,3,4\n", "either x or lon"),
        ("name,z,height_above_ground\na.jpg,1,2\n", "either z or height_above_ground"),
        ("name,fx,hfov_deg\na.jpg,1,2\n", "either hfov_deg or fx"),
        ("name,fy\na.jpg,1\n", "fy needs fx"),
        ("name,lon,lat\na.jpg,200,4\n", "lon"),
        ("name,pitch_deg\na.jpg,91\n", "pitch_deg"),
        ("name,fx\na.jpg,-6000\n", "fx"),
        ("name,azimuth_ref\na.jpg,compass\n", "azimuth_ref"),
        ("name,stamp\na.jpg,noon\n", "stamp"),
        ("name,camera\na.jpg,North Camera\n", "camera"),
        ("name,x,y\na.jpg,1,2\nb.jpg,1,2\na.jpg,3,4\n", r"row 3: a\.jpg is listed twice"),
        ("name,x,y\n", "no rows"),
        ("", "no rows"),
        ('name,x,y\n"a.jpg,1,2\n', "cannot be read"),
    ],
)
def test_rows_that_cannot_be_taken_are_named(tmp_path: Path, text: str, complaint: str) -> None:
    with pytest.raises(ConfigError, match=complaint):
        read_pose_file(csv_file(tmp_path, text))
