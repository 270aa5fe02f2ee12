from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scenes.phone_site import FRAME, GROUND, LAT, LON, imported, phone_site, picture

from ltm_core.geometry.pose import pose_covariance
from ltm_core.site.site import Site
from ltm_ros.recordings.importing.assumptions import Assumptions
from ltm_ros.recordings.importing.build import import_photos

FACTS = {
    "GpsStatus": "RTK",
    "AltitudeType": "GpsFusionAlt",
    "GpsLatitude": f"{LAT:.9f}",
    "GpsLongitude": f"{LON:.9f}",
    "AbsoluteAltitude": f"+{GROUND + 61.5:.2f}",
    "RelativeAltitude": "+60.00",
    "GimbalRollDegree": "+0.40",
    "GimbalYawDegree": "-128.30",
    "GimbalPitchDegree": "-21.50",
    "FlightYawDegree": "+12.00",
    "CalibratedFocalLength": "43.5",
    "CalibratedOpticalCenterX": "31.0",
    "CalibratedOpticalCenterY": "20.5",
}


def photo(path: Path, elements: bool = False, **changes: str | None) -> Path:
    """A JPEG with a DJI's XMP packet, its facts as attributes or (newer drones) as elements."""
    facts = {key: value for key, value in {**FACTS, **changes}.items() if value is not None}
    inner = "".join(f"<drone-dji:{k}>{v}</drone-dji:{k}>" for k, v in facts.items()) if elements else ""
    attributes = "" if elements else " ".join(f'drone-dji:{k}="{v}"' for k, v in facts.items())
    xmp = (
        '<?xpacket begin="\ufeff" id="W5M0MpCehiHzreSzNTczkc9d"?><x:xmpmeta xmlns:x="adobe:ns:meta/">'
        '<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"><rdf:Description rdf:about="DJI Meta Data" '
        f'xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/" {attributes}>{inner}</rdf:Description></rdf:RDF>'
        '</x:xmpmeta><?xpacket end="w"?>'
    )
    image = Image.fromarray(picture())
    exif = image.getexif()
    exif.get_ifd(0x8769).update({0x9003: "2024:07:05 01:30:15", 0x9011: "+00:00", 0xA405: 24})
    image.save(path, "JPEG", exif=exif.tobytes(), xmp=xmp.encode())
    return path


@pytest.fixture
def site(tmp_path: Path) -> Site:
    return phone_site(tmp_path)


@pytest.mark.parametrize("elements", [False, True])
def test_a_drones_photo_is_placed_by_its_gimbal(tmp_path: Path, site: Site, elements: bool) -> None:
    """Not by the aircraft, which flies another way."""
    import_photos([photo(tmp_path / "DJI_0001.JPG", elements)], tmp_path / "bag", site=site)
    ((_, camera, pose, covariance),) = imported(tmp_path / "bag")
    x, y = (float(v) for v in FRAME.from_lonlat(LON, LAT))
    np.testing.assert_allclose(pose.position, [x, y, GROUND + 61.5], atol=1e-3)
    azimuth = FRAME.true_to_grid_deg(360 - 128.3, x, y)
    np.testing.assert_allclose(pose.angles_deg, [azimuth, -21.5, 0.4], atol=1e-6)
    assert (camera.fx, camera.cx, camera.cy) == (43.5, 31.0, 20.5)
    np.testing.assert_allclose(covariance, pose_covariance(pose, 5.0, 10.0, 8.2, 0.5, 0.5), atol=1e-9)


def test_rtk_says_how_sure_it_is_and_counts_from_the_ellipsoid(tmp_path: Path, site: Site) -> None:
    changes = {"RtkStdLon": "0.03", "RtkStdLat": "0.05", "RtkStdHgt": "0.08", "AltitudeType": "RtkAlt"}
    path = photo(tmp_path / "DJI_0001.JPG", AbsoluteAltitude=f"{GROUND + 61.5 - 35.4:.2f}", **changes)
    import_photos([path], tmp_path / "bag", site=site, assumed=Assumptions(geoid_undulation=-35.4))
    ((_, _, pose, covariance),) = imported(tmp_path / "bag")
    assert pose.position[2] == pytest.approx(GROUND + 61.5, abs=0.01)
    assert np.sqrt(covariance[0, 0]) == pytest.approx(np.hypot(0.03, 0.05) / np.sqrt(2))
    assert np.sqrt(covariance[2, 2]) == pytest.approx(0.08)


def test_a_height_above_the_take_off_needs_its_height(tmp_path: Path, site: Site) -> None:
    path = photo(tmp_path / "DJI_0001.JPG")
    import_photos([path], tmp_path / "bag", site=site, assumed=Assumptions(start_height=GROUND - 7.0))
    ((_, _, pose, _),) = imported(tmp_path / "bag")
    assert pose.position[2] == pytest.approx(GROUND - 7.0 + 60.0)
