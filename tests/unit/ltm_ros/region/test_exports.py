"""The region's map as GeoTIFFs with a STAC item, anew when it has changed."""

import threading
from pathlib import Path

import numpy as np
import pytest
import rasterio
from scenes.fuel_frames import BEGIN_NS
from scenes.region_scene import write_region_scene
from scenes.waiting import wait_for

from ltm_core.uplink.config import ExportConfig
from ltm_ros.region.aggregator import Aggregator, RegionExports
from ltm_ros.region.service import RegionService
from ltm_ros.runtime.health import Health


def test_the_map_is_exported_when_it_has_changed(tmp_path: Path) -> None:
    scene, health = write_region_scene(tmp_path), Health()
    (tmp_path / "out").mkdir()
    aggregator = Aggregator(scene.config, health, lambda: 0)
    exports = RegionExports(ExportConfig(folder=tmp_path / "out", every=5.0), aggregator, health)

    def exported(times: int) -> bool:
        return health.summary().get("noted.exported") == str(times)

    exports.look(0.0, changed=False)
    wait_for(lambda: exported(1), "the first", lambda: health.last_error)
    exports.look(60.0, changed=False)
    for number in range(4):
        aggregator.take("alta", scene.sealed("alta", number))
    aggregator.settle()
    exports.look(60.0, changed=bool(aggregator.persistence.show()))
    wait_for(lambda: exported(2), "the second", lambda: health.last_error)
    exports.look(64.0, changed=True)
    exports.close()
    assert exported(3)
    shown = aggregator.persistence.shown
    with rasterio.open(tmp_path / "out/life_form.tif") as raster:
        np.testing.assert_array_equal(raster.read(1), shown.life_form)
        assert raster.crs.to_string() == scene.site.crs
        assert raster.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
    assert (tmp_path / "out/item.stac.json").is_file()
    aggregator.close()


def test_an_export_that_fails_by_a_bug_is_told_and_tried_again_and_the_map_lives_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene, health = write_region_scene(tmp_path), Health()
    (tmp_path / "out").mkdir()
    aggregator = Aggregator(scene.config, health, lambda: 0)
    exports = RegionExports(ExportConfig(folder=tmp_path / "out", every=5.0), aggregator, health)

    def broken(*_: object) -> None:
        raise ValueError("a library's")

    with monkeypatch.context() as patched:
        patched.setattr("ltm_ros.region.aggregator.export_site", broken)
        exports.look(0.0, changed=True)

        def looked() -> bool:
            exports.look(1.0, changed=False)
            return health.troubled

        wait_for(looked, "the failure", lambda: health.last_error)
        assert "the map was not exported (ValueError: a library's" in health.last_error
    exports.look(60.0, changed=False)
    wait_for(lambda: (tmp_path / "out/life_form.tif").exists(), "the next one", lambda: health.last_error)
    exports.close()
    aggregator.close()


class Unheard:
    """A connection on which nobody comes."""

    connections = 1

    def __init__(self, *_: object, will: object = None) -> None:
        self.connected = threading.Event()

    def start(self) -> None: ...

    def stop(self) -> None: ...

    def send(self, *_: object, **__: object) -> bool:
        return False


def test_the_last_export_has_what_was_not_yet_shown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """While many frames come, the map is decided anew but now and then; the end does not wait for that."""
    monkeypatch.setattr("ltm_ros.region.service.SHOWN_SHARE", 1e-12)
    (tmp_path / "out").mkdir()
    scene = write_region_scene(tmp_path, export={"folder": "out", "every": 5.0})
    monkeypatch.setattr("ltm_ros.region.service.MqttLink", Unheard)
    service, stopping = RegionService(scene.config, Health(), lambda: BEGIN_NS + 10**13), threading.Event()
    service.step(0.0)
    for number in range(4):
        service.aggregator.take("alta", scene.sealed("alta", number))
    service.step(0.0)
    assert service.aggregator.persistence.saved_frames == 4
    assert service.aggregator.persistence.shown.seen.sum() == 0
    stopping.set()
    service.run(stopping)
    with rasterio.open(tmp_path / "out/life_form.tif") as raster:
        assert (raster.read(1) != raster.nodata).any()
