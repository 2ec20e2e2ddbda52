"""One record of a result's figures, and its views: text, JSON, CSV, JUnit, Markdown."""

from cageik_cli.report.baseline import read_baseline
from cageik_cli.report.gates import Baseline, Gate, Limit, Limits
from cageik_cli.report.junit import as_junit
from cageik_cli.report.markdown import as_markdown
from cageik_cli.report.overview import Entry, Overview, entry_of, overview_of
from cageik_cli.report.poses import Pose, Poses, poses_of
from cageik_cli.report.record import Report, report_of
from cageik_cli.report.tables import as_csv, as_json, overview_csv, overview_json
from cageik_cli.report.text import as_text, gate_row
from cageik_cli.report.wording import wording_of

__all__ = [
    "Baseline",
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
    "as_junit",
    "as_markdown",
    "as_text",
    "entry_of",
    "gate_row",
    "overview_csv",
    "overview_json",
    "overview_of",
    "poses_of",
    "read_baseline",
    "report_of",
    "wording_of",
]
