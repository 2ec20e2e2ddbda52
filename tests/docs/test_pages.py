"""The blocks of all pages run, and give what the pages show."""

import pytest

from tests.docs.pages import find_pages, name_page, read_blocks
from tests.docs.session import run_page

RUN = {"console", "python"}
PAGES = [path for path in find_pages() if RUN & {block.language for block in read_blocks(path)}]


@pytest.mark.slow
@pytest.mark.parametrize("path", PAGES, ids=name_page)
def test_a_page_shows_what_its_blocks_give(path, page_folder, docs_cache):
    faults, _ = run_page(path, page_folder, docs_cache)
    assert not faults, "\n".join(map(str, faults))


class TestAWrongPage:
    """Every kind of wrong block is a fault of its page."""

    @pytest.fixture
    def faults_of(self, page_folder, docs_cache, write_page):
        return lambda text: list(map(str, run_page(write_page(text), page_folder, docs_cache)[0]))

    def test_a_right_page_has_no_fault(self, faults_of):
        text = (
            "```console\n$ cageik info data_fixtures/walker/cage.obj\n"
            "data_fixtures/walker/cage.obj\n  ...\n```\n"
            "```python\n>>> 1 + 1\n2\n```\n"
            "```python\nassert 1\n```\n"
        )
        assert faults_of(text) == []

    def test_output_that_differs_in_one_digit(self, faults_of):
        shown = "$ cageik info data_fixtures/walker/cage.obj\n...\n  vertices       81\n  ...\n"
        (fault,) = faults_of(f"```console\n{shown}```\n")
        assert "vertices       81" in fault
        assert "page.md:1" in fault

    def test_output_that_is_left_out_without_an_ellipsis(self, faults_of):
        (fault,) = faults_of("```console\n$ cageik info data_fixtures/walker/cage.obj\n```\n")
        assert "the command goes on with" in fault

    def test_an_exit_code_that_the_page_does_not_state(self, faults_of):
        (fault,) = faults_of("```console\n$ cageik info nothing.obj\n...\n```\n")
        assert "exit code 1, expected 0" in fault

    def test_an_exit_code_that_the_page_states_wrongly(self, faults_of):
        text = "<!-- exit: 3 -->\n\n```console\n$ cageik info nothing.obj\n...\n```\n"
        (fault,) = faults_of(text)
        assert "exit code 1, expected 3" in fault

    def test_an_option_that_does_not_exist(self, faults_of):
        text = "<!-- exit: 0 -->\n\n```console\n$ cageik info --wrong x\n...\n```\n"
        (fault,) = faults_of(text)
        assert "exit code 2" in fault

    def test_a_doctest_that_fails(self, faults_of):
        (fault,) = faults_of("```python\n>>> 1 + 1\n3\n```\n")
        assert "Expected" in fault

    def test_a_script_that_fails(self, faults_of):
        (fault,) = faults_of("```python\nx = missing\n```\n")
        assert "NameError" in fault

    def test_a_program_that_is_not_cageik(self, faults_of):
        with pytest.raises(ValueError, match="run cageik only"):
            faults_of("```console\n$ ls\n```\n")


class TestSkippedBlocks:
    def test_a_block_waits_for_names_that_the_package_lacks(
        self, page_folder, docs_cache, write_page
    ):
        code = "from cageik_cli import no_such_name\n"
        page = write_page(f"<!-- skip -->\n\n```python\n{code}```\n")
        faults, (skipped,) = run_page(page, page_folder, docs_cache)
        assert faults == []
        assert "no_such_name" in skipped.reason

    def test_a_block_runs_as_soon_as_its_names_are_there(self, page_folder, docs_cache, write_page):
        code = "from cageik_cli import __version__\nassert not __version__\n"
        page = write_page(f"<!-- skip -->\n\n```python\n{code}```\n")
        (fault,), skipped = run_page(page, page_folder, docs_cache)
        assert "AssertionError" in fault.text
        assert skipped == []
