"""JUnit XML: it follows Ant's schema for every clip and every name."""

import re
from dataclasses import replace
from xml.etree import ElementTree

import pytest

from cageik_cli.report.overview import ClipEntry, Overview
from cageik_cli.report.views.data import format_junit
from tests.report.clips import HOSTILE, clip, gate, poor

SUITE = {
    "name", "package", "id", "tests", "failures", "errors", "skipped", "timestamp", "hostname",
    "time",
}  # fmt: skip
FAULT = {"message", "type"}


def is_token(text: str) -> bool:
    """Whether the schema accepts a text as a name of at least one character."""
    return text != "" and text == " ".join(text.split())


def find_faults(text: str) -> list[str]:
    """List violations of the schema, one per line."""
    root = ElementTree.fromstring(text.encode())
    suites = list(root)
    found = ["root"] * (root.tag != "testsuites" or root.attrib != {})
    found += ["ids do not count"] * (
        [s.get("id") for s in suites] != [*map(str, range(len(suites)))]
    )
    for suite in suites:
        found += _suite_faults(suite)
    return found


def _suite_faults(suite: ElementTree.Element) -> list[str]:
    cases, tags = suite.findall("testcase"), [child.tag for child in suite]
    counted = {
        "tests": len(cases),
        "failures": len(suite.findall("testcase/failure")),
        "errors": len(suite.findall("testcase/error")),
        "skipped": len(suite.findall("testcase/skipped")),
    }
    right = {
        "suite": suite.tag == "testsuite" and set(suite.attrib) == SUITE,
        "name": is_token(suite.get("name", "")),
        "order": tags == ["properties", *["testcase"] * len(cases), "system-out", "system-err"],
        "counts": {name: int(suite.get(name, "-1")) for name in counted} == counted,
        "times": {e.get("time") for e in (suite, *cases)} == {"0"},
        "stamp": bool(re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d", suite.get("timestamp", ""))),
        "cases": all(set(case.attrib) == {"name", "classname", "time"} for case in cases),
        "names": all(is_token(case.get(n, "")) for case in cases for n in ("name", "classname")),
        "twice": len({case.get("name") for case in cases}) == len(cases),
        "outcomes": all(len(case) <= 1 for case in cases),
        "faults": all(
            set(fault.attrib) == FAULT and fault.tag in ("failure", "error")
            for case in cases
            for fault in case
            if fault.tag != "skipped"
        ),
    }
    return [name for name, holds in right.items() if not holds]


BASELINE = {"baseline": 0.2}
CLIPS = (
    clip("run", gate(True), gate(False, **BASELINE), notes=["one", "two & three"]),
    ClipEntry("broken", fault="frame_3.obj: is <empty>"),
    clip("walk/open", gate(None, metric="volume_change", frame=None), gate(False)),
    clip("plain"),
)


def test_the_xml_follows_the_schema():
    assert find_faults(format_junit(Overview(CLIPS))) == []
    assert find_faults(format_junit(Overview([]))) == []


@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        ("<testsuites>", '<testsuites name="a">', "root"),
        ("testsuites>", "suites>", "root"),
        ('tests="3"', 'tests="2"', "counts"),
        ('failures="1"', 'failures="0"', "counts"),
        ('errors="1"', 'errors="0"', "counts"),
        ('skipped="1"', 'skipped="0"', "counts"),
        ('<testsuite name="run"', '<testsuite name=""', "name"),
        (' hostname="localhost"', "", "suite"),
        ('id="3"', 'id="2"', "ids do not count"),
        ("<properties />", "", "order"),
        ("<system-err />", "", "order"),
        ('name="extracted" time="0"', 'name="extracted" time="0.1"', "times"),
        ('classname="run" ', "", "cases"),
        ('classname="run"', 'classname=" run"', "names"),
        (' type="failure"', "", "faults"),
        ("T00:00:00", "", "stamp"),
        ("rms against the baseline", "extracted", "twice"),
        ("</failure>", "</failure><skipped />", "outcomes"),
    ],
)
def test_the_schema_check_finds_faults(old, new, fault):
    text = format_junit(Overview(CLIPS))
    assert old in text
    assert fault in find_faults(text.replace(old, new))


def test_times_are_those_of_a_timed_run():
    timed = (
        ClipEntry("broken", fault="no", seconds=0.0421),
        replace(clip("a", gate(True)), seconds=61.5),
    )
    root = ElementTree.fromstring(format_junit(Overview(timed)))
    assert [suite.get("time") for suite in root] == ["0.042", "61.500"]
    assert [case.get("time") for case in root.iter("testcase")] == ["0.042", "61.500", "0"]


def test_every_clip_is_a_suite_and_every_limit_a_case():
    root = ElementTree.fromstring(format_junit(Overview(CLIPS)))
    run, broken, opened, plain = root
    outcomes = {
        suite.get("name"): {
            case.get("name"): [e.tag for e in case] for case in suite.iter("testcase")
        }
        for suite in root
    }
    assert outcomes == {
        "run": {"extracted": [], "rms at most 0.5 %": [], "rms against the baseline": ["failure"]},
        "broken": {"extracted": ["error"]},
        "walk/open": {
            "extracted": [],
            "volume change at most 0.5 %": ["skipped"],
            "rms at most 0.5 %": ["failure"],
        },
        "plain": {"extracted": []},
    }
    assert run.find("testcase/failure").get("message") == (
        "over limit: rms 0.7500 %, limit 0.5000 % (baseline 0.2000 %), worst frame f_7.obj"
    )
    assert broken.find("testcase/error").text == "frame_3.obj: is <empty>"
    assert (
        opened.find("testcase/skipped").get("message") == "volume change not defined, limit 0.5 %"
    )
    assert run.find("system-out").text == "one\ntwo & three"
    assert [plain.get(count) for count in ("tests", "failures", "errors")] == ["1", "0", "0"]


def test_a_poor_clip_is_no_failure_and_is_said():
    root = ElementTree.fromstring(format_junit(Overview([poor("a/x", gate(True)), clip("a/y")])))
    one, other = root.iter("testsuite")
    assert (one.get("failures"), one.get("errors")) == ("0", "0")
    assert one.find("system-out").text == "poor: a/x"
    assert not other.find("system-out").text


@pytest.mark.parametrize("name", HOSTILE.values(), ids=HOSTILE)
def test_any_name_gives_valid_xml(name):
    entries = [
        clip(name, gate(False, frame=name), notes=[name]),
        ClipEntry(name, fault=name),
    ]
    text = format_junit(Overview(entries))
    assert find_faults(text) == []
    if name.isprintable() and is_token(name):
        assert ElementTree.fromstring(text)[0].get("name") == name


def test_the_same_run_gives_the_same_text():
    assert format_junit(Overview(CLIPS)) == format_junit(Overview(CLIPS))
