from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import rasterio
from scenes.region_scene import write_region_scene
from scenes.s3_bucket import empty_bucket
from scenes.waiting import wait_for

from ltm_core.uplink.config import ExportConfig
from ltm_ros.region.aggregator import Aggregator
from ltm_ros.region.tiles import RegionExports
from ltm_ros.runtime.health import Health


@pytest.fixture
def bucket() -> Iterator[str]:
    pytest.importorskip("s3fs")
    with empty_bucket("maps") as address:
        yield f"{address}/kern"


def test_the_map_is_exported_when_it_has_changed(tmp_path: Path, bucket: str) -> None:
    scene, health = write_region_scene(tmp_path), Health()
    (tmp_path / "out").mkdir()
    aggregator = Aggregator(scene.config, health, lambda: 0)
    exports = RegionExports(ExportConfig(folder=tmp_path / "out", every=5.0, copy_to=bucket), aggregator, health)

    def exported(times: int) -> bool:
        return health.summary().get("noted.exported") == str(times)

    exports.look(0.0, changed=False)
    wait_for(lambda: exported(1), "the first", lambda: health.last_error)
    exports.look(60.0, changed=False)
    for number in range(4):
        aggregator.take("alta", scene.sealed("alta", number))
    aggregator.settle()
    exports.look(60.0, changed=bool(aggregator.show()))
    wait_for(lambda: exported(2), "the second", lambda: health.last_error)
    exports.look(64.0, changed=True)
    exports.close()
    assert exported(3)
    shown = aggregator.persistence.shown
    with rasterio.open(tmp_path / "out/life_form.tif") as raster:
        np.testing.assert_array_equal(raster.read(1), shown.life_form)
        assert raster.crs.to_string() == scene.site.crs
        assert raster.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
    item = json.loads((tmp_path / "out/item.stac.json").read_text())
    import s3fs

    store = s3fs.S3FileSystem()
    store.invalidate_cache()
    there = {Path(path).name for path in store.ls("maps/kern")}
    assert there >= {"item.stac.json", *item["assets"]}
    assert store.cat_file("maps/kern/life_form.tif") == (tmp_path / "out/life_form.tif").read_bytes()
    aggregator.close()


def test_a_copy_that_fails_is_told_and_tried_again(tmp_path: Path, bucket: str) -> None:
    scene, health = write_region_scene(tmp_path), Health()
    (tmp_path / "out").mkdir()
    aggregator = Aggregator(scene.config, health, lambda: 0)
    elsewhere = ExportConfig(folder=tmp_path / "out", every=1.0, copy_to="s3://nobodys/kern")
    exports = RegionExports(elsewhere, aggregator, health)
    wait_for(
        lambda: exports.look(0.0, changed=False) or "cannot be copied there" in health.last_error,
        "words",
        health.summary,
    )
    assert (tmp_path / "out/item.stac.json").is_file()
    (tmp_path / "out/item.stac.json").unlink()
    exports.close()
    assert (tmp_path / "out/item.stac.json").is_file()
    assert "noted.exported" not in health.summary()
    aggregator.close()
