"""`cageik extract`: works as typed, says what it did, and never takes an old result away."""

import hashlib
import json
import re
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

from cageik_cli.util import compiled
from tests.cli.terminal import on_a_terminal

TYPED = ("extract", "frames", "--cage", "cage.obj")


def test_swapped_cage_and_frames_are_told_as_they_are_typed(run, folder):
    """What the message says to type works."""
    outcome = run("extract", "cage.obj", "--cage", "frames")
    assert outcome.code == 2
    typed = outcome.err.rpartition("type: cageik ")[2].split()
    assert typed == ["extract", "frames", "--cage", "cage.obj"]
    assert run(*typed).code == 0


def test_a_glob_is_no_cage_that_was_swapped(run, folder):
    outcome = run("extract", "frames/*.obj", "--cage", "frames")
    assert outcome.code != 0
    assert "frames" in outcome.err
    assert "type: cageik" not in outcome.err


def test_the_two_commands_work_as_typed(folder):
    """With the shell's own glob, and nothing else given."""
    line = "-m cageik_cli extract frames/*.obj --cage cage.obj && {0} -m cageik_cli report"
    shell = f"'{sys.executable}' {line.format(repr(sys.executable))}"
    done = subprocess.run(shell, shell=True, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("cages.h5: 5 frames, 18 vertices, a cage of 8 that was given")
    assert "wrote cages.h5\n" in done.stderr
    assert sorted(item.name for item in folder.iterdir()) == ["cage.obj", "cages.h5", "frames"]


def test_the_installed_command_is_this_one(run_process):
    command = Path(sys.executable).with_name("cageik")
    if not command.exists():
        pytest.skip("not installed beside this Python")
    from cageik_cli import __version__

    done = subprocess.run([command, "--version"], capture_output=True, text=True, check=True)
    assert done.stdout == f"cageik, version {__version__}\ncore: {compiled.describe_core()}\n"


def test_the_summary_goes_to_stderr_and_ends_with_what_to_do_next(run, folder):
    outcome = run(*TYPED, "-o", "other.h5")
    assert (outcome.code, outcome.out) == (0, "")
    lines = outcome.err.splitlines()
    assert lines[0].startswith("other.h5: 5 frames, 18 vertices")
    assert lines[-3] == "wrote other.h5"
    assert [line.split("cageik ")[1] for line in lines[-2:]] == [
        "view other.h5",
        "export other.h5 other.usdc --with-model",
    ]
    assert len(lines) <= 9
    for command in lines[-1:]:
        assert run(*command.split("cageik ")[1].split()).code == 0


def test_all_figures_are_printed_with_v(run, folder):
    calm, full = run(*TYPED), run(*TYPED, "--overwrite", "-v")
    assert "  seconds        open " in full.err
    assert len(calm.err.splitlines()) <= 9 < len(full.err.splitlines())


def test_options_reach_the_result(run, folder, animation, write_obj):
    Path("weights.txt").write_text("1 " * 17 + "0")
    write_obj(Path("rest.obj"), animation.frames[0], animation.rest.faces)
    outcome = run(
        *TYPED, "--alpha", "0.5", "--beta", "2", "--no-align", "--fps", "30", "--no-weights",
        "--vertex-weights", "weights.txt", "--rest", "rest.obj", "--jobs", "1", "--memory", "1MiB",
    )  # fmt: skip
    assert outcome.code == 0, outcome.err
    with h5py.File("cages.h5") as file:
        assert "weights" not in file
        assert file.attrs["fps"] == 30
        assert json.loads(file.attrs["settings"]) == {
            "alpha": 0.5, "beta": 2.0, "align": False, "coordinates": "harmonic",
            "accuracy": "standard", "outside": "refuse",
            "rest_frame": None, "vertex_weights": True,
        }  # fmt: skip
        assert set(json.loads(file.attrs["sources"])) == {
            "frames", "cage", "rest", "vertex_weights"
        }  # fmt: skip


def test_timings_are_seconds_by_stage(run, folder):
    assert run(*TYPED, "--timings", "seconds.json").code == 0
    seconds = json.loads(Path("seconds.json").read_text())
    stages = {"open", "bind", "factor", "read", "solve", "measure", "try", "write"}
    assert set(seconds) == stages | {"total"}
    assert all(value >= 0 for value in seconds.values())
    assert sum(seconds[stage] for stage in stages) <= seconds["total"]
    assert run(*TYPED, "--timings", "seconds.json").code == 1
    assert run(*TYPED, "--resume", "--timings", "seconds.json").code == 0
    assert set(json.loads(Path("seconds.json").read_text())) == {"open", "total"}


def test_verbose_says_what_was_read_and_asked(run, folder):
    lines = run(*TYPED, "-v").err.splitlines()
    said = {line.split(": ")[0]: line.split(": ", 1)[1] for line in lines[-2:]}
    assert json.loads(said["settings"])["alpha"] == 1e-3
    assert json.loads(said["sources"])["cage"]["name"] == "cage.obj"


@pytest.mark.slow
def test_a_terminal_sees_a_bar_for_each_stage(folder):
    code, drawn = on_a_terminal(*TYPED)
    assert code == 0
    assert "bind: " in drawn
    assert "frames: " in drawn
    assert "18/18" in drawn
    assert "5/5" in drawn


def test_a_quiet_terminal_sees_none(folder):
    assert on_a_terminal(*TYPED, "-q") == (0, "")


BIND = ("bind", "--cage", "cage.obj", "--rest", "frames/frame_1.obj")


def test_weights_are_the_same_from_the_cache_and_without_it(run, folder, cache):
    """A result says nothing of where its weights came from, unless that is a binding file."""
    said = {}
    for name, words in (("miss", []), ("hit", []), ("none", ["--no-cache"])):
        outcome = run(*TYPED, "-v", "-o", f"{name}.h5", *words)
        assert outcome.code == 0
        said[name] = [line for line in outcome.err.splitlines() if line.startswith("  cache ")]
    assert said["miss"] == said["none"] == []
    assert re.fullmatch(r"  cache          cache hit, saved \d+\.\d s", *said["hit"])
    assert Path("miss.h5").read_bytes() == Path("hit.h5").read_bytes()
    assert Path("miss.h5").read_bytes() == Path("none.h5").read_bytes()
    assert len(list(cache.iterdir())) == 1


@pytest.mark.slow
def test_a_disk_with_room_for_the_result_alone(run_process, folder, cache, animation):
    """A limit on the size of a file stands for the end of the disk."""
    resource = pytest.importorskip("resource")
    from tests.shapes import finer

    fine = finer(animation.rest, 4)
    np.savez("clip.npz", verts=fine.vertices[None], faces=fine.faces)
    room = 250_000
    assert fine.vertices.size // 3 * 8 * 8 > room
    outcome = run_process(
        "-m", "cageik_cli", "extract", "clip.npz", "--cage", "cage.obj", "--no-weights", "-v",
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (room, room)),
    )  # fmt: skip
    assert outcome.code == 0, outcome.err
    assert f"  cache          {cache}: cannot be written (File too large)" in outcome.err
    assert list(cache.iterdir()) == []
    assert run_process("-m", "cageik_cli", "report").code == 0


@pytest.mark.parametrize("words", [[], ["--cage", "cage.obj"], ["--accuracy", "standard"]])
def test_a_binding_gives_what_its_weights_would(run, folder, words):
    """All but the sources, which name it."""
    assert run(*BIND, "--no-cache").code == 0
    assert run(*TYPED, "--no-cache").code == 0
    outcome = run("extract", "frames", "--binding", "binding.h5", "-o", "other.h5", *words)
    assert outcome.code == 0, outcome.err
    digest = hashlib.sha256(Path("binding.h5").read_bytes()).hexdigest()
    with h5py.File("cages.h5") as one, h5py.File("other.h5", "r+") as other:
        sources = json.loads(other.attrs["sources"])
        assert sources.pop("binding") == {"name": "binding.h5", "sha256": digest}
        known = json.loads(one.attrs["sources"])
        assert sources["cage"] == known["cage"]
        assert sources == known
        attributes = set(one.attrs) - {"sources"}
        assert attributes == set(other.attrs) - {"sources"}
        for name in attributes:
            assert one.attrs[name] == other.attrs[name]
        names = []
        one.visititems(lambda name, item: names.append(name) if hasattr(item, "shape") else None)
        for name in names:
            np.testing.assert_array_equal(one[name][()], other[name][()])


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--rest-frame", "2"], "binding.h5: is the binding of another rest pose (vertex 0 "),
        (["--cage", "moved.obj"], "binding.h5: is the binding of another cage (vertex 0 is 0.5 "),
        (["--cage", "frames/frame_1.obj"], "18 vertices, expected 8"),
        (["--rest", "cage.obj"], "cage.obj: 8 vertices, the first frame has 18"),
    ],
)
def test_a_binding_made_for_others_is_refused(run, folder, animation, write_obj, words, says):
    assert run(*BIND).code == 0
    moved = animation.cage.vertices + np.array([0.5, 0, 0])
    write_obj(Path("moved.obj"), moved, animation.cage.faces)
    outcome = run("extract", "frames", "--binding", "binding.h5", *words)
    assert (outcome.code, outcome.out) == (1, "")
    assert says in outcome.err
    assert len(outcome.err.splitlines()) == 1
    assert not Path("cages.h5").exists()


@pytest.mark.parametrize("table", ['accuracy = "fine"', 'outside = "project"'])
def test_a_file_of_options_may_contradict_the_binding(run, bound, table):
    """Unlike the command line: the file is for many runs."""
    Path("cageik.toml").write_text(f"[extract]\n{table}\n")
    words = ("--binding", "binding.h5", "-o", "other.h5", "--config", "cageik.toml")
    assert run("extract", "frames", *words).code == 0


@pytest.mark.slow
def test_frames_alone_are_enough(run, folder, coarse_grids):
    outcome = run("extract", "frames", "--cage-vertices", "20", "--cage-out", "built.obj", "-v")
    assert outcome.code == 0
    assert outcome.err.startswith("cages.h5: 5 frames of 18 vertices in a cage of 20")
    assert "\n  cage           built, 20 vertices, 36 triangles, genus 0" in outcome.err
    assert "\nwrote built.obj\n" in outcome.err
    assert run("check", "--cage", "built.obj", "frames").code == 0
    assert run("report", "cages.h5", "--html", "page.html").code == 0
