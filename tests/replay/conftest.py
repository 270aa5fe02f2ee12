"""What replay tests share: the small site with its recording."""

from __future__ import annotations

import pytest
from scenes.small_site import SmallSite, write_small_site

from ltm_ros.archive.publish import write_page

PAGE = "ltm_ros.archive.publish.write_page"


@pytest.fixture(scope="session")
def small_site(tmp_path_factory: pytest.TempPathFactory) -> SmallSite:
    """Not to be written into."""
    return write_small_site(tmp_path_factory.mktemp("small_site"))


@pytest.fixture
def without_page(monkeypatch: pytest.MonkeyPatch) -> None:
    """`ltm reprocess` draws no maps, which takes longer than the fusion of so few frames; its other files are there."""
    monkeypatch.setattr(PAGE, lambda map_, folder: None)


@pytest.fixture
def with_page(without_page: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also in a module whose other tests go `without_page`."""
    monkeypatch.setattr(PAGE, write_page)
