import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from PIL import Image
from scenes.command_line import ltm
from scenes.mountain_view import BEND, ORIGIN, PLACE, eye, view, write_site
from scenes.networks import write_classifier
from scenes.small_site import PAINT, SKY

from ltm_core.base.errors import ConfigError, LtmError
from ltm_core.base.types import Float64Array, UInt8Array
from ltm_core.geometry.pose import Pose
from ltm_core.geometry.zoom_lens import LensConfig
from ltm_core.pose_estimation.mount.mount_model import MountModel
from ltm_core.site.site import Site
from ltm_core.site.site_io import load_site
from ltm_core.visibility.footprint import pixel_rays
from ltm_core.vision.labels import Label

TABLE = [{"zoom": 1.0, "hfov_deg": 52.0}, {"zoom": 400.0, "hfov_deg": 26.0}]
LENS = LensConfig.model_validate({"width": 480, "height": 300, "zoom": TABLE}).lens()
TRUE = MountModel(Pose.from_angles(eye(), 63.0, 0.7, -0.4), math.radians(0.3), np.zeros((7, 7)))


def mounted_site(folder: Path, **mount: object) -> Path:
    known = {"x": ORIGIN[0] + PLACE[0], "y": ORIGIN[1] + PLACE[1], "height_above_ground": 12.0, "azimuth_deg": 64.5}
    known |= {"position_sigma": 0.01, "height_sigma": 0.01}
    lens = {"lens": {"width": 480, "height": 300, "zoom": TABLE}}
    return write_site(folder, cameras={"north": {"mount": known | lens | mount}})


def landmarks(path: Path, pans: tuple[float, ...], lens_factor: float = 1.0) -> Path:
    """Marked in pictures at each pan; of a lens whose focal length is the table's times `lens_factor`."""
    rng = np.random.default_rng(7)
    lens = LENS.scaled({1.0: lens_factor})
    lines = ["id,x,y,z,u,v,pan_deg,tilt_deg,zoom"]
    for k, pan in enumerate(pans):
        tilt = -2.0 + k % 3
        rotation, camera = TRUE.rotation(pan, tilt), lens.camera(1.0)
        for j in range(3):
            pixel = np.array([rng.uniform(20, 460), rng.uniform(100, 200)])
            way = rotation @ pixel_rays(camera, pixel[None])[0] * rng.uniform(400, 1400)
            way[2] += BEND * (way[0] ** 2 + way[1] ** 2)
            x, y, z = TRUE.base.position + way
            lines.append(f"p{k}{j},{x + ORIGIN[0]:.4f},{y + ORIGIN[1]:.4f},{z:.4f},{pixel[0]:.3f},{pixel[1]:.3f},"
                         f"{pan},{tilt},1")  # fmt: skip
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


def errors_deg(site: Site, tilt: float = -2.0) -> list[float]:
    mount = site.camera("north").mount
    assert mount is not None
    model = mount.model(site.open_dem(), site.frame)

    def looks(which: MountModel, pan: float) -> Float64Array:
        return which.rotation(pan, tilt)[:, 2]

    cosines = [float(looks(model, pan) @ looks(TRUE, pan)) for pan in range(0, 360, 20)]
    return [math.degrees(math.acos(min(1.0, cosine))) for cosine in cosines]


def test_landmarks_of_several_presets_calibrate_the_head_in_the_site_file(tmp_path: Path) -> None:
    path = mounted_site(tmp_path)
    assert max(errors_deg(load_site(path))) > 1.0
    points = landmarks(tmp_path / "points.csv", (10.0, 100.0, 190.0, 280.0), lens_factor=1.03)
    said = ltm("pose", "mount", path, "north", "--points", points)
    assert "azimuth at pan 0" in said
    assert path.read_text().startswith("# The ridge.")
    site = load_site(path)
    mount = site.camera("north").mount
    assert mount is not None
    assert mount.lens is not None
    assert max(errors_deg(site)) < 0.02
    assert mount.calibrated
    assert mount.lens.lens().camera(1.0).fx == pytest.approx(1.03 * LENS.camera(1.0).fx, rel=1e-3)
    with pytest.raises(ConfigError, match="calibrated already"):
        ltm("pose", "mount", path, "north", "--points", points)
    ltm("pose", "mount", path, "north", "--points", points, "--overwrite")
    assert max(errors_deg(load_site(path))) < 0.02


MAST = slice(60, 330)


def with_mast(path: Path, model: Path) -> Path:
    """The site with a network of its own, and a camera that looks past a wide mast."""
    content = yaml.safe_load(path.read_text())
    corners = [[59.5, -1], [329.5, -1], [329.5, 301], [59.5, 301]]
    content["cameras"]["north"]["mask"] = [{"class": "mast", "polygon": corners}]
    path.write_text(yaml.safe_dump(content | {"model": str(model)}))
    return path


def painted(pose: Pose) -> UInt8Array:
    """Sky and ground in the colours that the test's network knows."""
    photo, labels = view(pose, LENS.camera(1.0))
    ground = np.zeros_like(photo)
    ground[..., 1] = photo[..., 1]
    return np.where((labels == Label.SKY)[..., None], np.array(PAINT[SKY], np.uint8), ground)


@pytest.mark.slow
def test_pictures_of_several_presets_calibrate_the_head(tmp_path: Path) -> None:
    path = mounted_site(tmp_path)
    path = with_mast(path, write_classifier(tmp_path))
    lines = ["name,pan_deg,tilt_deg,zoom"]
    for k, pan in enumerate((0.0, 85.0, 175.0, 270.0)):
        photo = painted(Pose(TRUE.base.position, TRUE.rotation(pan, 2.0)))
        photo[:, MAST] = (0, 140, 0)
        Image.fromarray(photo).save(tmp_path / f"preset{k}.png")
        lines.append(f"preset{k}.png,{pan},2.0,1")
    (tmp_path / "readings.csv").write_text("\n".join(lines))
    said = ltm("pose", "mount", path, "north", "--photos", tmp_path)
    assert "4 images agree" in said
    assert max(errors_deg(load_site(path), tilt=2.0)) < 0.15


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["{site}", "south", "--points", "{points}"], "south"),
        (["{site}", "north", "--photos", "{folder}"], "readings.csv"),
        (["{site}", "north"], "--points .* or --photos"),
        (["{site}", "north", "--points", "{points}", "--free", "k1"], "--free k1"),
    ],
)
def test_mistakes_are_told(tmp_path: Path, arguments: list[str], told: str) -> None:
    places = {"site": mounted_site(tmp_path), "points": landmarks(tmp_path / "p.csv", (0.0, 90.0)), "folder": tmp_path}
    with pytest.raises(LtmError, match=told):
        ltm("pose", "mount", *(argument.format(**places) for argument in arguments))
