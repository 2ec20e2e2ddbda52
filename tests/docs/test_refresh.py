"""The refresher writes what commands say now, and leaves out what pages left out."""

import contextlib

import pytest

from tests.docs.refresh import main, merge_output
from tests.docs.session import run_page

FOUND = [
    "cages.h5: 48 frames",
    "  error          0.25 %",
    "  published      E_RMS 2.9",
    "  system         105.5",
    "  seconds        open 0.01, total 0.78",
    "wrote cages.h5",
]


@pytest.mark.parametrize(
    ("shown", "merged"),
    [
        ([], FOUND),
        (["..."], ["..."]),
        (
            ["cages.h5: 47 frames", "  error          0.24 %", "  ...", "wrote old.h5"],
            [*FOUND[:2], "  ...", FOUND[5]],
        ),
        (["cages.h5: 48 frames", "  error          0.25 %", "  ..."], [*FOUND[:2], "  ..."]),
        (["...", "  system         99"], ["...", *FOUND[3:]]),
        (
            ["cages.h5: 48 frames", "  error 0.25 %", "  literature     E_RMS 2.9", *FOUND[3:]],
            FOUND,
        ),
        (["cages.h5: 48 frames", "  gone entirely, with words", *FOUND[1:]], FOUND),
        (
            [*FOUND[:4], "  seconds        open 9.99, total 9.99", FOUND[5]],
            [*FOUND[:4], "  seconds        open 9.99, total 9.99", FOUND[5]],
        ),
    ],
)
def test_shown_and_found_lines_are_merged(shown, merged):
    assert merge_output(shown, FOUND) == merged


def test_whether_weights_were_cached_is_never_shown():
    assert merge_output([], ["a", "  cache          hit, saved 3.1 s"]) == ["a"]


class TestAPage:
    TEXT = (
        "# Page\n\n```console\n$ cageik info data_fixtures/walker/cage.obj\n{shown}\n"
        "$ cageik info data_fixtures/walker/cage.obj  # again\n```\n\nEnd.\n"
    )

    def test_a_wrong_page_is_right_afterwards(self, write_page, docs_cache, tmp_path, capsys):
        page = write_page(self.TEXT.format(shown="x\n...\n  vertices  1\n...\n"))
        assert main([str(page)]) == 0
        assert "rewritten" in capsys.readouterr().out
        text = page.read_text()
        assert "...\n  vertices       80\n" in text
        assert text.endswith("```\n\nEnd.\n")
        with contextlib.chdir(tmp_path):
            assert run_page(page, tmp_path, docs_cache) == ([], [])

    def test_a_right_page_stays_as_it_is(self, write_page, capsys):
        page = write_page(self.TEXT.format(shown="\n"))
        main([str(page)])
        before = page.read_bytes()
        assert main([str(page)]) == 0
        assert page.read_bytes() == before
        assert "unchanged" in capsys.readouterr().out

    def test_a_command_that_fails_unexpectedly_is_told_and_not_shown(self, write_page, capsys):
        page = write_page("```console\n$ cageik info nothing.obj\nwhat it was\n```\n")
        before = page.read_bytes()
        assert main([str(page)]) == 1
        assert page.read_bytes() == before
        assert "exit code 1, expected 0" in capsys.readouterr().out
