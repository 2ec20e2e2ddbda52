"""The report for test runners: JUnit XML, one suite per clip and one test case per limit.

The elements and attributes are those that the schema of Ant's JUnit task requires.
"""

from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from cageik_cli.report.limits import LimitCheck
from cageik_cli.report.overview import ClipEntry, Overview
from cageik_cli.report.views.text import format_check_row
from cageik_cli.report.vocabulary import Vocabulary
from cageik_cli.util.text import single_line

# The schema requires a time and a host; the same input must give the same bytes.
_FIXED_ATTRIBUTES = {"timestamp": "1970-01-01T00:00:00", "hostname": "localhost", "time": "0"}


def format_junit(overview: Overview) -> str:
    """Write one suite per clip, with a case `extracted` or `edited`, and one case per limit.

    A failed clip is an error, an exceeded limit is a failure, and the limit of a metric that is not
    defined is skipped. Notes are the suite's output.
    """
    root = Element("testsuites")
    for k, entry in enumerate(overview.clips):
        _add_suite(root, k, entry)
    ElementTree.indent(root, " ")
    head = '<?xml version="1.0" encoding="UTF-8"?>'
    return f"{head}\n{ElementTree.tostring(root, encoding='unicode')}\n"


def _add_suite(root: Element, number: int, entry: ClipEntry) -> None:
    words = entry.vocabulary
    name = " ".join(single_line(entry.name).split()) or "unnamed"
    verdicts = [check.passed for check in entry.gates]
    counts = {
        "tests": 1 + len(verdicts),
        "failures": verdicts.count(False),
        "errors": int(entry.has_failed),
        "skipped": verdicts.count(None),
    }
    attributes = {"name": name, "package": "", "id": str(number)}
    attributes |= {key: str(count) for key, count in counts.items()}
    suite = SubElement(root, "testsuite", attributes | _FIXED_ATTRIBUTES)
    SubElement(suite, "properties")
    done = SubElement(suite, "testcase", classname=name, name=words.done, time="0")
    if entry.fault is not None:
        _add_fault(done, "error", single_line(entry.fault))
    for check in entry.gates:
        _add_case(suite, name, check, words)
    SubElement(suite, "system-out").text = "\n".join(map(single_line, entry.notes))
    SubElement(suite, "system-err")


def _add_case(suite: Element, clip: str, check: LimitCheck, words: Vocabulary) -> None:
    case = SubElement(
        suite, "testcase", classname=clip, name=_format_case_name(check, words), time="0"
    )
    verdict, line = format_check_row(check, words)
    if check.passed is None:
        SubElement(case, "skipped", message=line)
    elif not check.passed:
        _add_fault(case, "failure", f"{verdict}: {line}")


def _format_case_name(check: LimitCheck, words: Vocabulary) -> str:
    """Name a limit without the value that was found, so that names are the same in all runs."""
    metric = words.limits[check.metric]
    if check.baseline is not None:
        return f"{metric} against the baseline"
    return f"{metric} at most {check.limit:.10g} {check.unit}"


def _add_fault(case: Element, kind: str, sentence: str) -> None:
    SubElement(case, kind, message=sentence, type=kind).text = sentence
