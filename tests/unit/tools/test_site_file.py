import re
from collections.abc import Iterator
from typing import get_args

from pydantic import BaseModel
from site_file import FILE, written

from ltm_core.site.site import Site
from ltm_core.site.site_io import load_site


def keys(model: type[BaseModel]) -> Iterator[str]:
    """Yield the keys of a section and of all below it."""
    for name, field in model.model_fields.items():
        yield field.alias or name
        yield from (key for below in sections(field.annotation) for key in keys(below))


def sections(annotation: object) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [section for part in get_args(annotation) for section in sections(part)]


def test_the_committed_file_is_what_the_tool_writes() -> None:
    assert FILE.read_text(encoding="utf-8") == written(), "run `python tools/site_file.py`"


def test_it_loads_and_has_every_key() -> None:
    site, text = load_site(FILE), FILE.read_text(encoding="utf-8")
    assert {camera.source.kind for camera in site.cameras.values() if camera.source} >= {"snapshot", "rtsp", "folder"}
    given = set(re.findall(r"^ *(?:- |# )?(\w+):", text, re.MULTILINE))
    assert len(given) > 200
    assert set(keys(Site)) - given == {"coarser"}  # the rest of a list of DEMs
