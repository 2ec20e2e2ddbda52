"""Rewrite the output that the pages show: `python -m tests.docs.refresh [PAGE ...]`.

Every console block runs, and the lines below its commands become what the commands say now. A
line that differs only in masked parts stays as it is. What a line `...` stood for stays left
out: shown and found lines are paired by likeness, and new lines where a `...` was join it.
"""

import argparse
import contextlib
import difflib
import sys
import tempfile
from pathlib import Path

from tests.docs.console import ELLIPSIS, Step, mask, mask_all, read_steps
from tests.docs.pages import find_pages, name_page
from tests.docs.session import run_page

_NEW, _LOST, _LEFT_OUT = 0.4, 0.8, 0.05


def merge_output(shown, found):
    """Return the found lines, left out where `...` left them out before.

    Returns
    -------
    list of str
        The lines to show.
    """
    shown = list(shown)
    found = [line for line in found if mask_all([line])]
    if not shown:
        return found
    choices = _align(shown, found)
    merged = []
    for kind, old, new in choices:
        if kind == "pair":
            merged.append(old if mask(old) == mask(new) else new)
        elif kind == "new":
            merged.append(new)
        elif kind == "left out" and merged[-1:] != [_ellipsis_like(shown)]:
            merged.append(_ellipsis_like(shown))
    return merged


def _ellipsis_like(shown):
    return next((line for line in shown if line.strip() == ELLIPSIS), ELLIPSIS)


def _align(shown, found):
    """Pair shown and found lines at least cost; `...` takes any number of lines."""
    rows, columns = len(shown), len(found)
    cost = [[0.0] * (columns + 1) for _ in range(rows + 1)]
    step = [[None] * (columns + 1) for _ in range(rows + 1)]
    for i in range(rows + 1):
        for j in range(columns + 1):
            options = []
            wild = i > 0 and shown[i - 1].strip() == ELLIPSIS
            if i == j == 0:
                continue
            if i and wild:
                options.append((cost[i - 1][j], "pass"))
            elif i:
                options.append((cost[i - 1][j] + _LOST, "lost"))
            if j and wild:
                options.append((cost[i][j - 1] + _LEFT_OUT, "left out"))
            elif j:
                options.append((cost[i][j - 1] + _NEW, "new"))
            if i and j and not wild:
                options.append(
                    (cost[i - 1][j - 1] + _unlikeness(shown[i - 1], found[j - 1]), "pair")
                )
            cost[i][j], step[i][j] = min(options, key=lambda option: option[0])
    choices, i, j = [], rows, columns
    while i or j:
        kind = step[i][j]
        old, new = shown[i - 1] if i else None, found[j - 1] if j else None
        choices.append((kind, old, new))
        i -= kind in ("pair", "lost", "pass")
        j -= kind in ("pair", "new", "left out")
    return choices[::-1]


def _unlikeness(old, new):
    if mask(old) == mask(new):
        return 0.0
    ratio = difflib.SequenceMatcher(None, old, new, autojunk=False).ratio()
    same_label = old[:16].strip() and old[:16] == new[:16]
    return (1 - ratio) * (0.5 if same_label else 1.0) + 0.02


def rewrite_page(path, folder, cache):
    """Run a page, and write what its commands say now.

    A page on which a command ends with an unexpected exit code stays as it is: its output would be
    an error message.

    Returns
    -------
    list of Fault
        Those that are not mended by new output.
    """
    outputs = {}

    def keep(block, number, _code, found):
        outputs[block.line, number] = found

    with contextlib.chdir(folder):
        faults, _ = run_page(path, folder, cache, keep)
    faults = [fault for fault in faults if fault.kind != "output"]
    if any(fault.kind == "exit code" for fault in faults):
        return faults
    lines = path.read_text(encoding="utf-8").split("\n")
    for line in sorted({line for line, _ in outputs}, reverse=True):
        end = next(k for k in range(line, len(lines)) if lines[k] == "```")
        steps = read_steps("\n".join(lines[line:end]) + "\n")
        lines[line:end] = _write_steps(
            Step(step.typed, tuple(merge_output(step.shown, outputs[line, number])))
            for number, step in enumerate(steps)
        )
    path.write_text("\n".join(lines), encoding="utf-8")
    return faults


def _write_steps(steps):
    lines = []
    for step in steps:
        if lines:
            lines.append("")
        lines += [*step.typed, *step.shown]
    return lines


def main(arguments):
    """Refresh the pages named, or all; return 1 when a block fails for another reason."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.docs.refresh", description="Rewrite the output that pages show."
    )
    parser.add_argument("pages", nargs="*", type=Path, metavar="PAGE", help="all by default")
    pages = [page.resolve() for page in parser.parse_args(arguments).pages] or find_pages()
    failed = False
    with tempfile.TemporaryDirectory(prefix="cageik-docs-") as temporary:
        for number, path in enumerate(pages):
            folder = Path(temporary) / str(number)
            folder.mkdir()
            before = path.read_text(encoding="utf-8")
            faults = rewrite_page(path, folder, Path(temporary) / "cache")
            changed = path.read_text(encoding="utf-8") != before
            print(f"{name_page(path)}: {'rewritten' if changed else 'unchanged'}")
            for fault in faults:
                print(f"  {fault}")
            failed = failed or bool(faults)
    return int(failed)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
