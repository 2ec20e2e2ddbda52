"""The mark in the head of a page, by which a page that exists is found to be up to date."""

import hashlib
from pathlib import Path

from cageik_cli.report.record import Report
from cageik_cli.report.views.tables import format_json
from cageik_cli.util.files import open_input

HEAD_BYTES = 512
"""The first bytes of a page, which hold the tag that names its record."""


def compute_record_digest(report: Report) -> str:
    """Compute the SHA-256 of a report as `format_json` writes it, in hexadecimal digits."""
    return hashlib.sha256(format_json([report]).encode()).hexdigest()


def is_page_current(
    path: Path, report: Report, has_pictures: bool, has_player: bool = False
) -> bool:
    """Whether the page at `path` exists and shows this report, with or without these parts.

    Only the first bytes of the file are read.
    """
    if not path.is_file():
        return False
    with open_input(path) as file:
        mark = make_record_mark(compute_record_digest(report), has_pictures, has_player)
        return f'<meta name="cageik-record" content="{mark}">'.encode() in file.read(HEAD_BYTES)


def make_record_mark(digest: str, has_pictures: bool, has_player: bool) -> str:
    """Return the mark in the head of the page of a report with this digest: what it shows."""
    parts = [" pictures"] * has_pictures + [" player"] * has_player
    return digest + "".join(parts)
