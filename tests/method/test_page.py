"""The page of the paper runs, and what it says of the folder is so."""

import doctest
import inspect

import cageik_cli.method


def run_examples(text: str) -> doctest.TestResults:
    test = doctest.DocTestParser().get_doctest(text, {}, "the page", None, 0)
    return doctest.DocTestRunner(verbose=False).run(test, out=lambda text: None)


def test_the_page_runs():
    results = run_examples(inspect.getdoc(cageik_cli.method))
    assert results.attempted > 40
    assert results.failed == 0


def test_a_step_that_is_wrong_is_found():
    """With the other sign of δ, one example fails."""
    page = inspect.getdoc(cageik_cli.method)
    wrong = page.replace("delta = L @ cage.vertices", "delta = -L @ cage.vertices")
    assert wrong != page
    assert run_examples(wrong).failed == 1
