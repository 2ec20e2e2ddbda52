"""What rendering a page imports, which takes as long as rendering one; see `preload.py`."""

from contextlib import suppress

with suppress(Exception):
    from cageik_cli.report.html import page  # noqa: F401
