"""The report for programs: JSON of the whole record, CSV of frames or clips, and JUnit XML."""

import csv
import io
import json
from collections.abc import Sequence
from dataclasses import asdict, fields, replace
from typing import Any, TypedDict
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from cageik_cli.report.figures import (
    REPORT_SCHEMA,
    ClipRecord,
    FrameRecord,
    ReportSummary,
    ToolRecord,
)
from cageik_cli.report.limits import Gap, LimitCheck
from cageik_cli.report.overview import ClipEntry, Overview, describe_poor
from cageik_cli.report.record import Report
from cageik_cli.report.views.text import format_check_row
from cageik_cli.report.vocabulary import Vocabulary
from cageik_cli.util.messages import Note
from cageik_cli.util.text import single_line
from cageik_cli.util.version import __version__


def format_json(reports: Sequence[Report], gaps: Sequence[Gap] = ()) -> str:
    """Format the record as JSON, several records as a list; metrics not defined are null.

    `gaps` of the run are in each record, if there are any.
    """
    shared = {"gaps": list(map(asdict, gaps))} if gaps else {}
    records = [asdict(report) | shared for report in reports]
    return (
        json.dumps(
            records[0] if len(records) == 1 else records, indent=1, allow_nan=False, default=str
        )
        + "\n"
    )


def format_csv(reports: Sequence[Report]) -> str:
    """Write one line per frame, starting with its result's name; metrics not defined are empty."""
    stream = io.StringIO()
    columns = [field.name for field in fields(FrameRecord)]
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["result", *columns])
    for report in reports:
        for frame in report.frames:
            writer.writerow([report.result, *(getattr(frame, column) for column in columns)])
    return stream.getvalue()


ENTRY_FIELDS = (
    (ClipEntry, ("name", "fault", "result", "page")),
    (Report, ("baseline_name", "sources", "clip", "binding", "summary")),
    (ClipEntry, ("curve",)),
    (Report, ("gates", "notes", "edited_from", "regions", "fit", "quality")),
)
"""What the record of a batch has of a clip: fields of its entry, and of its report."""


class BatchRecord(TypedDict):
    """The report of a batch, its `report.json`.

    Attributes
    ----------
    schema : int
        Version of this record; it changes when a field does.
    tool : ToolRecord
        What wrote the report.
    notes : tuple of str
        On the run as a whole, such as on files that are no clips.
    gaps : tuple of Gap
        Clips that the run or its baseline lacks, and that are not allowed.
    clips : list of dict
        The clips, in order of their names.
    """

    schema: int
    tool: ToolRecord
    notes: tuple[str, ...]
    gaps: tuple[Gap, ...]
    clips: tuple[dict[str, Any], ...]


def format_overview_json(overview: Overview) -> str:
    """Format the record of a batch as JSON; metrics not defined are null."""
    record = BatchRecord(
        schema=REPORT_SCHEMA,
        tool=ToolRecord(name="cageik", version=__version__),
        notes=tuple(overview.notes),
        gaps=overview.gaps,
        clips=tuple(map(_collect_entry, overview.clips)),
    )
    return json.dumps(record, indent=1, allow_nan=False, default=_make_plain) + "\n"


def _collect_entry(entry: ClipEntry) -> dict[str, Any]:
    """Collect what the record of a batch has of a clip; a failed one has no report."""
    held: dict[type, Any] = {ClipEntry: entry, Report: entry.report}
    lists = {"gates": (), "notes": ()}
    return {
        name: getattr(held[record], name, lists.get(name))
        for record, names in ENTRY_FIELDS
        for name in names
    }


def _make_plain(value: Any) -> Any:
    return str(value) if isinstance(value, Note) else asdict(value)


def format_overview_csv(overview: Overview) -> str:
    """Write one line per clip: its fault, the limits it exceeds, its counts and summary."""
    stream = io.StringIO()
    parts = (("clip", ClipRecord), ("summary", ReportSummary))
    columns = [(part, field.name) for part, record in parts for field in fields(record)]
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["name", "fault", "over_limit", *(name for _, name in columns)])
    for entry in overview.clips:
        over = dict.fromkeys(check.metric for check in entry.gates if check.passed is False)
        values = (getattr(getattr(entry.report, part, None), name, None) for part, name in columns)
        writer.writerow([entry.name, entry.fault, " ".join(over), *values])
    return stream.getvalue()


def format_junit(overview: Overview) -> str:
    """Write JUnit XML: per clip a suite, with a case `extracted` or `edited` and one per limit.

    A failed clip is an error, an exceeded limit is a failure, and the limit of a metric that is not
    defined is skipped. Notes are the suite's output. Clips that the run or its baseline lacks are
    failures of a suite of their own. The elements and attributes are those that the schema of Ant's
    JUnit task requires. Times are 0 but in a batch that is timed.
    """
    root = Element("testsuites")
    for k, entry in enumerate(overview.clips):
        _add_suite(root, k, entry)
    if overview.gaps:
        _add_gaps(root, len(overview.clips), overview.gaps)
    ElementTree.indent(root, " ")
    head = '<?xml version="1.0" encoding="UTF-8"?>'
    return f"{head}\n{ElementTree.tostring(root, encoding='unicode')}\n"


def _add_gaps(root: Element, number: int, gaps: Sequence[Gap]) -> None:
    """Add a suite with a failed case for each clip that the run or the baseline lacks."""
    counts = {"tests": len(gaps), "failures": len(gaps), "errors": 0, "skipped": 0}
    suite = _start_suite(root, number, "baseline", counts)
    for gap in gaps:
        name = " ".join(single_line(gap.name).split()) or "unnamed"
        case = SubElement(suite, "testcase", classname=name, name="in run and baseline", time="0")
        _add_fault(case, "failure", single_line(gap.text))
    SubElement(suite, "system-out")
    SubElement(suite, "system-err")


def _start_suite(
    root: Element, number: int, name: str, counts: dict[str, int], time: str = "0"
) -> Element:
    attributes = {"name": name, "package": "", "id": str(number)}
    attributes |= {key: str(count) for key, count in counts.items()}
    # The schema requires a date and a host; the same input must give the same bytes.
    fixed = {"timestamp": "1970-01-01T00:00:00", "hostname": "localhost", "time": time}
    suite = SubElement(root, "testsuite", attributes | fixed)
    SubElement(suite, "properties")
    return suite


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
    time = f"{entry.seconds:.3f}" if entry.seconds else "0"
    suite = _start_suite(root, number, name, counts, time)
    done = SubElement(suite, "testcase", classname=name, name=words.done, time=time)
    if entry.fault is not None:
        _add_fault(done, "error", single_line(entry.fault))
    for check in entry.gates:
        _add_case(suite, name, check, words)
    output = [*describe_poor([replace(entry, label=entry.name)]), *map(str, entry.notes)]
    SubElement(suite, "system-out").text = "\n".join(map(single_line, output))
    SubElement(suite, "system-err")


def _add_case(suite: Element, clip: str, check: LimitCheck, words: Vocabulary) -> None:
    # Without the value that was found, so that names are the same in all runs.
    name = f"{words.limits[check.metric]} at most {check.limit:.10g} {check.unit}"
    if check.baseline is not None:
        name = f"{words.limits[check.metric]} against the baseline"
    case = SubElement(suite, "testcase", classname=clip, name=name, time="0")
    verdict, line = format_check_row(check, words)
    if check.passed is None:
        SubElement(case, "skipped", message=line)
    elif not check.passed:
        _add_fault(case, "failure", f"{verdict}: {line}")


def _add_fault(case: Element, kind: str, sentence: str) -> None:
    SubElement(case, kind, message=sentence, type=kind).text = sentence
