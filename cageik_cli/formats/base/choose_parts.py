"""Which meshes of a file are read: those below a path, but for patterns and what is hidden."""

from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase
from types import MappingProxyType

from cageik_cli.util.errors import FormatError, SettingError, join_truncated

_NOTHING: Mapping[str, str] = MappingProxyType({})


def choose_parts(
    paths: Sequence[str],
    member: str | None,
    exclude: Sequence[str],
    hidden: Mapping[str, str] = _NOTHING,
) -> tuple[list[str], list[str]]:
    """Return the paths of the meshes that are read, and notes on those that are left out.

    Parameters
    ----------
    member : str, optional
        A mesh, or what they are below; all that are seen if absent.
    exclude : sequence of str
        Patterns of paths and of names in them: what is at or below one is left out.
    hidden : mapping
        Why some meshes are not seen, by path: "invisible". They are read if they are all there
        are, or named by `member`.

    Raises
    ------
    InputError
        Listing the meshes to choose from.
    """
    if not paths:
        raise FormatError("holds no mesh; export an animated mesh")
    chosen = [path for path in paths if member is None or _is_below(path, member)]
    if not chosen:
        raise SettingError(f"holds no mesh `{member}`; choose one of {join_truncated(paths)}")
    reasons: dict[str, str] = {}
    for pattern in exclude:
        matching = [path for path in chosen if _matches(path, pattern)]
        if not matching:
            raise SettingError(
                f"`exclude={pattern}` matches none of its meshes: {join_truncated(chosen)}"
            )
        reasons |= dict.fromkeys(matching, f"`exclude={pattern}`")
    if len(reasons) == len(chosen):
        raise SettingError("`exclude=` leaves none of its meshes; give fewer patterns")
    seen = [path for path in chosen if path not in reasons]
    shown = [path for path in seen if path not in hidden or path == member]
    unseen = {path: hidden[path] for path in seen if path not in shown}
    if shown:
        return shown, _describe("left out", reasons | unseen)
    return seen, [*_describe("left out", reasons), *_describe("no other mesh than", unseen)]


def _describe(what: str, reasons: Mapping[str, str]) -> list[str]:
    """Return a sentence for each reason, with the paths that have it."""
    paths: dict[str, list[str]] = {}
    for path, reason in reasons.items():
        paths.setdefault(reason, []).append(path)
    return [f"{what} {join_truncated(each)} ({reason})" for reason, each in paths.items()]


def _is_below(path: str, top: str) -> bool:
    return path == top or path.startswith(f"{top.rstrip('/')}/")


def _matches(path: str, pattern: str) -> bool:
    """Return whether a pattern is that of a path, of one above it, or of a name in it."""
    names = path.strip("/").split("/")
    root = "/" if path.startswith("/") else ""
    above = [root + "/".join(names[: k + 1]) for k in range(len(names))]
    return any(fnmatchcase(each, pattern) for each in (*above, *names))
