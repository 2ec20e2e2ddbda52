"""What the jobs of a batch import, for the process from which theirs are forked.

What cannot be imported here is imported again by the job, which reports why it cannot.
"""

from contextlib import suppress

with suppress(Exception):
    from cageik_cli.batch import jobs  # noqa: F401
