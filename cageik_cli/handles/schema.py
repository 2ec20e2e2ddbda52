"""The JSON schema of the handles file."""

from importlib.resources import files


def schema_text() -> str:
    """The schema, draft 2020-12, as JSON."""
    return files("cageik_cli.handles").joinpath("schema.json").read_text(encoding="utf-8")
