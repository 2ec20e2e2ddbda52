"""The oldest versions that are tested are those that the project states."""

import tomllib

import pytest

from tests.oldest import PROJECT, list_oldest


def test_every_dependency_states_its_oldest_version():
    stated = tomllib.loads(PROJECT.read_text(encoding="utf-8"))["project"]["dependencies"]
    assert [one.replace("==", ">=") for one in list_oldest(stated)] == stated


@pytest.mark.parametrize("requirement", ["numpy", "numpy==2.0", "numpy>2", "numpy>=2,<3"])
def test_a_dependency_without_one_is_refused(requirement):
    with pytest.raises(ValueError, match="states no oldest version"):
        list_oldest(["click>=8.2", requirement])
