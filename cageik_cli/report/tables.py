"""The report for programs: JSON of the whole record, CSV of its frames."""

import csv
import io
import json
from collections.abc import Sequence
from dataclasses import asdict, fields

from cageik_cli.report.figures import Frame
from cageik_cli.report.record import Report


def as_json(reports: Sequence[Report]) -> str:
    """The record as JSON; several records as a list. Undefined figures are null."""
    records = [asdict(report) for report in reports]
    return (
        json.dumps(records[0] if len(records) == 1 else records, indent=1, allow_nan=False) + "\n"
    )


def as_csv(reports: Sequence[Report]) -> str:
    """A line a frame, with its result's name first; undefined figures are empty."""
    stream = io.StringIO()
    columns = [field.name for field in fields(Frame)]
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["result", *columns])
    for report in reports:
        for frame in report.frames:
            writer.writerow([report.result, *(getattr(frame, column) for column in columns)])
    return stream.getvalue()
