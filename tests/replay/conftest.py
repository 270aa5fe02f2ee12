"""What replay tests share: the small site with its recording, and what an archive makes of it."""

from pathlib import Path

import pytest
from scenes.small_site import SmallSite, write_small_site

from ltm_core.pipeline.stored_fuel import STORE_FILE, STORE_KIND
from ltm_core.storage.tile_store import TileStore
from ltm_ros.archive.reduction import store_digest
from ltm_ros.archive.run import ArchiveOptions, look_through, run
from ltm_ros.archive.task import serial


@pytest.fixture(scope="session")
def small_site(tmp_path_factory: pytest.TempPathFactory) -> SmallSite:
    """Not to be written into."""
    return write_small_site(tmp_path_factory.mktemp("small_site"))


@pytest.fixture(scope="session")
def done(small_site: SmallSite, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `ltm reprocess` makes of the small site's recording."""
    out = tmp_path_factory.mktemp("done") / "out"
    planned = look_through(ArchiveOptions((small_site.bag,), small_site.path, out), lambda done, total: None)
    run(planned, serial, lambda done, total: None)
    return out


@pytest.fixture(scope="session")
def expected(done: Path) -> str:
    """The digest of that map's store."""
    with TileStore.open_read_only(done / STORE_FILE, STORE_KIND) as store:
        return store_digest(store)
