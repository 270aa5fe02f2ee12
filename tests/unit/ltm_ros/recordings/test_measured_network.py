from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from scenes.networks import COLORS, write_classifier
from scenes.small_site import write_small_site

from ltm_core.base.errors import ConfigError
from ltm_core.fuel.label_errors import known_errors
from ltm_core.fuel.life_form import LifeForm
from ltm_core.raster.raster_io import write_geotiff
from ltm_core.site.site_io import load_site
from ltm_core.vision.labels import Label
from ltm_ros.recordings.measured_network import measure_network


@pytest.fixture(autouse=True)
def own_models(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))


def test_photos_give_the_shares_and_leave_the_rest_open(tmp_path: Path) -> None:
    manifest = write_classifier(tmp_path)
    photo = np.full((40, 60, 3), COLORS["red"], np.uint8)
    photo[:, 30:] = COLORS["lime"]
    (tmp_path / "photos").mkdir()
    cv2.imwrite(str(tmp_path / "photos" / "a.png"), photo[..., ::-1])
    truth = np.full((40, 60), Label.GRASS, np.uint8)  # the network calls red built, and lime grass
    cv2.imwrite(str(tmp_path / "photos" / "a_labels.png"), truth)
    assert not known_errors(str(manifest)).measured
    measure_network(str(manifest), None, [], tmp_path / "photos")
    errors = known_errors(str(manifest))
    assert errors.state == "measured on photos"
    assert errors.appearance is None
    assert errors.shares[LifeForm.GRASS - 1, LifeForm.BUILT - 1] == pytest.approx(0.5, abs=0.02)


def test_a_recording_of_fixed_and_posed_cameras_gives_a_record_of_the_site(tmp_path: Path) -> None:
    small = write_small_site(tmp_path)
    site = load_site(small.path)
    with pytest.raises(ConfigError, match="prior"):
        measure_network(site.model, site, [small.bag], None)
    grid = site.in_crs(site.fuel_geometry(site.open_dem()))
    codes = np.where(np.indices(grid.shape)[1] % 4 < 2, 102, 145).astype(np.int16)
    write_geotiff(tmp_path / "prior.tif", codes, grid, -9999)
    content = yaml.safe_load(small.path.read_text())
    small.path.write_text(yaml.safe_dump(content | {"fuel": {"prior": "prior.tif"}}))
    site = load_site(small.path)
    path, errors = measure_network(site.model, site, [small.bag], None)
    assert known_errors(site.model).state == f"measured on site {site.name}"
    assert errors.correlation.view >= 0.9
    assert path.is_file()
