from pathlib import Path
from typing import Any

import pytest
import yaml
from site_reference import keys

from ltm_core.base.errors import ConfigError
from ltm_core.site.site import Site
from ltm_core.site.site_io import load_site

SOURCE = {"kind": "snapshot", "url": "http://camera.lan/now.jpg"}
SIZE = {"width": 640, "height": 480, "hfov_deg": 50}
SITE: dict[str, Any] = {
    "name": "ridge",
    "crs": "EPSG:32611",
    "origin": [346_000.0, 3_783_000.0],
    "dem": [{"path": "fine.tif"}, {"path": "coarse.tif"}],
    "terrain": {"resolution": 2.0},
    "cameras": {"north": {"source": SOURCE, "calibration": SIZE}},
}


def load(folder: Path, **changes: Any) -> Site:
    path = folder / "site.yaml"
    path.write_text(yaml.safe_dump(SITE | changes, sort_keys=False), encoding="utf-8")
    return load_site(path)


def test_tuning_constants_join_their_sections(tmp_path: Path) -> None:
    tuning = {
        "refraction": 0.2,
        "fuel": {"fusion": {"odds": 9.0}},
        "terrain": {"threshold": 3.0},
        "cameras": {"north": {"source": {"timeout": 20.0}}},
    }
    site = load(tmp_path, expert=tuning | {"locating": {"plume_height": 90.0}})
    assert site.locating is None
    assert (site.refraction, site.fuel.fusion.odds, len(site.coarser)) == (0.2, 9.0, 1)
    assert site.terrain is not None
    assert (site.terrain.resolution, site.terrain.threshold) == (2.0, 3.0)
    assert getattr(site.cameras["north"].source, "timeout", None) == 20.0


@pytest.mark.parametrize(
    ("changes", "place"),
    [
        ({"refraction": 0.2}, "expert.refraction"),
        ({"cameras": {"north": {"source": SOURCE | {"timeout": 20.0}, "calibration": SIZE}}}, "source.timeout"),
        ({"expert": {"fuel": {"climate": "humid"}}}, "expert.fuel.climate"),
        ({"fuel": {"prior": "a.tif"}, "expert": {"fuel": {"prior": {"own_fbfm13": "as_given"}}}}, "expert.fuel.prior"),
        ({"expert": {"cameras": {"south": {"source": {"timeout": 20.0}}}}}, "expert.cameras.south"),
        ({"expert": {"terrain": {"treshold": 3.0}}}, "terrain.treshold: unknown key, line 22"),
        ({"expert": {"terrain": {"threshold": -3.0}}}, "terrain.threshold.*-3.0, line 22"),
        ({"expert": [1]}, "expert"),
    ],
)
def test_keys_in_the_wrong_part(tmp_path: Path, changes: dict[str, Any], place: str) -> None:
    with pytest.raises(ConfigError, match=place):
        load(tmp_path, **changes)


def test_a_site_decides_few_keys() -> None:
    assert len([key for key in keys() if not (key.expert or key.written)]) <= 90


def test_every_key_has_a_sentence_and_one_part() -> None:
    """A key of several kinds of sources is expert in all of them or in none."""
    found = list(keys())
    assert [key.path for key in found if not key.meaning.endswith(".")] == []
    parts: dict[str, set[bool]] = {}
    for key in found:
        parts.setdefault(key.path, set()).add(key.expert)
    assert [path for path, part in parts.items() if len(part) > 1] == []
