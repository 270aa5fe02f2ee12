import json
from pathlib import Path

import pytest

from ltm_core.base.errors import ConfigError
from ltm_core.vision.areas import NamedArea, parse_areas, read_areas, write_areas


def test_areas_come_back_as_they_were_written(tmp_path: Path) -> None:
    areas = [
        NamedArea(image="a b.jpg", kind="shrub", polygon=((1, 2), (30.5, 2), (30, 40))),
        NamedArea(image="é.jpg", kind="lens", polygon=((0, 0), (9, 0), (0, 9)), number=3, reason="hood"),
    ]
    write_areas(tmp_path / "polygons.json", areas)
    assert list(read_areas(tmp_path / "polygons.json")) == areas
    first = json.loads((tmp_path / "polygons.json").read_text())[0]
    assert first == {"image": "a b.jpg", "class": "shrub", "polygon": [[1, 2], [30.5, 2], [30, 40]]}
    assert [path.name for path in tmp_path.iterdir()] == ["polygons.json"]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{", "not JSON"),
        ("[" * 100_000, "not JSON"),
        ('{"image": "a"}', "expected a list of areas"),
        ('[{"image": "a", "class": "sky"}]', "0.polygon: missing"),
        ('[{"image": "a", "class": "sky", "polygon": [[0, 0], [1, 1]]}]', "0.polygon"),
        ('[{"image": "a", "class": "sky", "polygon": [[0, 0], [1, 1], [NaN, 1]]}]', "0.polygon.2.0"),
        ('[{"image": "a", "class": "sky", "polygon": [[0, 0], [1, 1], [1e9, 1]]}]', "0.polygon.2.0"),
        ('[{"image": "a", "class": "sky", "polygon": [[0, 0], [1, 1], [0, 1]], "x": 1}]', "unknown key"),
    ],
)
def test_what_is_no_list_of_areas_is_told_in_words(text: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        parse_areas(text, "polygons.json")
