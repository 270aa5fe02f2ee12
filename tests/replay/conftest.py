"""What replay tests share: the small site with its recording, and what an archive makes of it."""

from __future__ import annotations

from pathlib import Path

import pytest
from scenes.small_site import SmallSite, write_small_site

from ltm_core.pipeline.stored_fuel import STORE_FILE, STORE_KIND
from ltm_core.storage.tile_store import TileStore
from ltm_ros.archive.engine import serial
from ltm_ros.archive.publish import write_page
from ltm_ros.archive.reduction import store_digest
from ltm_ros.archive.run import ArchiveOptions, look_through, run

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


@pytest.fixture(scope="session")
def done(small_site: SmallSite, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `ltm reprocess` makes of the small site's recording, but for the maps that it draws."""
    out = tmp_path_factory.mktemp("done") / "out"
    planned = look_through(ArchiveOptions((small_site.bag,), small_site.path, str(out)), lambda done, total: None)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(PAGE, lambda map_, folder: None)
        run(planned, serial, lambda done, total: None)
    return out


@pytest.fixture(scope="session")
def expected(done: Path) -> str:
    """The digest of that map's store."""
    with TileStore.open_read_only(done / STORE_FILE, STORE_KIND) as store:
        return store_digest(store)
