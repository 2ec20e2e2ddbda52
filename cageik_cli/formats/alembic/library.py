"""What reading and writing Alembic share: the library, and where a frame rate is stated."""

from cageik_cli.util.errors import require_optional

FPS_KEY = "cageik_fps"
"""Where a mesh states the frame rate. The archive could only state it together with the time."""


def require_alembic(purpose: str) -> None:
    """Raise MissingLibraryError without alembic3d, which is needed for a purpose."""
    with require_optional("alembic3d", purpose):
        import alembic3d  # noqa: F401
