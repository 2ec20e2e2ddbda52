"""Calls of the Python API with arguments that cannot be: each ends in one sentence."""

import inspect
import pydoc
import re
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

import cageik_cli
from cageik_cli.cli import main
from cageik_cli.run.keywords import list_keywords
from cageik_cli.run.report_settings import ReportSettings
from cageik_cli.run.settings import DeformSettings, EditSettings, ExportSettings, PoseSettings
from cageik_cli.util.errors import OutputError, SettingError
from tests.texts import texts

FUNCTIONS = [name for name in cageik_cli.__all__ if inspect.isfunction(getattr(cageik_cli, name))]

SETTING = re.compile(r"--[a-z-]+(?: [\d.]+)?|`[a-z_]+=.*?`")
"""A setting as texts name it: an option, or a keyword of Python."""

WRONG = {
    "nothing": None, "blank": "  ", "empty": "", "list": [], "nested": [[None]], "object": object(),
    "word": "purple", "number": -1.5, "nan": np.nan, "flag": True, "mapping": {"a": 1},
    "array": np.zeros((2, 2)), "function": print,
}  # fmt: skip
"""Values, one of which every argument has to refuse, if it takes the others."""


NUMBERS = {
    "negative": -1, "huge": 10**400, "far below zero": -(10**400), "endless": 10**5000,
    "infinite": np.inf, "minus infinite": -np.inf, "nan of NumPy": np.float32(np.nan),
    "infinite of NumPy": np.float64("inf"), "beyond float": np.longdouble("1e4000"),
    "fraction": Fraction(10**400, 3), "of NumPy": np.int64(2), "in an array": np.array(2.5),
}  # fmt: skip
"""Numbers that Python, NumPy or the limits of float have trouble with."""


@pytest.fixture
def calls(folder, run, binding_of_api, animation, pinned_handles):
    """A call of each function that is right, as positional and keyword arguments by name."""
    assert run("extract", "frames", "--cage", "cage.obj", "-q").code == 0
    mesh, frames = cageik_cli.load_mesh("frames/frame_1.obj"), animation.frames
    camera = cageik_cli.Camera.from_look_at(
        np.array([0.0, 0, 50]),
        mesh.vertices.mean(axis=0),
        up=np.array([0.0, 1, 0]),
        fov_degrees=40,
        width=64,
        height=64,
    )
    return {
        "bind": {"rest": mesh, "cage": cageik_cli.load_mesh("cage.obj")},
        "build_cage": {"mesh": mesh, "vertices": 20},
        "build_report": {"result": "cages.h5"},
        "check_cage": {"cage": cageik_cli.load_mesh("cage.obj")},
        "closest_point": {"mesh": mesh, "position": np.zeros(3)},
        "deform": {"source": "cages.h5", "output": "d.npz"},
        "edit_to_file": {"result": "cages.h5", "handles": "handles.json", "output": "e.h5"},
        "export": {"results": "cages.h5", "output": "x.npz"},
        "extract": {"clip": frames, "binding": binding_of_api},
        "extract_to_file": {"frames": "frames", "cage": "cage.obj", "output": "r.h5"},
        "fit_weights": {"binding": binding_of_api, "clips": [frames]},
        "load_clip": {"frames": "frames"},
        "load_mesh": {"path": "cage.obj"},
        "pick": {"mesh": mesh, "camera": camera, "pixel": np.array([32.0, 32])},
        "point_at_vertex": {"mesh": mesh, "vertex": 0},
        "pose_to_file": {
            "target": "frames/frame_1.obj",
            "handles": "handles.json",
            "output": "p.obj",
            "cage": "cage.obj",
        },
        "read_cages": {"result": cageik_cli.read_result("cages.h5")},
        "read_result": {"path": "cages.h5"},
        "report_to_files": {"results": "cages.h5", "json": "r.json"},
        "show": {"shown": binding_of_api},
    }


@pytest.fixture
def binding_of_api(animation, coarse_panels):
    return cageik_cli.bind(animation.rest, animation.cage)


@pytest.fixture
def pinned_handles(folder):
    text = '{"handles": [{"name": "tip", "vertex": 0, "offset": [0, 0.1, 0]}]}'
    Path("handles.json").write_text(text)


def list_parameters():
    return [
        (function, name)
        for function in FUNCTIONS
        for name in inspect.signature(getattr(cageik_cli, function)).parameters
    ]


def test_every_function_is_called_here(calls):
    assert sorted(calls) == sorted(FUNCTIONS)


@pytest.mark.usefixtures("coarse_grids")
@pytest.mark.parametrize("function", FUNCTIONS)
def test_a_wrong_argument_is_refused_in_one_sentence(function, calls):
    call, right = getattr(cageik_cli, function), calls[function]
    unrefused = []
    for name in inspect.signature(call).parameters:
        refused = 0
        for kind, value in WRONG.items():
            for path in Path().glob("[depr].*"):
                path.unlink()
            try:
                call(**{**right, name: value})
            except cageik_cli.CageikError as error:
                refused += 1
                if "\n" in str(error) or len(str(error)) > 400:
                    unrefused.append(f"{name}={kind}: is no short sentence: {error}")
            except Exception as error:
                unrefused.append(f"{name}={kind}: {type(error).__name__}: {error}")
        assert refused, f"{name} takes everything"
    assert not unrefused, "\n".join(unrefused)


def takes_numbers(parameter):
    return not {"int", "float"}.isdisjoint(re.findall(r"\w+", str(parameter.annotation)))


@pytest.mark.usefixtures("coarse_grids")
@pytest.mark.parametrize("function", FUNCTIONS)
def test_odd_numbers_are_taken_or_refused_in_one_sentence(function, calls):
    call, right = getattr(cageik_cli, function), calls[function]
    parameters, wrong = inspect.signature(call).parameters, []
    for name in filter(lambda name: takes_numbers(parameters[name]), parameters):
        for kind, value in NUMBERS.items():
            for path in Path().glob("[depr].*"):
                path.unlink()
            try:
                call(**{**right, name: value})
            except cageik_cli.CageikError as error:
                if "\n" in str(error) or len(str(error)) > 400:
                    wrong.append(f"{name}={kind}: is no short sentence: {str(error)[:100]}")
            except Exception as error:
                wrong.append(f"{name}={kind}: {type(error).__name__}: {error}")
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize("function", FUNCTIONS)
def test_an_unknown_keyword_is_named_with_the_nearest(function, calls):
    (name, *_) = list(inspect.signature(getattr(cageik_cli, function)).parameters)[::-1]
    with pytest.raises(SettingError) as caught:
        getattr(cageik_cli, function)(**calls[function], **{name + "q": 1})
    assert f"{function}: `{name}q=` is not one of its keywords; do you mean `{name}=`" in str(
        caught.value
    )


def test_an_unknown_keyword_without_a_near_one_refers_to_the_help():
    with pytest.raises(SettingError, match=r"`zzz=` is not .*; see help\(cageik_cli.load_mesh\)"):
        cageik_cli.load_mesh("cage.obj", zzz=1)


def test_arguments_that_are_missing_too_many_or_given_twice_are_named():
    with pytest.raises(SettingError, match=r"export: `output=` is missing; give it"):
        cageik_cli.export("cages.h5")
    with pytest.raises(SettingError, match=r"load_mesh: given 2 arguments without a keyword.* 1;"):
        cageik_cli.load_mesh("cage.obj", "frames")
    with pytest.raises(SettingError, match=r"load_mesh: `path=` is given twice; leave one out"):
        cageik_cli.load_mesh("cage.obj", path="frames")


@pytest.mark.parametrize("blank", ["", "  ", "\t"])
@pytest.mark.parametrize(
    "function", ["deform", "edit_to_file", "export", "extract_to_file", "pose_to_file"]
)
def test_a_blank_output_is_refused_and_nothing_is_written(function, calls, blank):
    before = sorted(Path().rglob("*"))
    with pytest.raises(SettingError, match=r"`output=` is blank; give a name, or leave it out"):
        getattr(cageik_cli, function)(**calls[function] | {"output": blank})
    assert sorted(Path().rglob("*")) == before


def test_a_path_without_a_name_is_no_file_to_write(calls):
    for function in ("deform", "edit_to_file", "export", "extract_to_file", "pose_to_file"):
        with pytest.raises(cageik_cli.CageikError, match=r"^\.: "):
            getattr(cageik_cli, function)(**calls[function] | {"output": Path("")})


@pytest.mark.parametrize("kind", ["html", "plot", "json", "csv", "junit", "markdown", "player"])
def test_a_blank_view_is_refused(kind, calls):
    with pytest.raises(SettingError, match=f"`{kind}=` is blank"):
        cageik_cli.report_to_files("cages.h5", **{kind: " "})


WRITTEN = {
    "export": (ExportSettings, "export", ("result",)),
    "deform": (DeformSettings, "deform", ("source",)),
    "pose_to_file": (PoseSettings, "pose", ()),
    "edit_to_file": (EditSettings, "pose", ()),
    "report_to_files": (ReportSettings, "report", ()),
}
"""Functions with the settings of a command: the record, the command, and what is positional."""

OWN_WORDS = {
    "selection": "frames", "given_in": "from", "has_normals": "flat", "cage_output": "cage_out",
    "file_format": "format",
}  # fmt: skip
"""Keywords that are not spelled as their options: Python has the word, or they say what is so."""


@pytest.mark.parametrize("function", WRITTEN)
def test_keywords_are_the_words_of_the_command(function):
    record, command, positional = WRITTEN[function]
    known = {word.name for word in list_keywords(record)}
    signature = inspect.signature(getattr(cageik_cli, function))
    assert known - {*positional, *OWN_WORDS} <= set(signature.parameters) | {*positional}
    options = {
        word.removeprefix("--").replace("-", "_")
        for one in main.commands[command].params
        for word in [*one.opts, str(one.name)]
    }
    keywords = set(signature.parameters) - {"progress", "settings"}
    assert {OWN_WORDS.get(name, name) for name in keywords} <= options | {
        "results", "result", "source", "handles", "target", "output",
    }  # fmt: skip


def test_help_names_types_and_tells_what_keywords_do():
    text = pydoc.plain(pydoc.render_doc(cageik_cli.extract))
    assert "extract(clip: MeshSequence | ArrayLike, binding: Binding | None = None, *" in text
    assert "numpy" not in text.splitlines()[2]
    text = pydoc.plain(pydoc.render_doc(cageik_cli.export))
    assert "skeleton: bool = False" in text
    assert "root_motion : str" in text
    assert "With `skeleton`: the root moves" in text
    assert "**settings" not in text


def test_no_help_names_an_option_or_the_innards_of_numpy():
    for name in FUNCTIONS:
        text = pydoc.plain(pydoc.render_doc(getattr(cageik_cli, name)))
        assert not re.search(r"(?<!-)--[a-z]", text), name
        assert "NestedSequence" not in text, name


def test_settings_reach_the_command(extracted, run):
    settings = {"skeleton": True, "influences": 4, "joints": "translate"}
    written = cageik_cli.export("cages.h5", "a.glb", **settings)
    words = ("--skeleton", "--influences", "4", "--joints", "translate", "-q")
    assert run("export", "cages.h5", "b.glb", *words).code == 0
    assert Path("a.glb").read_bytes() == Path("b.glb").read_bytes()
    assert any("influences" in text for text in texts(written.notes))


def test_a_deformed_mesh_has_the_bytes_of_the_command(extracted, run):
    calls = []
    cageik_cli.deform(
        cageik_cli.read_result("cages.h5"), "a.glb", to="cm,z", morphs=3, has_normals=False,
        progress=lambda *done: calls.append(done),
    )  # fmt: skip
    words = ("--to", "cm,z", "--morphs", "3", "--flat", "-q")
    assert run("deform", "cages.h5", "-o", "b.glb", *words).code == 0
    assert Path("a.glb").read_bytes() == Path("b.glb").read_bytes()
    assert calls


def test_frames_of_cages_are_a_slice_or_numbers(extracted):
    cageik_cli.export("cages.h5", "cages.npz")
    for wanted in (slice(1, 3), "2-3"):
        written = cageik_cli.deform(
            "cages.h5", "a.npz", cages="cages.npz", selection=wanted, overwrite=True
        )
        assert written.frame_count == 2


def test_an_edit_has_the_bytes_of_the_command(extracted, run, pinned_handles):
    edit = cageik_cli.edit_to_file("cages.h5", "handles.json", "a.h5", rigidity=2, snap=1)
    assert repr(edit).startswith("<Edit: a.h5, ")
    words = ("-o", "b.h5", "--rigidity", "2", "--snap=1", "-q")
    assert run("pose", "cages.h5", "handles.json", *words).code == 0
    assert Path("a.h5").read_bytes() == Path("b.h5").read_bytes()


def test_a_pose_has_the_bytes_of_the_command(folder, run, pinned_handles):
    posed = cageik_cli.pose_to_file(
        "frames/frame_1.obj", "handles.json", "a.obj", cage="cage.obj", cage_output="c.obj"
    )
    words = ("--cage", "cage.obj", "-o", "b.obj", "--cage-out", "d.obj", "-q")
    assert run("pose", "frames/frame_1.obj", "handles.json", *words).code == 0
    assert Path("a.obj").read_bytes() == Path("b.obj").read_bytes()
    assert Path("c.obj").read_bytes() == Path("d.obj").read_bytes()
    np.testing.assert_allclose(
        cageik_cli.load_mesh("a.obj").vertices, posed.snapshot.after, rtol=1e-6, atol=1e-6
    )


def test_views_of_a_report_have_the_bytes_of_the_command(extracted, run):
    views = {"csv": "csv", "junit": "xml", "markdown": "md", "json": "json", "plot": "svg"}
    given = {kind: f"a.{suffix}" for kind, suffix in views.items()}
    (report,) = cageik_cli.report_to_files("cages.h5", **given)
    assert report == cageik_cli.build_report("cages.h5")
    words = [word for kind, suffix in views.items() for word in (f"--{kind}", f"b.{suffix}")]
    assert run("report", "cages.h5", *words).code == 0
    for suffix in ("csv", "svg"):
        assert Path(f"a.{suffix}").read_bytes() == Path(f"b.{suffix}").read_bytes()
    for suffix in ("xml", "md", "json"):  # where notes name a setting, one has the option
        views = [Path(f"{name}.{suffix}").read_text().replace("\\", "") for name in "ab"]
        alike = [SETTING.sub("SETTING", view) for view in views]
        assert alike[0] == alike[1]


def test_several_results_share_views_of_several_only(extracted):
    cageik_cli.report_to_files(["cages.h5", cageik_cli.read_result("cages.h5")], csv="a.csv")
    with pytest.raises(SettingError, match="`html=` shows one result, 2 were named"):
        cageik_cli.report_to_files(["cages.h5", "cages.h5"], html="a.html")
    with pytest.raises(SettingError, match=r"`film_seconds=`: no film is written"):
        cageik_cli.report_to_files("cages.h5", film_seconds=2.0)
    with pytest.raises(SettingError, match="`json=` is -, expected the name of a file"):
        cageik_cli.report_to_files("cages.h5", json="-")
    with pytest.raises(OutputError, match=r"a\.csv: exists already; .*`overwrite=True`"):
        cageik_cli.report_to_files("cages.h5", csv="a.csv")


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({"joints": "translate"}, "`joints=` needs `skeleton=`; give both"),
        ({"guide": True}, "`guide=` needs `with_model=`"),
        ({"morphs": 3}, "`morphs=` and `tolerance=` apply to .glb files"),
        ({"file_format": "x"}, "`file_format=` is 'x', expected one of obj"),
        ({"to": 3}, "`to=` is 3, expected text"),
        ({"to": "yards"}, "`yards` is not a unit"),
        ({"root_motion": "jump"}, "`root_motion=` is 'jump', expected one of keep, extract"),
    ],
)
def test_settings_that_mean_nothing_are_refused(extracted, settings, says):
    with pytest.raises(SettingError) as caught:
        cageik_cli.export("cages.h5", "x.npz", **settings)
    assert says in str(caught.value)


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({"selection": "1-2"}, "`selection=` is for the clip of `cages=`"),
        ({"layout": "fvx"}, "`layout=` is for the clip of `cages=`"),
        ({"close_gaps": True}, "`close_gaps=True` is for the clip of `cages=`"),
        ({"exclude": "eye"}, "`exclude=` is for `mesh=` and `cages=`"),
        ({"joints": 3}, "`joints=` needs `influences=`"),
        ({"allow_gaps": True, "close_gaps": True}, "exclude each other"),
        ({"jobs": 0}, "`jobs=` is 0, expected 1 or more"),
    ],
)
def test_settings_that_a_deformation_ignores_are_refused(extracted, settings, says):
    with pytest.raises(SettingError) as caught:
        cageik_cli.deform("cages.h5", "x.npz", **settings)
    assert says in str(caught.value)


def test_the_wrong_kind_of_target_is_refused_with_the_other_function(extracted, pinned_handles):
    with pytest.raises(cageik_cli.CageikError, match="cage"):
        cageik_cli.edit_to_file("frames/frame_1.obj", "handles.json", "x.h5")
    with pytest.raises(cageik_cli.CageikError, match=r"give one with `cage=`"):
        cageik_cli.pose_to_file("frames/frame_1.obj", "handles.json", "x.obj")
