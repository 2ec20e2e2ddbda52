"""Shown output is compared line by line, and what differs between machines is masked."""

import pytest

from tests.docs.console import find_mismatch, mask, read_steps


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
