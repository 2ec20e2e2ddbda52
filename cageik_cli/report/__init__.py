"""One record of a result's figures, and its views: text, JSON, CSV."""

from cageik_cli.report.record import Report, report_of
from cageik_cli.report.tables import as_csv, as_json
from cageik_cli.report.text import as_text

__all__ = ["Report", "as_csv", "as_json", "as_text", "report_of"]
