"""Small runs of every command, and the files that they read."""

import shutil
from dataclasses import dataclass
from pathlib import Path

from cageik_cli.run.executor import MAX_BLOCK_FRAMES

FIXTURES = Path(__file__).resolve().parents[2] / "data_fixtures" / "posed" / "surface"
HANDLES = '{"handles": [{"name": "a", "vertex": 0, "offset": [0.01, 0, 0]}]}'
FRAMES = MAX_BLOCK_FRAMES + 1
"""Frames of the clip: two blocks, each of which a run appends to its checkpoint."""


@dataclass(frozen=True)
class Command:
    """A run: its words and what it writes.

    Attributes
    ----------
    outputs : tuple of str
        Files, and folders that are replaced as a whole.
    other : tuple of (str, str)
        Words and what takes their place in a run that writes other outputs of the same names.
    more : tuple of str
        Words that are added to it.
    is_folder_of_many : bool
        Whether the output is a folder of results that are written one by one, as by `batch`.
    resumes : bool
        Whether an interrupted run is continued with `--resume`.
    may_abort : bool
        Whether the library that writes the output ends the process when a write fails.
    repeats_calls : bool
        Whether calls that a signal interrupts are repeated; a few libraries do not.
    fills_cache : bool
        Whether it begins with an empty cache of weights, which takes longer.
    main : str
        MODULE:FUNCTION that runs it.
    """

    name: str
    words: tuple[str, ...]
    outputs: tuple[str, ...] = ()
    other: tuple[tuple[str, str], ...] = (("r.h5", "s.h5"),)
    more: tuple[str, ...] = ()
    is_folder_of_many: bool = False
    resumes: bool = False
    may_abort: bool = False
    repeats_calls: bool = True
    fills_cache: bool = False
    main: str = "cageik_cli.__main__:main"

    @property
    def other_words(self) -> tuple[str, ...]:
        """The words of a run that writes other outputs of the same names."""
        exchange = dict(self.other)
        return tuple(exchange.get(word, word) for word in self.words) + self.more


EXTRACT = ("extract", "frames", "--cage", "cage.obj", "--jobs", "1")
BIND = ("bind", "--cage", "cage.obj", "--rest", "rest.obj")
STIFF, MEAN_VALUE = ("--alpha", "0.1"), ("--coordinates", "mean-value")
COMMANDS = (
    Command("extract", (*EXTRACT, "-o", "out.h5"), ("out.h5",), more=STIFF,
            resumes=True),
    Command("extract --fit", (*EXTRACT, "--fit", "-o", "out.h5"), ("out.h5",), more=STIFF,
            resumes=True),
    Command("bind", (*BIND, "-o", "out.h5"), ("out.h5",), more=MEAN_VALUE,
            fills_cache=True),
    Command("cage", ("cage", "--repair", "broken.obj", "--rest", "rest.obj", "-o", "out.obj",
                     "--jobs", "1"), ("out.obj",), (("broken.obj", "torn.obj"),)),
    Command("check", ("check", "--cage", "cage.obj", "frames", "--json", "out.json"),
            ("out.json",), (("cage.obj", "wide.obj"),)),
    Command("info", ("info", "frames")),
    Command("info result", ("info", "r.h5")),
    Command("report", ("report", "r.h5")),
    Command("report files", ("report", "r.h5", "--json", "out.json", "--csv", "out.csv", "--junit",
                             "out.xml", "--markdown", "out.md"),
            ("out.json", "out.csv", "out.xml", "out.md")),
    Command("report html", ("report", "r.h5", "--html", "out.html"), ("out.html",)),
    Command("report plot", ("report", "r.h5", "--plot", "out.png"), ("out.png",)),
    Command("report stdout", ("report", "r.h5", "--json", "-")),
    Command("export obj", ("export", "r.h5", "out/c_####.obj"), ("out",)),
    Command("export ply", ("export", "r.h5", "out/c_####.ply"), ("out",)),
    Command("export blender", ("export", "r.h5", "out", "--blender"), ("out",)),
    Command("export npz", ("export", "r.h5", "out.npz"), ("out.npz",)),
    Command("export mdd", ("export", "r.h5", "out.mdd"), ("out.mdd",)),
    Command("export glb", ("export", "r.h5", "out.glb"), ("out.glb",)),
    Command("export usdc", ("export", "r.h5", "out.usdc"), ("out.usdc",),
            repeats_calls=False),
    Command("export abc", ("export", "r.h5", "out.abc"), ("out.abc",), may_abort=True,
            repeats_calls=False),
    Command("deform", ("deform", "r.h5", "-o", "out.pc2"), ("out.pc2",)),
    Command("deform vat", ("deform", "r.h5", "-o", "out.vat"), ("out.vat",)),
    Command("pose", ("pose", "rest.obj", "handles.json", "--cage", "cage.obj", "-o", "out.obj",
                     "--cage-out", "cages.obj"), ("out.obj", "cages.obj"),
            (("cage.obj", "wide.obj"),)),
    Command("pose result", ("pose", "r.h5", "handles.json", "-o", "out.h5"), ("out.h5",)),
    Command("batch", ("batch", "frames", "--cage", "cage.obj", "-o", "out", "--jobs", "1",
                      "--no-pages"),
            ("out",), more=STIFF, is_folder_of_many=True,
            resumes=True),
)  # fmt: skip


def make_inputs(folder: Path) -> None:
    """Copy the files that commands read, but the results, which `EXTRACT` writes."""
    (folder / "frames").mkdir(parents=True)
    frames = sorted((FIXTURES / "frames").iterdir())
    for k in range(FRAMES):
        shutil.copy(frames[k % len(frames)], folder / "frames" / f"frame_{k + 1}.obj")
    shutil.copy(frames[0], folder / "rest.obj")
    shutil.copy(FIXTURES / "cage.obj", folder)
    cage = (folder / "cage.obj").read_text()
    (folder / "wide.obj").write_text(_widen(cage))
    (folder / "broken.obj").write_text(cage[: cage.rstrip().rindex("\n") + 1])  # a face less
    (folder / "torn.obj").write_text(_widen((folder / "broken.obj").read_text()))
    (folder / "handles.json").write_text(HANDLES)


def _widen(text: str) -> str:
    """Return the text of a cage with all coordinates enlarged by a few percent."""
    lines = [line.split() for line in text.splitlines()]
    return "".join(
        " ".join(["v", *(str(1.05 * float(x) - 0.04) for x in words[1:4])] if words[:1] == ["v"]
                 else words) + "\n"
        for words in lines
    )  # fmt: skip


def read_files(folder: Path) -> dict[str, bytes]:
    """Return the bytes of all files in a folder, by their names."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }
