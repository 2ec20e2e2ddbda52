"""A library that is not installed: one sentence on what to install."""

import errno
import pickle
import re
import sys

import numpy as np
import pytest

from cageik_cli.formats.base.writers import Animation
from cageik_cli.formats.open import open_sequence
from cageik_cli.formats.settings import Scene
from cageik_cli.formats.write import Output
from cageik_cli.util.errors import (
    CageikError,
    FormatError,
    MissingLibraryError,
    describe_error,
    error_context,
    format_error,
    make_write_error,
    require_optional,
)
from tests.shapes import TETRAHEDRON


def test_what_is_there_is_imported():
    with require_optional("numpy", "counting"):
        import numpy as again
    assert again is np


@pytest.mark.parametrize(
    ("library", "suffix", "remedy"),
    [
        ("pxr", ".usd", "usd-core, which is not installed: pip install usd-core"),
        ("pxr", ".usdc", "usd-core, which is not installed: pip install usd-core"),
        ("alembic3d", ".abc", "alembic3d, which is not installed: pip install alembic3d"),
    ],
)
def test_reading_and_writing_say_what_to_install(tmp_path, monkeypatch, library, suffix, remedy):
    path = tmp_path / f"clip{suffix}"
    path.touch()
    for name in [library, *(name for name in sys.modules if name.startswith(f"{library}."))]:
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(MissingLibraryError) as caught:
        open_sequence([str(path)])
    assert str(caught.value) == f"{path}: reading {suffix} needs {remedy}"
    animation = Animation(TETRAHEDRON, 1, Scene(), "clip")
    with (
        pytest.raises(MissingLibraryError) as caught,
        Output(path, overwrite=True).open_writer(animation),
    ):
        pass
    assert str(caught.value) == f"{path}: writing {suffix} needs {remedy}"
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize(
    ("module", "says"),
    [
        ("matplotlib.axes", "the library matplotlib is missing, .*; pip install matplotlib$"),
        ("igl", "the library igl .*; pip install libigl$"),
        ("cageik_cli.nothing", "internal error"),
    ],
)
def test_a_library_of_every_installation_that_is_missing_is_named(module, says):
    error = ModuleNotFoundError(f"No module named {module!r}", name=module)
    assert re.match(says, describe_error(error))


@pytest.mark.parametrize(
    ("error", "is_full"),
    [
        (OSError(errno.ENOSPC, "No space left on device"), True),
        (OSError("Error occurred writing file: No space left on device"), True),
        (OSError(errno.EACCES, "Permission denied"), False),
    ],
)
def test_a_full_disk_says_to_free_space(error, is_full):
    assert str(make_write_error("a", error)).endswith("choose another place") == is_full


class CountedError(FormatError):
    """An error whose fields are not in its text."""

    def __init__(self, message: str, counts: tuple[int, ...] = ()) -> None:
        super().__init__(message)
        self.counts = counts


def test_a_context_keeps_the_error_its_fields_its_cause_and_its_notes():
    cause = ValueError("the cause")
    raised = CountedError("too few", (3, 4))
    raised.add_note("started again")
    with pytest.raises(CountedError) as caught, error_context("a.obj"), error_context("part b"):
        raise raised from cause
    assert caught.value is raised
    assert (raised.counts, raised.__cause__) == ((3, 4), cause)
    assert raised.locations == ("a.obj", "part b")
    assert format_error(raised) == "a.obj: part b: too few; started again"


def test_a_context_keeps_where_an_error_was_raised():
    def read() -> None:
        raise FormatError("is cut short")

    with (
        pytest.raises(FormatError, match=r"^a\.obj: is cut short$") as caught,
        error_context("a.obj"),
    ):
        read()
    assert caught.traceback[-1].name == "read"
    assert (caught.value.__cause__, caught.value.__context__) == (None, None)


def test_a_context_leaves_errors_of_others_alone():
    raised = ValueError("not ours")
    with pytest.raises(ValueError, match=r"^not ours$") as caught, error_context("a.obj"):
        raise raised
    assert caught.value is raised


def test_an_error_of_another_process_keeps_its_locations():
    error = CountedError("too few", (3, 4))
    error.add_location("a.obj")
    again = pickle.loads(pickle.dumps(error))
    assert (str(again), again.counts) == ("a.obj: too few", (3, 4))
    again.add_location("clips")
    assert (again.locations, error.locations) == (("clips", "a.obj"), ("a.obj",))


def test_errors_share_no_locations():
    CageikError("one").add_location("a.obj")
    assert str(CageikError("another")) == "another"
