"""The report for programs: JSON of the whole record, CSV of its frames or of a run's clips."""

import csv
import io
import json
from collections.abc import Sequence
from dataclasses import asdict, fields

from cageik_cli.report.figures import ClipRecord, FrameRecord, ReportSummary
from cageik_cli.report.overview import Overview
from cageik_cli.report.record import Report


def format_json(reports: Sequence[Report]) -> str:
    """The record as JSON; several records as a list. Undefined figures are null."""
    records = [asdict(report) for report in reports]
    return (
        json.dumps(records[0] if len(records) == 1 else records, indent=1, allow_nan=False) + "\n"
    )


def format_csv(reports: Sequence[Report]) -> str:
    """A line a frame, with its result's name first; undefined figures are empty."""
    stream = io.StringIO()
    columns = [field.name for field in fields(FrameRecord)]
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["result", *columns])
    for report in reports:
        for frame in report.frames:
            writer.writerow([report.result, *(getattr(frame, column) for column in columns)])
    return stream.getvalue()


def format_overview_json(overview: Overview) -> str:
    """The record of a run as JSON; undefined figures are null."""
    return json.dumps(asdict(overview), indent=1, allow_nan=False) + "\n"


def format_overview_csv(overview: Overview) -> str:
    """A line a clip: its fault if it failed, the limits it is over, its counts and summary."""
    stream = io.StringIO()
    parts = (("clip", ClipRecord), ("summary", ReportSummary))
    columns = [(part, field.name) for part, record in parts for field in fields(record)]
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["name", "fault", "over_limit", *(name for _, name in columns)])
    for entry in overview.clips:
        over = dict.fromkeys(check.metric for check in entry.gates if check.passed is False)
        figures = (getattr(getattr(entry, part), name, None) for part, name in columns)
        writer.writerow([entry.name, entry.fault, " ".join(over), *figures])
    return stream.getvalue()
