"""What holds for every command: no file is lost, -q is quiet, wrong usage changes nothing."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from numpy.lib.recfunctions import repack_fields

from tests.conftest import EXTRACT, run_in_process
from tests.shapes import box, quad_text
from tests.splats import encode_rows, make_splat_rows

HANDLES = """{"handles": [{"name": "tip", "vertex": 0, "offset": [0.1, 0.2, -0.3]},
                          {"name": "pin", "vertex": 7, "pin": true}]}"""


@pytest.fixture(scope="session")
def all_inputs(tmp_path_factory, tiny_files, animation) -> Path:
    """A folder, read only, with what the commands below read."""
    folder = tmp_path_factory.mktemp("inputs") / "inputs"
    shutil.copytree(tiny_files, folder, ignore=shutil.ignore_patterns("cache"))
    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.chdir(folder)
        monkeypatch.setenv("CAGEIK_CACHE", str(tiny_files / "cache"))
        assert run_in_process(*EXTRACT, "--no-weights", "-o", "bare.h5").code == 0
        assert run_in_process("report", "--json", "old.json", "-q").code == 0
    (folder / "handles.json").write_text(HANDLES)
    (folder / "turned.obj").write_text(quad_text(2.0, inward=True))
    rows = make_splat_rows(animation.rest, 60)
    (folder / "splats.ply").write_bytes(encode_rows(rows))
    (folder / "cloud.ply").write_bytes(encode_rows(repack_fields(rows[["x", "y", "z"]])))
    np.savez(folder / "edit.npz", vertices=animation.cage.vertices[None], faces=box().faces)
    return folder


@pytest.fixture
def workspace(tmp_path, monkeypatch, all_inputs, coarse_panels) -> Path:
    """The current folder, with what the commands below read."""
    shutil.copytree(all_inputs, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    # No page is served, which would not end.
    monkeypatch.setattr("cageik_cli.view.run.run_view", None)
    return tmp_path


def read_files():
    return {path: path.read_bytes() for path in Path().rglob("*") if path.is_file()}


BIND = "bind --cage cage.obj --rest frames/frame_1.obj"
EXTRACT_LINE = "extract frames --cage cage.obj"
REPAIR = "cage --repair turned.obj --rest frames/frame_1.obj"
POSE = "pose frames/frame_1.obj handles.json --cage cage.obj"
OUTPUTS = [
    (f"{EXTRACT_LINE} -o", "out.h5"),
    (f"{EXTRACT_LINE} --timings", "out.json"),
    (f"{EXTRACT_LINE} --export", "out.npz"),
    (f"{EXTRACT_LINE} --export", "out/c_##.obj"),
    (f"{BIND} -o", "out.h5"),
    (f"{BIND} -o x.h5 --timings", "out.json"),
    (f"{REPAIR} -o", "out.obj"),
    (f"{REPAIR} -o x.obj --json", "out.json"),
    ("check frames --cage cage.obj --json", "out.json"),
    ("check frames --cage cage.obj --plot", "out.png"),
    ("check frames --cage cage.obj --marked", "out.ply"),
    ("report --json", "out.json"),
    ("report --csv", "out.csv"),
    ("report --html", "out.html"),
    ("report --junit", "out.xml"),
    ("report --markdown", "out.md"),
    ("report --plot", "out.png"),
    ("report --plot", "out.SVG"),
    ("report --player", "out.html"),
    ("report --film-size 64x64 --film", "out.gif"),
    ("export cages.h5", "out.npz"),
    ("export cages.h5", "out/c_##.obj"),
    ("export cages.h5 --blender", "out"),
    ("deform cages.h5 -o", "out.npz"),
    ("deform cages.h5 -o", "out/m_##.ply"),
    ("deform cages.h5 --mesh cloud.ply -o", "out"),
    (f"{POSE} -o", "out.obj"),
    (f"{POSE} -o x.obj --cage-out", "out.obj"),
    (f"{POSE} -o x.obj --json", "out.json"),
    (f"{POSE} -o x.obj --plot", "out.png"),
    ("pose cages.h5 handles.json -o", "out.h5"),
]
"""Commands that work, but for the name of their last output, and that name."""


@pytest.mark.parametrize(("line", "name"), OUTPUTS)
def test_what_exists_stays_unless_it_may_be_replaced(run, workspace, line, name):
    words, place = [*line.split(), name], Path(name.split("/")[0])
    if line.startswith("extract") and " -o" not in line:
        Path("cages.h5").unlink()
    if place.suffix:
        place.write_text("old")
    else:
        assert run(*words).code == 0
        assert len(list(place.iterdir())) == (3 if "--blender" in line else 5)
        Path("cages.h5" if line.startswith("extract") else "x").unlink(missing_ok=True)
    before = read_files()
    refused = run(*words)
    assert (refused.code, refused.out) == (1, "")
    assert refused.err.startswith(f"Error: {place}: exists already")
    assert "--overwrite" in refused.err
    assert len(refused.err.splitlines()) == 1
    assert read_files() == before
    assert run(*words, "--overwrite").code == 0
    if place.suffix:
        assert len(place.read_bytes()) > 100
    else:
        Path(place, "mine.txt").write_text("mine")
        refused = run(*words, "--overwrite")
        assert refused.code == 1
        assert f"Error: {place}: holds mine.txt" in refused.err
        assert Path(place, "mine.txt").exists()


TAKEN = [
    *(
        (f"extract {frames} --cage cage.obj {option} frames/frame_2.obj", "frames/frame_2.obj")
        for frames in ("frames", "frames/*.obj", "frames/../frames/")
        for option in ("-o", "--timings")
    ),
    (f"{EXTRACT_LINE} -o cage.obj", "cage.obj"),
    (f"{EXTRACT_LINE} --timings old.json --baseline old.json", "old.json"),
    ("batch frames --cage cage.obj -o x --timings frames/frame_2.obj", "frames/frame_2.obj"),
    ("batch frames --cage cage.obj -o x --timings x/junit.xml", "x/junit.xml"),
    ("batch frames --cage cage.obj -o x --timings x/clips/a.json", "x/clips/a.json"),
    (f"{EXTRACT_LINE} --export frames/frame_#.obj", "frames"),
    (f"{EXTRACT_LINE} -o x.h5 --export x.h5/c_#.obj", "x.h5"),
    (f"{EXTRACT_LINE} --export c/c_#.obj --export c/d_#.ply", "c"),
    ("extract frames --binding binding.h5 -o binding.h5", "binding.h5"),
    (f"{BIND} -o cage.obj", "cage.obj"),
    (f"{BIND} -o frames/frame_1.obj", "frames/frame_1.obj"),
    ("cage frames/frame_1.obj -o frames/frame_1.obj", "frames/frame_1.obj"),
    (f"{REPAIR} -o turned.obj", "turned.obj"),
    ("check cage.obj --cage cage.obj --json cage.obj", "cage.obj"),
    ("check frames --cage cage.obj --json frames/frame_2.obj", "frames/frame_2.obj"),
    ("check --cage cloud.ply --marked cloud.ply", "cloud.ply"),
    ("report cages.h5 --html cages.h5", "cages.h5"),
    ("report --csv x.svg --plot x.svg", "x.svg"),
    ("report --baseline old.json --json old.json", "old.json"),
    ("export edit.npz edit.npz", "edit.npz"),
    ("export frames/frame_1.obj frames/frame_#.obj", "frames"),
    ("deform cages.h5 --cages frames -o frames/frame_#.obj", "frames"),
    ("deform cages.h5 --mesh frames/frame_1.obj -o frames/frame_#.obj", "frames"),
    ("deform cages.h5 --mesh cloud.ply -o ./cloud_##.ply", "."),
    ("pose frames/frame_1.obj handles.json --cage cage.obj -o cage.obj", "cage.obj"),
    (f"{POSE} -o x.obj --cage-out x.obj", "x.obj"),
    (f"{POSE} -o x.obj --json handles.json", "handles.json"),
    ("pose cages.h5 handles.json -o cages.h5", "cages.h5"),
    ("batch frames --cage cage.obj -o out --baseline out/report.json", "out/report.json"),
]
"""Commands that would write over what they read or write, and the name that they refuse."""


@pytest.mark.parametrize(("line", "name"), TAKEN)
def test_nothing_is_written_over_what_is_read_or_written(run, workspace, line, name):
    before = read_files()
    outcome = run(*line.split(), "--overwrite")
    assert (outcome.code, outcome.out) == (1, "")
    assert outcome.err.startswith("Error: ")
    assert f"{name}: is " in outcome.err
    assert "this command" in outcome.err
    assert len(outcome.err.splitlines()) == 1
    assert read_files() == before


FAILING = [
    *(
        (f"{line} {name}", name)
        for line in (f"{EXTRACT_LINE} -o", f"{BIND} -o", "pose cages.h5 handles.json -o")
        for name in ("out.npz", "out.obj")
    ),
    (f"{EXTRACT_LINE} -o nowhere/out.h5", "nowhere/out.h5: the folder nowhere "),
    (f"{EXTRACT_LINE} -o edit.npz/out.h5", "edit.npz/out.h5: the folder edit.npz "),
    (f"{EXTRACT_LINE} -o frames", "frames: is a folder"),
    pytest.param(
        f"{EXTRACT_LINE} -o /proc/out.h5",
        "/proc/out.h5: cannot be written (",
        marks=pytest.mark.skipif(not Path("/proc/self").exists(), reason="no such folder"),
    ),
    (f"{EXTRACT_LINE} -o x.h5 --timings nowhere/out.json", "nowhere/out.json"),
    (f"{EXTRACT_LINE} -o x.h5 --export c.npz --export c.gif", "c.gif: `.gif`"),
    (f"{EXTRACT_LINE} -o x.h5 --export edit.npz", "edit.npz: exists already"),
    (f"{EXTRACT_LINE} -o x.h5 --export no/c.npz", "no/c.npz: the folder no "),
    ("extract frames --binding nowhere.h5 -o x.h5", "nowhere.h5: "),
    ("extract frames --binding nowhere.h5 --accuracy fine", "nowhere.h5: "),
    ("extract frames --binding cages.h5 -o x.h5", "cages.h5: is not a binding"),
    ("extract frames --binding cages.h5 -o x.h5 --accuracy fine", "cages.h5: is not a binding"),
    ("extract binding.h5 --cage cage.obj -o x.h5", "binding.h5: is a binding"),
    (f"{BIND} --fit nowhere", "nowhere: no such file"),
    ("report nowhere.h5", "nowhere.h5: no such file"),
    ("report binding.h5", "binding.h5: "),
    ("report cages.h5 cage.obj --json r.json", "cage.obj: is not an HDF5 file"),
    ("report --json r.json --csv cage.obj", "cage.obj: exists already"),
    (f"{EXTRACT_LINE} -o x.h5 --baseline handles.json", "handles.json: schema is null"),
    ("report --baseline handles.json", "handles.json: schema is null"),
    ("check --cage none.obj", "none.obj: no such file"),
    ("check nowhere --cage cage.obj", "nowhere: no such file or folder"),
    (
        "check frames --cage cage.obj --rest-frame 9",
        "--rest-frame 9: there is no frame 9; the clip has 5",
    ),
    ("check --cage cage.obj --rest none.obj", "none.obj: no such file"),
    ("cage nowhere.obj -o x.obj", "nowhere.obj: no such file"),
    ("export nothing.h5 c.npz", "nothing.h5: no such file"),
    ("export cage.obj c.npz", "cage.obj: is not an HDF5 file"),
    ("export cages.h5 c.gif", "c.gif: `.gif`"),
    ("deform cages.h5 -o c.obj", "c.obj: a `.obj` file holds one frame"),
    ("export cages.h5 no/c.npz", "no/c.npz: the folder no "),
    ("export cages.h5 c/c_#.obj --start -1", "c/c_#.obj: the number of the first frame is -1"),
    ("export cages.h5 c.pc2 --skeleton", "c.pc2: --skeleton"),
    ("export cages.h5 c.glb --skeleton --influences 9", "c.glb: --influences"),
    ("export cages.h5 c.usd --skeleton --influences 9", "cages.h5: --influences"),
    ("export cages.h5 c.glb --tolerance 1e-9%", "c.glb: 4 morph targets"),
    ("export cages.h5 c.npz --format ply", "c.npz: has another suffix"),
    ("export cages.h5 c.pc2 --with-model", "c.pc2: --with-model"),
    ("export bare.h5 c.usda --with-model", "bare.h5: has no weights"),
    ("export bare.h5 c.usda --skeleton", "bare.h5: has no weights"),
    ("deform nothing.h5 -o m.npz", "nothing.h5: no such "),
    ("deform cages.h5 -o m.gif", "m.gif: `.gif`"),
    ("deform cages.h5 -o m.npz --format obj", "m.npz: has another suffix"),
    ("deform cages.h5 --mesh none.obj -o m.npz", "none.obj: no such file"),
    ("deform cages.h5 --cages none -o m.npz", "none: no such file or folder"),
    ("deform cages.h5 -o frames/frame_#.obj", "frames: exists already"),
    ("deform cages.h5 -o m.glb --morphs 2 --tolerance 1e-9%", "m.glb: 2 morph targets"),
    ("deform cages.h5 --cages frames -o m.npz", "frames: 18 vertices, the result's cage has 8"),
    ("deform binding.h5 --cages frames -o m.npz", "frames: 18 vertices, the binding's cage has 8"),
    ("deform binding.h5 -o m.npz", "binding.h5: is a binding, which has no cages"),
    ("deform binding.h5 --cages edit.npz --influences 3 -o m.npz", "binding.h5: is a binding"),
    *(
        (f"deform {name} --cages edit.npz -o m.npz", f"{name}: ")
        for name in ("cage.obj", "handles.json", "edit.npz", "nowhere.h5")
    ),
    (f"{POSE} -o out.stl", "out.stl: `.stl`"),
    (f"{POSE} -o out.obj --cage-out c.fbx", "c.fbx: `.fbx`"),
    ("pose cages.h5 none.json -o x.h5", "none.json: no such file"),
    ("pose none.h5 handles.json -o x.h5", "none.h5: no such file"),
    ("pose bare.h5 handles.json -o x.h5", "bare.h5: has no weights"),
    ("view none.h5 --no-browser", "none.h5: no such file"),
    ("view cages.h5 -o bare.h5 --no-browser", "bare.h5: exists already"),
    ("view cages.h5 --handles none.json --no-browser", "none.json: no such file"),
    ("view cages.h5 --handles cage.obj --no-browser", "cage.obj: is not JSON"),
    ("info nowhere", "nowhere: no such file or folder"),
    ("info -q nowhere", "nowhere: no such file or folder"),
    ("batch frames/frame_1.obj -o x", "frames/frame_1.obj: is a file"),
    ("batch frames frames -o x", "frames: would be searched twice"),
    ("batch . frames -o x", "frames: would be searched twice"),
]
"""Commands that cannot be done, and the beginning of what they say."""


@pytest.mark.parametrize(("line", "says"), FAILING)
def test_what_cannot_be_done_is_one_sentence_and_changes_nothing(run, workspace, line, says):
    before = read_files()
    outcome = run(*line.split())
    assert (outcome.code, outcome.out) == (1, "")
    assert outcome.err.startswith("Error: ")
    assert says in outcome.err
    assert len(outcome.err.splitlines()) == 1
    assert read_files() == before


QUIET = [
    *(f"{line} {name}" for line, name in OUTPUTS if " --plot" not in line and "html" not in line),
    "check frames --cage cage.obj",
    "report",
    "info cages.h5",
    "info frames",
    f"{EXTRACT_LINE} -o out.h5 --cache cage.obj",
    f"{EXTRACT_LINE} -o out.h5 --max-rms 1000%",
]


@pytest.mark.parametrize("line", QUIET)
def test_quiet_says_nothing(run, workspace, line):
    if line.startswith("extract"):
        Path("cages.h5").unlink()
    outcome = run(*line.split(), "-q")
    assert (outcome.code, outcome.out, outcome.err) == (0, "", "")


REPEATED = ("--cache a --no-cache", "--accuracy best", "--coordinates green", "--outside drop")
WRONG = {
    "extract": {
        "--cage cage.obj": "FRAMES",
        "frames --cage cage.obj --gamma 1": "--gamma",
        "frames --cage cage.obj --alpha -1": "alpha is -1.0",
        "frames --cage cage.obj --alpha nan": "alpha is nan",
        "frames --cage cage.obj --alpha inf": "alpha is inf",
        "frames --cage cage.obj --alpha much": "'much'",
        "frames --cage cage.obj --beta -1": "beta is -1.0",
        "frames --cage cage.obj --beta nan": "beta is nan",
        "frames --cage cage.obj --alpha 0 --beta 0": "alpha and beta are both 0",
        "frames --cage cage.obj --fps 0": "0 frames per second",
        "frames --cage cage.obj --fps nan": "nan frames per second",
        "frames --cage cage.obj --fps inf": "inf frames per second",
        "frames --cage cage.obj --jobs 0": "0 is not in the range",
        "frames --cage cage.obj --memory lots": "'lots' is not a size",
        "frames --cage cage.obj --rest cage.obj --rest-frame 0": "--rest and --rest-frame",
        "frames --cage cage.obj --rest-frame best": "'best' is not the number of a frame",
        "frames --cage cage.obj --rest-frame 1:5": "'1:5' is not the number of a frame",
        "frames --cage cage.obj --cage-out x.obj": "leave out --cage-out or --cage",
        "frames --cage cage.obj --cage-vertices 100": "leave out --cage-vertices or --cage",
        "frames --binding b.h5 --cage-vertices 100": "leave out --cage-vertices or --binding",
        "frames --cage cage.obj --symmetric x": "leave out --symmetric or --cage",
        "frames --binding binding.h5 --accuracy fine": "--accuracy fine: binding.h5",
        "frames --binding binding.h5 --outside project": "--outside project: binding.h5",
        "frames --cage-vertices 3": "a cage of 3 vertices",
        "frames --cage cage.obj --allow-gaps --close-gaps": "--close-gaps",
        "frames --cage cage.obj --frames ::0": "'::0'",
        "frames --cage cage.obj --frames ::-1": "'::-1'",
        "edit.npz --cage cage.obj --layout xvf": "'xvf'",
        "frames --cage cage.obj --max-regression 5%": "--baseline",
        "frames --cage cage.obj --config nowhere.toml": "nowhere.toml: cannot be read as TOML",
        **{f"frames --cage cage.obj {words}": words.split()[0] for words in REPEATED},
    },
    "bind": {
        "--rest frames/frame_1.obj": "'--cage'",
        "--cage cage.obj": "'--rest'",
        **{
            f"--cage cage.obj --rest frames/frame_1.obj {words}": words.split()[0]
            for words in REPEATED
        },
    },
    "cage": {
        "-o x.obj": "MODEL",
        "frames/frame_1.obj -o x.obj --vertices 7": "a cage of 7 vertices",
        "frames/frame_1.obj -o x.obj --vertices many": "'many'",
        "frames/frame_1.obj -o x.obj --clearance 0": "the clearance is 0 %",
        "frames/frame_1.obj -o x.obj --clearance 30%": "the clearance is 30 %",
        "frames/frame_1.obj -o x.obj --clearance wide": "'wide'",
        "frames/frame_1.obj -o x.obj --rest cage.obj --rest-frame 1": "--rest and --rest-frame",
        "--repair turned.obj -o x.obj": "--rest",
        "--repair turned.obj --rest cage.obj -o x.obj frames/frame_1.obj": "--rest",
        "--repair turned.obj --rest cage.obj -o x.obj --vertices 50": "--vertices",
        "--repair turned.obj --rest cage.obj -o x.obj --for frames": "--for",
    },
    "check": {
        "frames": "'--cage'",
        "frames --cage cage.obj --rest cage.obj --rest-frame 0": "--rest-frame",
        "--cage cage.obj --rest-frame 1": "--rest-frame needs FRAMES",
        "frames --cage cage.obj --plot x.jpg": "x.jpg",
        "frames --cage cage.obj --marked x.obj": "x.obj",
    },
    "report": {
        "--plot x.pdf": "x.pdf",
        "--plot -": "-: expected",
        "--plot png": "png: expected",
        "cages.h5 bare.h5 --html x.html": "--html",
        "cages.h5 bare.h5 --plot x.png": "--plot",
        "--max-regression 5%": "--baseline",
        "--csv - --json -": "--json and --csv",
        "--junit - --json -": "--json and --junit",
        "--markdown - --csv -": "--csv and --markdown",
        "--markdown - --junit -": "--junit and --markdown",
    },
    "export": {
        "cages.h5": "'RESULTS...'",
        "": "'RESULTS...'",
        "cages.h5 c --format stl": "'stl'",
        "cages.h5 c.npz --fps 0": "0 frames per second",
        "cages.h5 c.npz --up-axis X": "'X'",
        "cages.h5 c.npz --frame-step 0": "0 as the step",
        "cages.h5 c.npz --frame-step -1": "-1 as the step",
        "cages.h5 c.npz --frame-step nan": "nan as the step",
        "cages.h5 c.usd --influences 4": "--influences needs --skeleton",
        "cages.h5 c.usd --joints turn": "--joints needs --skeleton",
        "cages.h5 c.usd --skeleton --joints bend": "'bend' is not a number of joints",
        "cages.h5 c.usd --skeleton --influences 0": "0 is not in the range",
        "cages.h5 c.usda --guide": "--guide needs --with-model",
        "cages.h5 c.usd --morphs 9": "--morphs",
        "cages.h5 c --tolerance 1%": "--tolerance",
        "cages.h5 c.glb --morphs 1": "1 is not in the range",
        "cages.h5 c.glb --morphs 257": "257 is not in the range",
        "cages.h5 c.glb --tolerance 0%": "--tolerance",
        "cages.h5 c.glb --tolerance -1%": "'-1%'",
        "cages.h5 c.glb --tolerance nan": "'nan'",
        "cages.h5 c.glb --tolerance 1units": "'1units'",
        "cages.h5 c.glb --skeleton --morphs 9": "--skeleton",
    },
    "deform": {
        "cages.h5": "'--output'",
        "-o m.npz": "'RESULT'",
        "cages.h5 -o m.npz --frames :2": "--cages",
        "cages.h5 -o m.npz --layout fvx": "--cages",
        "cages.h5 -o m.npz --allow-gaps": "--cages",
        "cages.h5 -o m.npz --memory 0": "is not a size",
        "cages.h5 -o m.npz --fps nan": "nan frames per second",
        "cages.h5 -o m.npz --morphs 9": "m.npz",
        "cages.h5 -o m.npz --flat": "m.npz",
        "cages.h5 -o m.npz --texture exr": ".vat",
        "cages.h5 -o m.vat --texture tif": "'tif'",
        "cages.h5 -o m --tolerance 1%": ".glb",
        **{f"cages.h5 -o m.npz {words}": words.split()[0] for words in REPEATED},
    },
    "pose": {
        "frames/frame_1.obj handles.json --cage cage.obj": "'--output'",
        "frames/frame_1.obj -o x.obj": "'HANDLES'",
        "frames/frame_1.obj handles.json -o x.obj": "'--cage', which frames/frame_1.obj needs",
        "handles.json cages.h5 -o x.h5": "swap handles.json and cages.h5",
        "frames/frame_1.obj handles.json --cage cage.obj -o x.obj --alpha 0": "alpha is 0.0",
        "frames/frame_1.obj handles.json --cage cage.obj -o x.obj --plot x.svg": "x.svg",
        "cages.h5 handles.json -o x.h5 --cage cage.obj": "--cage is for a model",
        "cages.h5 handles.json -o x.h5 --cage-out x.obj": "--cage-out is for a model",
        "cages.h5 handles.json -o x.h5 --accuracy fine": "--accuracy is for a model",
        "binding.h5 handles.json -o x.obj --cage cage.obj": "--cage is for a model",
        "frames/frame_1.obj handles.json --cage cage.obj -o x.obj --snap=-1": "'-1'",
        "frames/frame_1.obj handles.json --cage cage.obj -o x.obj --snap -1": "'-1'",
        "frames/frame_1.obj handles.json --cage cage.obj -o x.obj --snap far": "'far'",
        "frames/frame_1.obj --snap handles.json -o x.obj": "put --snap last",
    },
    "view": {
        "": "'TARGET'",
        "cages.h5 --cage cage.obj": "--cage: a result",
        "cages.h5 --binding binding.h5": "--binding: a result",
        "cages.h5 -o x.h5 --cage-out c.obj": "--cage-out: a result",
        "binding.h5 --accuracy fine": "--accuracy: a binding",
        "frames/frame_1.obj --binding binding.h5 --cage-vertices 30": "--cage-vertices: a binding",
        "frames/frame_1.obj --cage cage.obj --symmetric auto": "--symmetric: it is for a cage",
        "frames/frame_1.obj --cage cage.obj --cage-vertices 30": "--cage-vertices: it is for",
        "cages.h5 --handles-out h.json": "--handles-out: ",
        "binding.h5 --cage-out c.obj": "--cage-out: it",
        "cages.h5 --port 65536": "'--port'",
        "frames/frame_1.obj --cage-vertices 3": "a cage of 3 vertices",
    },
    "batch": {
        "frames --cage cage.obj -o out --scheduler tcp://127.0.0.1:1 --jobs 2": "--jobs",
        "frames --cage cage.obj -o out --cache mine --no-cache": "--no-cache",
    },
    "info": {"": "'FILES...'"},
    "extrude": {"": "'extrude'"},
}
"""Per command: words that contradict each other or are none, and what of them is named."""


@pytest.mark.parametrize(
    ("line", "names"),
    [(f"{name} {words}", says) for name, rows in WRONG.items() for words, says in rows.items()],
)
def test_wrong_usage_is_exit_code_2(run, workspace, line, names):
    before = read_files()
    outcome = run(*line.split())
    assert (outcome.code, outcome.out) == (2, "")
    assert outcome.err.startswith("Usage: ")
    assert names in " ".join(outcome.err.split())
    assert read_files() == before


TABLES = {
    "extract frames": (
        'cage = "cage.obj"\noutput = "told.h5"\nalpha = 0.25\nbeta = 2\nalign = false\n'
        'fps = 30\nmemory = "1MiB"\njobs = 1\nrest-frame = 1\nno-weights = true\n'
        "allow_gaps = true\noverwrite = true\nquiet = true\n"
        'coordinates = "harmonic"\naccuracy = "fine"\noutside = "project"\ncache = "kept"\n',
        {"told.h5", "kept"},
    ),
    "bind": (
        'cage = "cage.obj"\nrest = "frames/frame_1.obj"\noutput = "told.h5"\n'
        'coordinates = "harmonic"\naccuracy = "fine"\noutside = "project"\ncache = "kept"\n'
        'timings = "seconds.json"\njobs = 1\noverwrite = true\nquiet = true\n',
        {"told.h5", "kept", "seconds.json"},
    ),
    "export cages.h5 told": (
        'fps = 25\nstart = 3\nup-axis = "Y"\nmetres_per_unit = 1\nformat = "ply"\n'
        "skeleton = false\noverwrite = true\nquiet = true\n",
        {f"told/told_{k:04d}.ply" for k in range(3, 8)},
    ),
    "export cages.h5 told.glb": (
        'morphs = 9\ntolerance = "0.5%"\nquiet = true\n',
        {"told.glb"},
    ),
    "deform cages.h5": (
        'mesh = "frames/frame_1.obj"\ncages = "edit.npz"\noutput = "told"\nframes = ":1"\n'
        'layout = "fvx"\nallow-gaps = true\nfps = 25\nstart = 3\nup-axis = "Z"\n'
        'metres-per-unit = 0.5\ncoordinates = "mean-value"\naccuracy = "fine"\n'
        'outside = "project"\ncache = "kept"\nno-cache = false\nformat = "ply"\n'
        'overwrite = true\nmemory = "1MiB"\njobs = 1\nquiet = true\n',
        {"told/told_0003.ply", "kept"},
    ),
    "check frames": (
        'cage = "cage.obj"\njson = "told.json"\nquiet = true\n',
        {"told.json"},
    ),
    "report": (
        'json = "told.json"\ncsv = "told.csv"\nquiet = true\n',
        {"told.json", "told.csv"},
    ),
}
"""Per command: a table of its options, and what it writes with them."""


@pytest.mark.parametrize("line", TABLES)
def test_a_file_may_hold_every_option(run, workspace, line):
    table, names = TABLES[line]
    name, *words = line.split()
    Path("cageik.toml").write_text(f"[{name}]\n{table}[info]\nquiet = true\n")
    before = set(read_files())
    outcome = run(name, *words, "--config", "cageik.toml")
    assert (outcome.code, outcome.out, outcome.err) == (0, "", "")
    made = set(read_files()) - before
    assert {str(path) for path in made if path.parts[0] != "kept"} == names - {"kept"}
    assert ("kept" in names) == any(path.suffix == ".weights" for path in made)
