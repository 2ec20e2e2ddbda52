"""Shown output is compared line by line, and what differs between machines is masked."""

import contextlib

import pytest

from tests.docs.console import find_mismatch, mask, read_steps
from tests.docs.refresh import main, merge_output
from tests.docs.session import run_page


class TestFindMismatch:
    FOUND = (
        "cages.h5: 48 frames",
        "  error          0.2527 %",
        "  system         105.5",
        "wrote it",
    )

    @pytest.mark.parametrize(
        "shown",
        [
            FOUND,
            ("...",),
            (FOUND[0], "  ..."),
            ("...", FOUND[3]),
            (FOUND[0], "...", FOUND[2], "...", FOUND[3]),
            (FOUND[0], "...", FOUND[3]),
        ],
    )
    def test_output_that_fits(self, shown):
        assert find_mismatch(shown, self.FOUND) is None

    @pytest.mark.parametrize(
        ("shown", "line"),
        [
            ((FOUND[0], "  error          0.2528 %", "..."), "  error          0.2528 %"),
            (("...", FOUND[2]), FOUND[2]),
            ((FOUND[1], "..."), FOUND[1]),
            (("...", FOUND[2], "...", FOUND[1], "..."), FOUND[1]),
            ((*FOUND, "more"), "more"),
        ],
    )
    def test_output_that_does_not(self, shown, line):
        assert find_mismatch(shown, self.FOUND) is not None
        if shown[0] != "...":
            assert find_mismatch(shown, self.FOUND) == line

    def test_output_that_is_not_shown(self):
        assert "wrote it" in find_mismatch(self.FOUND[:3], self.FOUND)

    def test_whether_weights_were_cached_does_not_count(self):
        found = (*self.FOUND[:3], "  cache          hit, saved 3.1 s", self.FOUND[3])
        assert find_mismatch(self.FOUND, found) is None


class TestMask:
    @pytest.mark.parametrize(
        ("one", "other"),
        [
            ("  seconds        open 0.01, total 0.78", "  seconds        open 0.14, total 1.32"),
            ("within 1.8e-15, smallest -3.1e-04", "within 2.0e-16, smallest -3.1e-04"),
            ("moved 4.65e-10, 1.8e-08 %", "moved 4.7e-10, 1.9e-08 %"),
            ("done in 3.1 s", "done in 12 s"),
        ],
    )
    def test_what_is_masked(self, one, other):
        assert mask(one) == mask(other)

    @pytest.mark.parametrize(
        ("one", "other"),
        [
            ("error 0.2527 %", "error 0.2528 %"),
            ("smallest -3.1e-04", "smallest -3.2e-04"),
            ("8.1e-07 %", "8.2e-07 %"),
            ("3 seconds", "4 seconds"),
        ],
    )
    def test_what_is_not(self, one, other):
        assert mask(one) != mask(other)


class TestReadSteps:
    def test_commands_and_their_output(self):
        first, second = read_steps("$ cageik a \\\n    b\none\n\n$ cageik c\ntwo\n\nthree\n")
        assert first.words == ["cageik", "a", "b"]
        assert first.shown == ("one",)
        assert second.shown == ("two", "", "three")

    def test_comments_and_quotes_and_patterns(self):
        (step,) = read_steps("$ cageik export 'a b*' c_####.obj nothing_*.obj  # a note\n")
        assert step.words == ["cageik", "export", "a b*", "c_####.obj", "nothing_*.obj"]

    def test_output_before_a_command_is_refused(self):
        with pytest.raises(ValueError, match="output without a command"):
            read_steps("one\n$ cageik\n")


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
