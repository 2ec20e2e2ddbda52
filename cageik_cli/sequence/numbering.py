"""Numbered files: which belong together, and which number is missing."""

import re
from collections import Counter
from itertools import pairwise
from pathlib import Path

from cageik_cli.sequence.files import stem_of
from cageik_cli.util.errors import InputError

_NUMBERED = re.compile(r"(.*?)(\d+)(\D*)")


def numbered_alike(paths: list[Path]) -> dict[str, list[Path]]:
    """Numbered files of one kind, by what is around the last number in their names; in order."""
    found: dict[tuple[str, str], list[Path]] = {}
    for path in paths:
        match = _NUMBERED.fullmatch(stem_of(path))
        if match:
            kind = path.name[len(stem_of(path)) :].lower()
            found.setdefault((f"{match[1]}#{match[3]}", kind), []).append(path)
    stems = Counter(stem for stem, _ in found)
    return {
        stem + (kind if stems[stem] > 1 else ""): files for (stem, kind), files in found.items()
    }


def refuse_gaps(paths: list[Path]) -> None:
    """Refuse files, in order, among whose numbers one is missing.

    Files that are not numbered alike, or lie in several folders, are taken as they are.

    Raises
    ------
    InputError
        Naming the first file that is missing.
    """
    found = [_NUMBERED.fullmatch(stem_of(path)) for path in paths]
    matches = [match for match in found if match]
    around = {(path.parent, m[1], m[3]) for path, m in zip(paths, matches, strict=False)}
    if len(matches) < len(paths) or len(around) != 1:
        return
    numbers = [int(match[2]) for match in matches]
    steps = Counter(b - a for a, b in pairwise(numbers))
    usual = min(steps, key=lambda step: (-steps[step], step), default=0)
    gaps = [k for k, (a, b) in enumerate(pairwise(numbers)) if b - a > usual > 0]
    if gaps:
        first = matches[gaps[0]]
        number = str(int(first[2]) + usual).zfill(len(first[2]))
        lost = f"{first[1]}{number}{first[3]}{paths[0].name[len(stem_of(paths[0])) :]}"
        raise InputError(
            f"{paths[gaps[0]].parent / lost}: missing between {paths[gaps[0]].name} and "
            f"{paths[gaps[0] + 1].name}, where frames are numbered in steps of {usual} "
            f"({len(gaps)} such gaps); restore it, or take the clip as it is with --allow-gaps"
        )
