"""The report for programs: JSON of the whole record, CSV of its frames or of the clips."""

import csv
import io
import json
from collections.abc import Sequence
from dataclasses import asdict, fields
from typing import Any

from cageik_cli.report.figures import ClipRecord, FrameRecord, ReportSummary
from cageik_cli.report.overview import ClipEntry, Overview
from cageik_cli.report.record import Report


def format_json(reports: Sequence[Report]) -> str:
    """Format the record as JSON, several records as a list; metrics not defined are null."""
    records = [asdict(report) for report in reports]
    return (
        json.dumps(records[0] if len(records) == 1 else records, indent=1, allow_nan=False) + "\n"
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


def format_overview_json(overview: Overview) -> str:
    """Format the record of a batch as JSON; metrics not defined are null."""
    record = {
        "schema": overview.schema,
        "tool": overview.tool,
        "clips": [_collect_entry(entry) for entry in overview.clips],
    }
    return json.dumps(record, indent=1, allow_nan=False) + "\n"


def _collect_entry(entry: ClipEntry) -> dict[str, Any]:
    """Collect what the record of a batch has of a clip: parts of its report beside its files."""
    report = {} if entry.report is None else asdict(entry.report)
    own = {name: getattr(entry, name) for name in ("name", "fault", "result", "page")}
    own |= {name: report.get(name) for name in ("clip", "binding", "summary")}
    own["curve"] = None if entry.curve is None else asdict(entry.curve)
    own |= {name: report.get(name, ()) for name in ("gates", "notes")}
    return own | {name: report.get(name) for name in ("edited_from", "regions", "fit")}


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
