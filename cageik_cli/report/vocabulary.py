"""What views call things: a result of `extract` has errors, one of `pose` was moved by an edit."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from cageik_cli.cages.settings import BuildSettings
from cageik_cli.captured.settings import CaptureSettings
from cageik_cli.fit.settings import FitSettings
from cageik_cli.formats.settings import ClipSettings
from cageik_cli.method.pose.settings import PosingSettings
from cageik_cli.method.solve.settings import SolveSettings
from cageik_cli.method.weights.settings import BindSettings
from cageik_cli.util.settings import list_meanings

QUALITY_WORDS = {"good": "good", "fair": "fair", "poor": "poor"}
"""How people read each quality of a result; records for programs hold the key."""

CAGE_VERDICT_WORDS = {"fit": "fit", "usable": "usable", "unfit": "unfit"}
"""How people read each verdict on a cage; records for programs hold the key."""

RECORDED_SETTINGS = (
    BindSettings,
    BuildSettings,
    CaptureSettings,
    ClipSettings,
    FitSettings,
    PosingSettings,
    SolveSettings,
)
"""The records of the settings that a result records."""

SETTING_MEANINGS = {
    **list_meanings(*RECORDED_SETTINGS),
    "rest_frame": "frame used as the rest pose; none if it is a file, or a frame that is not taken",
    "vertex_weights": "whether vertices have weights of their own; area: by their area",
    "given_in": "unit and up axis in which the rest pose and the cage were given",
}
"""What the settings that a result records are, by name."""

SHARED_MEANINGS = (
    (
        "Size",
        "",
        "A cage has three floats per vertex and frame. The weights are stored once: one float for "
        "each pair of a model vertex and a cage vertex, or those of a fit of low rank or few "
        "influences.",
    ),
    (
        "Verdict",
        "",
        "Values are compared with their limits as printed here; up to 0.00005 %, which may be "
        "rounding, they keep any limit. If a limit is exceeded, the command ends with exit code 3.",
    ),
)
"""Term, formula and explanation of what is the same for all results."""

MEANINGS = (
    (
        "RMS error of a frame",
        "rms = √( mean |v̂ − v|² )",
        "The mean is over the vertices, without those of weight 0. In file units, or in percent of "
        "the diagonal: 100 rms / D.",
    ),
    (
        "RMS error of the clip",
        "√( mean rms² )",
        "The mean is over the frames that were not skipped. This is the main number of the report. "
        "A body in a cage of about 100 vertices usually has 0.3 to 1 %; a finer cage has less.",
    ),
    (
        "RMS error of a vertex",
        "√( mean |v̂ − v|² )",
        "The mean is over the frames. The histogram counts vertices by this error, and the model "
        "is coloured by it. Where it is high, the cage is too coarse, or the model moves in a way "
        "that a cage cannot follow.",
    ),
    (
        "Error by area",
        "√( Σ a |v̂ − v|² / Σ a )",
        "The same as the error of the clip, but each vertex counts by its area a in the rest pose. "
        "It does not depend on how densely parts are cut. Where it is higher than the error of the "
        "clip, dense parts such as a head hide the error of the others.",
    ),
    (
        "Error by radius",
        "100 rms / R",
        "The error of the clip in percent of the radius R of the smallest sphere around the rest "
        "pose. The diagonal D of the box depends on how the model stands to the axes; R does not.",
    ),
    (
        "Max deviation",
        "max |v̂ − v|",
        "The largest distance over the vertices of a frame, or over all frames, with its vertex.",
    ),
    (
        "Best possible error",
        "√( Σ σ² / s F ), σ beyond the n largest",
        "No weights that reproduce the rest pose, and cages of n vertices, can be below it. It is "
        "not stated for frames so few, or so often repeated, that they have n dimensions. The "
        "singular values σ are those of the aligned displacements of s vertices in all F frames. "
        "Fitted weights come near to it.",
    ),
    (
        "Error of frames kept aside",
        "",
        "Of weights that are fitted to the clip: the error of frames that a second fit did not "
        "see. Each clip is cut into ten blocks, and every second one is kept aside; or the last "
        "third is. The blocks lie between fitted frames, and the last third behind them: motion "
        "that is unlike them may have several times the error.",
    ),
    (
        "Volume change",
        "100 (V̂ − V) / V",
        "Volume that the reconstruction gains (+) or loses (−) against its own input frame, in "
        "percent. For the clip, the largest change. Not defined for open models, for sheets "
        "without volume, and when vertices are missing data.",
    ),
    (
        "Drift from rest",
        "100 (V − V_rest) / V_rest",
        "Volume that the input itself gains or loses against the rest pose, in percent. The cage "
        "has no influence on it.",
    ),
    (
        "E_RMS",
        "2000/√3 · rms / D = 1154.70 rms / D",
        "The error of the clip as Kavan, Sloan and O'Sullivan (2010) define it.",
    ),
    (
        "KG error",
        "100 |V − V̂| / |V − E(V)|",
        "The error in percent of the spread of each frame about its centroid E(V), as Karni and "
        "Gotsman (2004) define it. V holds all coordinates of the clip.",
    ),
    *SHARED_MEANINGS,
    (
        "Worst, median and best frame",
        "",
        "By the RMS error of the frame; the rest pose itself is not the best frame. Vertices are "
        "coloured by |v̂ − v|; all poses share one colour scale.",
    ),
    (
        "Worst region",
        "",
        "Connected vertices whose largest deviation, over all frames, is more than half the "
        "largest of the clip. Regions are given if that is more than 10 rms or 3 % of D. The cause "
        "is a guess, from the cage and the weights around the region.",
    ),
)
"""Term, formula and explanation, for results of `extract`."""

EDIT_MEANINGS = (
    (
        "RMS distance moved of a frame",
        "rms = √( mean |v̂ − v|² )",
        "Distance by which the edit moved the frame. It does not measure how well the cage follows "
        "the animation. The mean is over the vertices. In file units, or in percent of the "
        "diagonal: 100 rms / D.",
    ),
    (
        "RMS distance moved of the clip",
        "√( mean rms² )",
        "The mean is over the frames that were not skipped, including those that the edit leaves "
        "unchanged. This is the main number of the report.",
    ),
    (
        "RMS distance moved of a vertex",
        "√( mean |v̂ − v|² )",
        "The mean is over the frames. The histogram counts vertices by this distance, and the "
        "model is coloured by it. Where it is high, the edit moved the model most.",
    ),
    (
        "Distance moved by area",
        "√( Σ a |v̂ − v|² / Σ a )",
        "The same, but each vertex counts by its area a in the rest pose.",
    ),
    (
        "Max distance",
        "max |v̂ − v|",
        "The largest distance over the vertices of a frame, or over all frames, with its vertex.",
    ),
    (
        "Volume change",
        "100 (V̂ − V) / V",
        "Volume that the edit adds to its frame (+) or takes away (−), in percent. For the clip, "
        "the largest change. Not defined for open models.",
    ),
    (
        "Drift before the edit",
        "100 (V − V_rest) / V_rest",
        "Difference in volume between the mesh before the edit and the rest pose, in percent.",
    ),
    *SHARED_MEANINGS,
    (
        "Most moved, median and least moved frame",
        "",
        "By the RMS distance moved of the frame. Vertices are coloured by |v̂ − v|; all poses "
        "share "
        "one colour scale.",
    ),
)
"""Term, formula and explanation, for edits by `pose`."""


@dataclass(frozen=True, slots=True)
class Vocabulary:
    """The words in which views of a result differ.

    Attributes
    ----------
    command : str
        The command that wrote the result.
    done : str
        What was done to the clip, as a participle.
    measure, distance, largest : str
        Names of the rms, of |v̂ − v| of one vertex, and of the largest |v̂ − v|.
    worst, best : str
        Adjectives for frames and vertices with the largest and with the smallest rms.
    worst_frame : str
        Short name of the worst frame.
    original, reconstruction : str
        Names of the meshes of v and of v̂.
    drift : str
        Name of the change of volume of the original frames.
    system, condition : str
        Name of the system whose condition number is known, and what the number means.
    limits : mapping of str to str
        Short names of the metrics that have limits.
    meanings : tuple
        Terms, formulas and explanations.
    columns : mapping of str to str
        Titles of the table of frames that replace the default ones, by field of `FrameRecord`.
    title : str
        Text in front of the number in a page's title.
    remark : str
        A sentence after the main number.
    has_published_metrics : bool
        Whether the rms is an error, and can be given in the metrics of publications.
    """

    command: str
    done: str
    measure: str
    distance: str
    largest: str
    worst: str
    best: str
    worst_frame: str
    original: str
    reconstruction: str
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
        """Return the full name of a metric that has a limit."""
        return {
            "rms": f"RMS {self.measure} of the clip",
            "frame_rms": f"RMS {self.measure} of the {self.worst} frame",
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
    original="input",
    reconstruction="reconstruction",
    drift="drift of the input from rest",
    system="system",
    condition="How much the solve can magnify errors of its input.",
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
    original="mesh before the edit",
    reconstruction="mesh after the edit",
    drift="drift from rest before the edit",
    system="extraction",
    condition="Of the extraction, before the edit: how much its solve can magnify changes of its "
    "input.",
    limits={
        "rms": "rms moved",
        "frame_rms": "frame rms moved",
        "max_deviation": "max distance",
        "volume_change": "volume change",
    },
    meanings=EDIT_MEANINGS,
    columns={
        "max_deviation_percent": "Max distance, %",
        "max_deviation": "Max distance, file units",
        "volume": "Volume before",
        "volume_reconstructed": "Volume after",
        "volume_drift": "Drift before, %",
    },
    title="moved ",
    remark=" It does not measure how well the cage follows the animation.",
    has_published_metrics=False,
)


VOCABULARIES = {"cageik.result": EXTRACTION_VOCABULARY, "cageik.edit": EDIT_VOCABULARY}
"""The words for each kind of file, by its format."""
