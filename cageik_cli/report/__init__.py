"""One record of a result's figures, and its views: text, JSON, CSV."""

from cageik_cli.report.gates import Gate, Limit, Limits
from cageik_cli.report.overview import Entry, Overview, entry_of, overview_of
from cageik_cli.report.poses import Pose, Poses, poses_of
from cageik_cli.report.record import Report, report_of
from cageik_cli.report.tables import as_csv, as_json
from cageik_cli.report.text import as_text

__all__ = [
    "Entry",
    "Gate",
    "Limit",
    "Limits",
    "Overview",
    "Pose",
    "Poses",
    "Report",
    "as_csv",
    "as_json",
    "as_text",
    "entry_of",
    "overview_of",
    "poses_of",
    "report_of",
]
