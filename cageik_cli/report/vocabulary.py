"""What views call things: of an extracted result an error, of an edited one how far it moved."""

from collections.abc import Mapping
from dataclasses import dataclass, field

SETTING_MEANINGS = {
    "accuracy": "how near harmonic weights are to exact ones",
    "align": "each frame is moved rigidly onto the rest pose before it is solved",
    "allow_conflicts": "whether the mean was taken of different targets of one point",
    "alpha": "weight of the cage's Laplacian",
    "beta": "weight of the vertices",
    "coordinates": "what the weights are",
    "hard": "whether all handles were met exactly",
    "outside": "what is done with vertices outside the cage",
    "pose_alpha": "weight of the cage's Laplacian in the edit",
    "pose_beta": "weight of the handles",
    "rest_frame": "the frame that is the rest pose; none if it is a file of its own",
    "rigidity": "rounds in which parts of the cage turned with the edit",
    "snap": "whether handles with a position were put on the surface near it",
    "vertex_weights": "whether vertices were weighed one by one",
}

_SIZE_MEANING = (
    "Size",
    "",
    "A cage has three numbers a vertex in each frame; the weights, one for each vertex of the "
    "model and of the cage, are kept once.",
)

_VERDICT_MEANING = (
    "Verdict",
    "",
    "A figure is compared with its limit as it is printed here. Over a limit, the command ends "
    "with exit code 3.",
)

MEANINGS = (
    (
        "Error of a frame, RMS",
        "rms = √( mean |v̂ − v|² )",
        "The mean is over the vertices, less those of weight 0. In units of the file, or as "
        "percent of the diagonal: 100 rms / D.",
    ),
    (
        "Error of the clip",
        "√( mean rms² )",
        "The mean is over the frames that were not skipped. The headline. From 0.3 to 1 % is usual "
        "for a body in a cage of about 100 vertices; a finer cage lowers it.",
    ),
    (
        "RMS of a vertex",
        "√( mean |v̂ − v|² )",
        "The mean is over the frames. The histogram counts vertices by it, and the model is "
        "coloured by it: where it is high, the cage is too coarse, or the model moves in ways a "
        "cage cannot follow.",
    ),
    (
        "Max deviation",
        "max |v̂ − v|",
        "Over the vertices of a frame, or over all frames; with the vertex where it is.",
    ),
    (
        "Volume change",
        "100 (V̂ − V) / V",
        "What the reconstruction gains or loses against its own frame, in percent; signed. Of the "
        "clip, the change of largest size. Not defined for open models, or where vertices are "
        "missing data.",
    ),
    (
        "Drift from rest",
        "100 (V − V_rest) / V_rest",
        "What the input itself gains or loses against the rest pose, in percent; no fault of the "
        "cage.",
    ),
    (
        "E_RMS",
        "2000/√3 · rms / D = 1154.70 rms / D",
        "The error of the clip as Kavan, Sloan and O'Sullivan (2010) state it.",
    ),
    (
        "KG error",
        "100 |V − V̂| / |V − E(V)|",
        "The error against the spread of each frame about its centroid E(V), V being all "
        "coordinates of the clip (Karni and Gotsman 2004), in percent.",
    ),
    _SIZE_MEANING,
    _VERDICT_MEANING,
    (
        "Worst, median and best frame",
        "",
        "By the rms of the frame. Vertices are coloured by |v̂ − v|, all poses on one scale.",
    ),
)
"""Term, formula, and what it says."""

EDIT_MEANINGS = (
    (
        "Distance moved of a frame, RMS",
        "rms = √( mean |v̂ − v|² )",
        "How far the edit moved the frame; no measure of how well the cage follows the animation. "
        "The mean is over the vertices. In units of the file, or as percent of the diagonal: "
        "100 rms / D.",
    ),
    (
        "Distance moved of the clip",
        "√( mean rms² )",
        "The mean is over the frames that were not skipped, also those that the edit leaves as "
        "they were. The headline.",
    ),
    (
        "RMS of a vertex",
        "√( mean |v̂ − v|² )",
        "The mean is over the frames. The histogram counts vertices by it, and the model is "
        "coloured by it: where it is high, the edit moved the model most.",
    ),
    (
        "Max distance",
        "max |v̂ − v|",
        "Over the vertices of a frame, or over all frames; with the vertex where it is.",
    ),
    (
        "Volume change",
        "100 (V̂ − V) / V",
        "What the edit adds to the volume of its frame, in percent; signed. Of the clip, the "
        "change of largest size. Not defined for open models.",
    ),
    (
        "Drift before the edit",
        "100 (V − V_rest) / V_rest",
        "How far the volume of the mesh before the edit is from that of the rest pose, in percent.",
    ),
    _SIZE_MEANING,
    _VERDICT_MEANING,
    (
        "Most moved, median and least moved frame",
        "",
        "By the rms of the frame. Vertices are coloured by |v̂ − v|, all poses on one scale.",
    ),
)
"""The same of an edited result."""


@dataclass(frozen=True, slots=True)
class Vocabulary:
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
        Titles of columns over frames that are not the usual ones, by the field of `FrameRecord`.
    title : str
        What stands before the figure in a page's title.
    remark : str
        A sentence after the headline.
    has_published_metrics : bool
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
    has_published_metrics: bool = True

    def describe_metric(self, name: str) -> str:
        """What a limit is on, in full."""
        return {
            "rms": f"{self.measure} of the clip",
            "frame_rms": f"{self.measure} of the {self.worst} frame",
            "max_deviation": self.largest,
            "volume_change": "volume change",
        }[name]


EXTRACTION_VOCABULARY = Vocabulary(
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

EDIT_VOCABULARY = Vocabulary(
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
    has_published_metrics=False,
)


def choose_vocabulary(*edited_from: str | None) -> Vocabulary:
    """Choose the words for results: those of edits when every one was edited."""
    return EDIT_VOCABULARY if edited_from and None not in edited_from else EXTRACTION_VOCABULARY


def display_name(name: str, edited_from: str | None) -> str:
    """A result's name among others', which tells of an edited one what its figures are."""
    return name if edited_from is None else f"{name} (edited: how far it moved from {edited_from})"
