import pytest

from cageik_cli.store.cache import EntryCache


@pytest.fixture
def said():
    """What the cache remarked."""
    return []


@pytest.fixture
def kept(cache, said):
    """A cache in this test's folder, which is not there yet."""
    return EntryCache(cache, said.append)
