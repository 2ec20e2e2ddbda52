"""What views call things: of an extracted result an error, of an edited one how far it moved."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from cageik_cli.report.explanations import EDIT_MEANINGS, MEANINGS


@dataclass(frozen=True, slots=True)
class Wording:
    """The words in which views of a result differ.

    Attributes
    ----------
    command : str
        What wrote the result.
    done : str
        What was done to the clip.
    measure, distance, largest : str
        What an rms is of, what |v̂ − v| is of one vertex, and what the largest one is.
    worst, best : str
        What frames and vertices of the largest and of the smallest rms are.
    worst_frame : str
        What the worst frame is called for short.
    given, rebuilt : str
        What v and v̂ are vertices of.
    drift : str
        The change of volume of the given frames.
    system, condition : str
        The system whose condition number is known, and what that tells.
    limits : mapping of str to str
        What limits are on, by metric, in a word or two.
    meanings : tuple
        Terms, formulas, and what they say.
    columns : mapping of str to str
        Titles of columns over frames that are not the usual ones, by the field of `Frame`.
    title : str
        What stands before the figure in a page's title.
    remark : str
        A sentence after the headline.
    has_literature : bool
        Whether the rms is an error as the literature states them.
    """

    command: str
    done: str
    measure: str
    distance: str
    largest: str
    worst: str
    best: str
    worst_frame: str
    given: str
    rebuilt: str
    drift: str
    system: str
    condition: str
    limits: Mapping[str, str]
    meanings: tuple[tuple[str, str, str], ...]
    columns: Mapping[str, str] = field(default_factory=dict)
    title: str = ""
    remark: str = ""
    has_literature: bool = True

    def metric(self, name: str) -> str:
        """What a limit is on, in full."""
        return {
            "rms": f"{self.measure} of the clip",
            "frame_rms": f"{self.measure} of the {self.worst} frame",
            "max_deviation": self.largest,
            "volume_change": "volume change",
        }[name]


EXTRACTED = Wording(
    command="cageik extract",
    done="extracted",
    measure="error",
    distance="deviation",
    largest="max deviation",
    worst="worst",
    best="best",
    worst_frame="worst frame",
    given="input",
    rebuilt="reconstruction",
    drift="the input's own drift from rest",
    system="system",
    condition="How much the system that gives the cages magnifies errors of its input.",
    limits={
        "rms": "rms",
        "frame_rms": "frame rms",
        "max_deviation": "max deviation",
        "volume_change": "volume change",
    },
    meanings=MEANINGS,
)

EDITED = Wording(
    command="cageik pose",
    done="edited",
    measure="distance moved",
    distance="distance moved",
    largest="max distance",
    worst="most moved",
    best="least moved",
    worst_frame="most moved",
    given="mesh before the edit",
    rebuilt="mesh after the edit",
    drift="drift from rest before the edit",
    system="extraction",
    condition="Of the extraction, before the edit: how much the system that gave the cages "
    "magnifies changes of its input.",
    limits={
        "rms": "rms moved",
        "frame_rms": "frame rms moved",
        "max_deviation": "max distance",
        "volume_change": "volume change",
    },
    meanings=EDIT_MEANINGS,
    columns={
        "max_deviation_percent": "Max distance, %",
        "max_deviation": "Max distance, units",
        "volume": "Volume before",
        "volume_reconstructed": "Volume after",
        "volume_drift": "Drift before, %",
    },
    title="moved ",
    remark=" It tells how far the edit moved the mesh, not how well frames were met.",
    has_literature=False,
)


def wording_of(*edited_from: str | None) -> Wording:
    """The words for results, given what each was edited from: `EDITED` when all of them were."""
    return EDITED if edited_from and None not in edited_from else EXTRACTED


def marked(name: str, edited_from: str | None) -> str:
    """A result's name among others', which tells of an edited one what its figures are."""
    return name if edited_from is None else f"{name} (edited: how far it moved from {edited_from})"
