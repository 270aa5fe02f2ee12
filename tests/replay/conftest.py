"""What replay tests share: the small site with its recording."""

import pytest
from scenes.small_site import SmallSite, write_small_site


@pytest.fixture(scope="session")
def small_site(tmp_path_factory: pytest.TempPathFactory) -> SmallSite:
    """Not to be written into."""
    return write_small_site(tmp_path_factory.mktemp("small_site"))
