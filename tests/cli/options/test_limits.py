"""Limits through the command line: what is judged, what is said, and the exit code."""

import json
import os
from decimal import Decimal
from pathlib import Path
from xml.etree import ElementTree

import click
import numpy as np
import pytest

from cageik_cli.cli import main
from cageik_cli.report.figures import format_length, format_percent

TYPED = ("extract", "frames", "--cage", "cage.obj")
EXTRACT = (*TYPED, "--overwrite")

FIELDS = {
    ("max-rms", "%"): "rms_percent",
    ("max-rms", "units"): "rms",
    ("max-frame-rms", "%"): "worst_frame_rms_percent",
    ("max-frame-rms", "units"): "worst_frame_rms",
    ("max-deviation", "%"): "max_deviation_percent",
    ("max-deviation", "units"): "max_deviation",
    ("max-volume-change", "%"): "volume_change_percent_max",
    ("max-volume-change", ""): "volume_change_percent_max",
}


@pytest.fixture
def result(run, extracted) -> dict:
    """The record of `cages.h5`, of the tiny clip, in the current folder."""
    return json.loads(run("report", "--json", "-", "-q").out)


@pytest.fixture
def opened(folder, animation, write_obj) -> Path:
    """`frames` of an open model."""
    for k, vertices in enumerate(animation.frames, start=1):
        write_obj(folder / "frames" / f"frame_{k}.obj", vertices, animation.rest.faces[2:])
    return folder


def printed_figure(record, option, sign) -> Decimal:
    value = abs(record["summary"][FIELDS[option, sign]])
    return Decimal(format_length(value) if sign == "units" else format_percent(value))


@pytest.mark.parametrize(("option", "sign"), FIELDS)
def test_a_limit_holds_for_what_is_printed(run, result, option, sign):
    """At the printed figure a result keeps the limit, just under it does not."""
    figure = printed_figure(result, option, sign)
    assert figure > 0
    step = Decimal(1).scaleb(figure.as_tuple().exponent)
    for most, code, label in ((figure, 0, "within limit"), (figure - step, 3, "over limit")):
        outcome = run("report", "--all", f"--{option}", f"{most}{sign}")
        assert outcome.code == code
        (line,) = [row for row in outcome.out.splitlines() if row.startswith(f"  {label} ")]
        assert f"{figure}" in line
        assert f"limit {float(most):.10g} " in line
        assert "frame_" in line


@pytest.mark.parametrize("sign", ["%", "units"])
def test_extract_judges_too_and_writes_all_the_same(run, result, sign):
    figure = printed_figure(result, "max-rms", sign)
    under = figure - Decimal(1).scaleb(figure.as_tuple().exponent)
    before = Path("cages.h5").read_bytes()
    kept = run(*EXTRACT, "-v", "--max-rms", f"{figure}{sign}")
    assert (kept.code, "  within limit   rms " in kept.err) == (0, True)
    Path("cages.h5").unlink()
    over = run(*TYPED, "-v", "--max-rms", f"{under}{sign}", "--export", "cage.npz")
    assert (over.code, over.out) == (3, "")
    assert "  over limit     rms " in over.err
    assert "wrote cages.h5" in over.err
    assert Path("cages.h5").read_bytes() == before
    assert Path("cage.npz").exists()


@pytest.mark.parametrize("words", [EXTRACT, ("report",)])
def test_quiet_says_what_is_over_its_limit_and_nothing_else(run, result, words):
    outcome = run(
        *words, "-q", "--max-rms", "0%", "--max-deviation", "1000%", "--max-frame-rms", "0%"
    )
    assert (outcome.code, outcome.out) == (3, "")
    first, second = outcome.err.splitlines()
    assert first.startswith("cages.h5: over limit: rms ")
    assert second.startswith("cages.h5: over limit: frame rms ")
    outcome = run(*words, "-q", "--max-rms", "1000%")
    assert (outcome.code, outcome.out, outcome.err) == (0, "", "")


def test_what_an_open_model_lacks_is_not_judged(run, opened):
    outcome = run(*TYPED, "-v", "--max-volume-change", "0")
    assert outcome.code == 0
    assert "  not checked    volume change not defined, limit 0 %" in outcome.err
    outcome = run("report", "--max-volume-change", "0", "--json", "-")
    (gate,) = json.loads(outcome.out)["gates"]
    assert gate == {
        "metric": "volume_change", "unit": "%", "limit": 0.0, "found": None, "frame": None,
        "passed": None, "baseline": None,
    }  # fmt: skip
    assert run("report", "--max-volume-change", "0", "--max-rms", "0%").code == 3


def test_each_of_several_results_is_judged(run, result, animation):
    """A result without error beside one with."""
    np.savez("still.npz", verts=animation.frames[:1].repeat(2, 0), faces=animation.rest.faces)
    assert run("extract", "still.npz", "--cage", "cage.obj", "-o", "still.h5", "-q").code == 0
    for names, code in (
        (["still.h5"], 0), (["cages.h5"], 3), (["still.h5", "cages.h5"], 3),
        (["cages.h5", "still.h5"], 3),
    ):  # fmt: skip
        outcome = run("report", "--all", *names, "--max-rms", "0.0001%", "--json", "-")
        assert outcome.code == code
        assert outcome.err.count("over limit") == (1 if code else 0)
        assert outcome.err.count("within limit") == (1 if "still.h5" in names else 0)


LENGTHS = ["max-rms", "max-frame-rms", "max-deviation"]
PERCENTS = ["max-volume-change", "max-regression"]


def parse(option, value):
    """The limit that a word is for `extract`, of which nothing runs."""
    words = ["frames", f"--{option}", value, "--baseline", "old.json"]
    context = main.commands["extract"].make_context("extract", words)
    limit = context.params[option.replace("-", "_")]
    return limit.value, "%" if limit.is_percent else "units"


@pytest.mark.parametrize(
    "value",
    ["%", "units", "-1", "-0.5%", "-1units", "nan", "inf%", "1e400", "0.5 percent", "1_0",
     "1,5%", "0x1%", "%5", "1%%", "1unit", "1%units", "٣%", "1e", "1e9999%"],
)  # fmt: skip
def test_anything_else_is_no_limit(value):
    for option in LENGTHS + PERCENTS:
        with pytest.raises(click.BadParameter, match="is not a limit; expected a finite number"):
            parse(option, value)


@pytest.mark.parametrize("value", ["0", "0.4", "1000", "1e3", "1000.", "+.5"])
def test_a_length_has_a_unit_and_a_change_of_volume_is_in_percent(value):
    number = value.removeprefix("+")
    for option in LENGTHS:
        with pytest.raises(click.BadParameter) as refused:
            parse(option, value)
        assert f"'{value}' has no unit; give {number}% " in refused.value.message
    for option in PERCENTS:
        assert parse(option, value) == parse(option, f"{value}%") == (Decimal(number), "%")
        with pytest.raises(click.BadParameter, match="is not a limit"):
            parse(option, f"{value}units")


@pytest.mark.parametrize(
    ("value", "number", "unit"),
    [
        ("1000%", "1000", "%"), (" 1000% ", "1000", "%"), ("1000 %", "1000", "%"),
        ("+1000%", "1000", "%"), ("1e3%", "1e3", "%"), (".5e4%", "5000", "%"), ("0%", "0", "%"),
        ("0.0001%", "0.0001", "%"), ("1000units", "1000", "units"),
        ("1000 units", "1000", "units"), ("1e3Units", "1000", "units"), ("0units", "0", "units"),
        ("1e-9 UNITS", "1e-9", "units"),
    ],
)  # fmt: skip
def test_lengths_are_spelt_in_two_ways(value, number, unit):
    for option in LENGTHS:
        assert parse(option, value) == (Decimal(number), unit)


def test_a_large_limit_in_units_is_noted(run, result):
    """Somebody may have meant percent."""
    diagonal = result["clip"]["diagonal"]
    for share, count in ((0.049, 0), (0.051, 1)):
        typed = f"{share * diagonal:.9f}"
        outcome = run("report", "-v", "--max-deviation", f"{typed}units", "--json", "-")
        notes = [note for note in json.loads(outcome.out)["notes"] if "units" in note]
        assert len(notes) == count
        assert outcome.err.count("% of the diagonal, more than 5 %") == count
        in_percent = run("report", "--max-deviation", f"{typed}%", "--json", "-")
        assert "more than 5 %" not in in_percent.err
    assert f"if percent is meant, give {float(typed):.10g}%" in notes[0]
    assert "max deviation is 5.1 %" in notes[0]


@pytest.mark.parametrize(
    ("table", "code"),
    [
        ("max-rms = '0%'", 3), ("max_rms = '0units'", 3), ("max-rms = '1000%'", 0),
        ("max-rms = '1000units'", 0), ("max-rms = 0", 2), ("max-rms = 0.0", 2), ("max-rms = 1", 2),
        ("max-rms = '0.4'", 2), ("max-frame-rms = 0.4", 2), ("max-deviation = 0.4", 2),
        ("max-volume-change = 0.0001", 3), ("max-volume-change = '100 %'", 0),
        ("max-rms = -1", 2), ("max-rms = nan", 2), ("max-rms = inf", 2), ("max-rms = true", 2),
        ("max-rms = [1]", 2), ("max-rms = 'much'", 2), ("max-regression = 5", 2),
        ("baseline = 5", 2),
        ("baseline = 'nowhere.json'", 1),
    ],
)  # fmt: skip
def test_limits_come_from_the_file_of_options_too(run, result, table, code):
    Path("cageik.toml").write_text(f"[report]\n{table}\n[extract]\n{table}\n")
    assert run("report", "--config", "cageik.toml").code == code
    assert run(*EXTRACT, "--config", "cageik.toml").code == code


def halved(record: dict, name: str = "cages.h5") -> str:
    """A report whose figures are half of another's."""
    summary = {
        key: value / 2 if isinstance(value, float) else value
        for key, value in record["summary"].items()
    }
    return json.dumps(record | {"summary": summary, "result": name})


def test_an_earlier_run_is_a_limit(run, result):
    assert run("report", "--json", "old.json", "-q").code == 0
    for words in (EXTRACT, ("report",)):
        outcome = run(*words, "-v", "--baseline", "old.json", "--max-regression", "0")
        assert outcome.code == 0
        assert (outcome.out + outcome.err).count("  within limit   ") == 4
    Path("half.json").write_text(halved(result, "renamed.h5"))
    for words in (EXTRACT, ("report",)):
        outcome = run(*words, "-v", "--baseline", "half.json")
        assert outcome.code == 3
        assert (outcome.out + outcome.err).count("  over limit     ") == 4
        assert run(*words, "--baseline", "half.json", "--max-regression", "101%").code == 0
        assert run(*words, "--baseline", "half.json", "--max-regression", "99").code == 3


def test_several_results_are_compared_by_name(run, result):
    Path("other.h5").write_bytes(Path("cages.h5").read_bytes())
    Path("half.json").write_text(halved(result))
    outcome = run("report", "--all", "cages.h5", "other.h5", "--baseline", "half.json")
    assert outcome.code == 3
    first, second = outcome.out.split("\n\n")
    assert first.count("over limit") == 4
    assert "limit" not in second
    assert "  note           not compared with the baseline: half.json has no such clip" in second
    assert outcome.err == "other.h5: not in the baseline half.json (--allow-new accepts this)\n"
    assert run("report", "other.h5", "--baseline", "half.json").code == 3  # by its frames


def test_the_default_regression_is_ten_percent(run, result):
    for factor, code in ((1.099, 3), (1.101, 0)):
        old = json.loads(halved(result))
        for name in set(FIELDS.values()):
            old["summary"][name] = result["summary"][name] * factor / 1.21
        Path("old.json").write_text(json.dumps(old))
        assert run("report", "--baseline", "old.json").code == code


@pytest.mark.parametrize("words", [EXTRACT, ("report",)])
@pytest.mark.parametrize(
    ("metric", "key", "option"),
    [
        ("rms_percent", "rms", "max-rms"),
        ("worst_frame_rms_percent", "worst_frame_rms", "max-frame-rms"),
        ("max_deviation_percent", "max_deviation", "max-deviation"),
    ],
)
def test_a_length_without_a_unit_in_a_baseline_is_wrong_usage(
    run, result, words, metric, key, option
):
    before = Path("cages.h5").read_bytes()
    summary = {name: value for name, value in result["summary"].items() if name != metric}
    documents = (
        ({option: 0.4}, option),
        ({option.replace("-", "_"): 0.4}, option.replace("-", "_")),
        (result | {"summary": summary | {key: 0.4}}, key),
    )
    for document, named in documents:
        Path("old.json").write_text(json.dumps(document))
        outcome = run(*words, "--baseline", "old.json")
        assert (outcome.code, outcome.out) == (2, "")
        said = " ".join(outcome.err.split())
        assert f"'{named}' is 0.4, " in said
        assert "old.json: " in said
        assert all(remedy in said for remedy in (metric, f"--{option} 0.4%", "0.4units"))
    assert Path("cages.h5").read_bytes() == before


def test_results_of_one_file_name_are_called_by_their_paths(run, result):
    for name in ("a", "b"):
        Path(name).mkdir()
        Path(name, "cages.h5").write_bytes(Path("cages.h5").read_bytes())
    words = ("report", "a/cages.h5", "b/cages.h5")
    assert run(*words, "--json", "old.json", "-q").code == 0
    records = json.loads(Path("old.json").read_text())
    assert [record["result"] for record in records] == ["a/cages.h5", "b/cages.h5"]
    outcome = run(*words, "--all", "--baseline", "old.json")
    assert outcome.code == 0
    assert outcome.out.count("within limit") == 8


def test_junit_and_markdown_are_alone_on_stdout(run, result):
    outcome = run("report", "--junit", "-", "--max-rms", "0%")
    assert outcome.code == 3
    (suite,) = ElementTree.fromstring(outcome.out)
    assert (suite.get("name"), suite.get("failures")) == ("cages.h5", "1")
    assert outcome.err.startswith("cages.h5: 5 frames")
    outcome = run("report", "--markdown", "-", "--max-rms", "0%", "-q")
    assert outcome.code == 3
    assert outcome.out.startswith("## cageik: 1 clip: 1 over limit\n")
    assert len(outcome.err.splitlines()) == 1


def test_reports_are_written_although_a_limit_is_passed(run, result):
    words = ["--json", "r.json", "--csv", "f.csv", "--junit", "j.xml", "--markdown", "m.md"]
    assert run("report", "--max-rms", "0%", *words).code == 3
    assert json.loads(Path("r.json").read_text())["gates"][0]["passed"] is False
    for name, option in (("f.csv", "--csv"), ("j.xml", "--junit"), ("m.md", "--markdown")):
        assert Path(name).read_text() == run("report", "--max-rms", "0%", option, "-").out


class TestStepSummary:
    """The page of a step on GitHub is appended to; it never spoils a run."""

    @pytest.fixture
    def page(self, result, tmp_path, monkeypatch) -> Path:
        path = tmp_path / "summary.md"
        monkeypatch.setenv("GITHUB_STEP_SUMMARY", str(path))
        return path

    def test_it_is_appended_to(self, run, page):
        page.write_text("before\n")
        assert run("report", "--markdown", "m.md", "--max-rms", "0%").code == 3
        once = Path("m.md").read_text()
        assert page.read_text() == f"before\n{once}\n"
        assert run("report", "-q").err == ""
        assert page.read_text().count("## cageik") == 2

    def test_it_is_made(self, run, page):
        assert run("report").code == 0
        assert page.read_text().startswith("## cageik: 1 clip")

    def test_no_name_is_no_page(self, run, page, monkeypatch):
        monkeypatch.setenv("GITHUB_STEP_SUMMARY", "")
        assert (run("report").code, run("report").err) == (0, "")
        assert not page.exists()

    @pytest.mark.parametrize("limits", [[], ["--max-rms", "0%"]])
    def test_what_prevents_it_is_a_warning(self, run, page, limits):
        page.mkdir()
        outcome = run("report", *limits)
        assert outcome.code == (3 if limits else 0)
        assert outcome.err.startswith(f"Warning: {page} (GITHUB_STEP_SUMMARY): cannot be written (")
        assert len(outcome.err.splitlines()) == 1

    @pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="pipes have no names on this system")
    def test_a_pipe_is_not_waited_for(self, run, page):
        os.mkfifo(page)
        outcome = run("report", "-q")
        assert outcome.code == 0
        assert outcome.err == (
            f"Warning: {page} (GITHUB_STEP_SUMMARY): cannot be written (not a plain file)\n"
        )

    def test_a_page_that_is_full_stays_as_it_is(self, run, page):
        full = "x" * (1 << 20)
        page.write_text(full)
        outcome = run("report")
        assert outcome.code == 0
        assert "1048576" in outcome.err
        assert page.read_text() == full


def test_a_baseline_may_stand_beside_the_clips_of_a_batch(folder, run):
    Path("frames/cageik.toml").write_text('baseline = "none.json"\n')
    words = ("batch", "frames", "-o", "out", "--cage", "cage.obj", "--max-regression", "3%")
    outcome = run(*words, "--dry-run")
    assert "none.json" in outcome.err
    assert "needs --baseline" not in outcome.err
