"""Run the blocks of a page in its order, in one folder."""

import contextlib
import doctest
import importlib
import io
import re
from dataclasses import dataclass

from tests.docs.console import find_mismatch, read_steps, run_step
from tests.docs.pages import read_blocks
from tests.docs.scenes import SCENES, link_fixtures

_IMPORT = re.compile(r"^(?:>>> )?from (cageik_cli[\w.]*) import (.+)$", re.MULTILINE)


@dataclass(frozen=True)
class Skipped:
    """A block that was left out, and why."""

    block: object
    reason: str


@dataclass(frozen=True)
class Fault:
    """A block that gives something else than its page shows.

    Attributes
    ----------
    kind : str
        `output`, `exit code` or `python`.
    place, text : str
        The block and, of a console block, the command; what is wrong.
    """

    kind: str
    place: str
    text: str

    def __str__(self):
        return f"{self.place}: {self.text}"


def run_page(path, folder, cache, on_step=None):
    """Run all blocks of a page that can run; the current folder must be `folder`.

    Parameters
    ----------
    on_step : callable, optional
        Called with the block, the number of the step, and its exit code and lines.

    Returns
    -------
    faults : list of Fault
    skipped : list of Skipped
    """
    link_fixtures(folder)
    faults, skipped, names = [], [], {"__name__": "__page__"}
    for block in read_blocks(path):
        if "setup" in block.marks:
            SCENES[block.marks["setup"]](folder)
        if "save" in block.marks:
            target = folder / block.marks["save"]
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_text(block.text, encoding="utf-8")
        reason = find_reason_to_skip(block)
        if reason:
            skipped.append(Skipped(block, reason))
        elif block.language == "console":
            faults += _run_console(block, folder, cache, on_step)
        elif block.language == "python":
            faults += run_python(block, names)
    return faults, skipped


def find_reason_to_skip(block):
    """Return why a block does not run here, or None.

    A block marked `skip` waits for names of the package: it runs as soon as all can be imported.
    """
    if "not run" in block.marks:
        return block.marks["not run"]
    if "skip" in block.marks:
        missing = find_missing_names(block.text)
        return f"cageik_cli has no {', '.join(missing)}" if missing else None
    return None


def find_missing_names(code):
    """Return the names of the package that the code imports and that are not there."""
    missing = []
    for module, names in _IMPORT.findall(code):
        for name in names.split(","):
            try:
                getattr(importlib.import_module(module), name.strip())
            except (ImportError, AttributeError):
                missing.append(name.strip())
    return missing


def run_python(block, names):
    """Run a block of Python with the names of the page; return the faults."""
    if ">>>" in block.text:
        parser = doctest.DocTestParser()
        test = parser.get_doctest(block.text, names, str(block), block.page, block.line)
        said = io.StringIO()
        runner = doctest.DocTestRunner(verbose=False, optionflags=doctest.ELLIPSIS)
        result = runner.run(test, out=said.write, clear_globs=False)
        names |= test.globs
        return [Fault("python", str(block), said.getvalue())] if result.failed else []
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            exec(compile(block.text, str(block), "exec"), names)
    except Exception as error:  # whatever it is, it is told with the place
        return [Fault("python", str(block), f"{type(error).__name__}: {error}")]
    return []


def _run_console(block, folder, cache, on_step):
    faults = []
    steps = read_steps(block.text)
    codes = [int(word) for word in block.marks.get("exit", "").split()] or [0] * len(steps)
    for number, (step, expected) in enumerate(zip(steps, codes, strict=True)):
        code, found = run_step(step, folder, cache)
        if on_step is not None:
            on_step(block, number, code, found)
        place = f"{block}: {' '.join(step.typed)}"
        if code != expected:
            text = f"exit code {code}, expected {expected}"
            faults.append(Fault("exit code", place, text))
        line = find_mismatch(step.shown, found)
        if line is not None:
            text = "\n    ".join([f"not as shown: {line}", *found])
            faults.append(Fault("output", place, text))
    return faults
