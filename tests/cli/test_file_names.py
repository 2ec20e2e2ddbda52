"""Files whose names are bytes that are no UTF-8, as other systems leave them."""

import shutil
from pathlib import Path

import pytest

BAD = "k\udcff"


@pytest.fixture
def renamed(tiny_result, folder):
    """A result of such a name."""
    shutil.copy(tiny_result, f"{BAD}.h5")
    return f"{BAD}.h5"


@pytest.mark.parametrize("suffix", ["usdc", "usdz", "abc"])
def test_libraries_that_take_unicode_only_say_what_to_rename(run, renamed, suffix):
    assert run("export", renamed, f"good.{suffix}").code == 0
    Path(f"good.{suffix}").rename(f"{BAD}.{suffix}")
    for words in (["info", f"{BAD}.{suffix}"], ["export", renamed, f"other {BAD}.{suffix}"]):
        done = run(*words)
        assert done.code == 1
        assert f"k\ufffd.{suffix}: has a name, or a folder, that is not Unicode" in done.err
    assert not list(Path().glob(f"*other*.{suffix}*"))


def test_the_cage_of_a_result_of_such_a_name_gives_a_file_that_is_read(run, renamed):
    done = run("bind", "--cage", renamed, "--rest", renamed, "-o", "bound.h5")
    assert done.code == 0, done.err
    described = run("info", "bound.h5")
    assert described.code == 0, described.err
    assert "k\ufffd.h5::cage" in described.out
