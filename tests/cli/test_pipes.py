"""Pipes and devices under the names of inputs are refused at once, by every command."""

import os
from pathlib import Path

import pytest

from cageik_cli.formats.find_files import clip_suffixes

pytestmark = pytest.mark.skipif(os.name != "posix", reason="pipes have no names on this system")

BASE = ("extract", "frames", "--cage", "cage.obj")
COMMANDS = {
    "cage": ("extract", "frames", "--cage", "odd.obj"),
    "packed cage": ("extract", "frames", "--cage", "odd.obj.gz"),
    "rest": (*BASE, "--rest", "odd.obj"),
    "binding": ("extract", "frames", "--binding", "odd.h5"),
    "vertex weights": (*BASE, "--vertex-weights", "odd.txt"),
    "config": (*BASE, "--config", "odd.toml"),
    "check": ("check", "--cage", "odd.obj"),
    "check rest": ("check", "--cage", "cage.obj", "--rest", "odd.obj"),
    "cage of a model": ("cage", "odd.obj", "-o", "built.obj"),
    "bind": ("bind", "--cage", "odd.obj", "--rest", "cage.obj", "-o", "b.h5"),
    "report": ("report", "odd.h5"),
    "baseline": ("report", "cages.h5", "--baseline", "odd.json", "--max-regression", "10%"),
    "export": ("export", "odd.h5", "out.npz"),
    "deform": ("deform", "cages.h5", "--mesh", "odd.obj", "-o", "out.npz"),
    "handles": ("pose", "cages.h5", "odd.json", "-o", "out.h5"),
    **{f"info {suffix}": ("info", f"odd{suffix}") for suffix in clip_suffixes()},
}


def make_device(path):
    path.symlink_to("/dev/zero")


@pytest.mark.parametrize("make", [os.mkfifo, make_device])
@pytest.mark.parametrize("words", COMMANDS.values(), ids=COMMANDS)
def test_a_pipe_or_a_device_is_refused(run, extracted, words, make):
    (name,) = (word for word in words if word.startswith("odd."))
    make(Path(name))
    outcome = run(*words, *(["--overwrite"] if words[0] == "extract" else []))
    assert (outcome.code, outcome.out) == (2 if "toml" in name else 1, "")
    last = outcome.err.splitlines()[-1]
    assert last.startswith("Error: ")
    assert f"{name}: " in last
    assert "is a pipe or a device" in last


@pytest.mark.parametrize("make", [os.mkfifo, make_device])
def test_a_frame_that_is_a_pipe_is_refused(run, folder, make):
    frame = Path("frames/frame_3.obj")
    frame.unlink()
    make(frame)
    outcome = run(*BASE)
    assert outcome.code == 1
    assert f"{frame}: is a pipe or a device" in outcome.err


@pytest.mark.parametrize("line", ['cage = "odd.obj"', 'cage = "cage.obj"\nrest = "odd.obj"'])
def test_a_pipe_in_a_file_of_options_fails_its_clip(run, folder, line):
    os.mkfifo("odd.obj")
    Path("cageik.toml").write_text(line + "\n")
    outcome = run("batch", "frames", "-o", "out", "--jobs", 1)
    assert outcome.code in (1, 4)
    assert "odd.obj: is a pipe or a device" in outcome.err


USES = {
    "sublayer": '#usda 1.0\n(subLayers = [@odd.usda@])\ndef Xform "A" {}\n',
    "sublayer by an expression": (
        '#usda 1.0\n(subLayers = [@`"${X}.usda"`@]\n'
        'expressionVariables = { string X = "odd" })\ndef Xform "A" {}\n'
    ),
    "sublayer by a stronger variable": (
        "#usda 1.0\n(subLayers = [@weak.usda@]\n"
        'expressionVariables = { string X = "odd" })\ndef Xform "A" {}\n'
    ),
    "reference by a stronger variable": (
        '#usda 1.0\n(expressionVariables = { string X = "odd" })\n'
        'def Xform "A" (references = @weak.usda@</B>) {}\n'
    ),
    "reference by a variable that is set": (
        '#usda 1.0\n(expressionVariables = { string Y = "" })\n'
        'def Xform "A" (payload = @asks.usda@</B>) {}\n'
    ),
    "reference": '#usda 1.0\ndef Xform "A" (references = @odd.usda@</B>) {}\n',
    "payload": '#usda 1.0\ndef Xform "A" (payload = @odd.usda@</B>) {}\n',
    "reference of a sublayer": '#usda 1.0\n(subLayers = [@inner.usda@])\ndef Xform "A" {}\n',
    "variant": (
        '#usda 1.0\ndef Xform "A" (\nvariants = { string v = "x" }\nprepend variantSets = "v"\n)\n'
        '{\nvariantSet "v" = {\n"x" (references = @odd.usda@) {\n}\n}\n}\n'
    ),
    "value clip": (
        '#usda 1.0\ndef Xform "A" (\nclips = {\ndictionary default = {\n'
        'asset[] assetPaths = [@odd.usda@]\nstring primPath = "/A"\n}\n}\n)\n{\n}\n'
    ),
}


@pytest.mark.parametrize("text", USES.values(), ids=USES)
@pytest.mark.parametrize("make", [os.mkfifo, make_device])
def test_a_usd_layer_that_is_a_pipe_is_refused(run, tmp_path, monkeypatch, text, make):
    pytest.importorskip("pxr")
    monkeypatch.chdir(tmp_path)
    Path("clip.usda").write_text(text)
    Path("inner.usda").write_text(USES["reference"])
    Path("plain.usda").write_text('#usda 1.0\ndef Xform "B" {}\n')
    Path("weak.usda").write_text(
        '#usda 1.0\n(subLayers = [@`"${X}.usda"`@]\nexpressionVariables = { string X = "plain" })\n'
    )
    asked = '@`if(defined("Y"), "odd.usda", "plain.usda")`@'
    Path("asks.usda").write_text(f'#usda 1.0\ndef Xform "B" (references = {asked}) {{}}\n')
    make(Path("odd.usda"))
    outcome = run("info", "clip.usda")
    assert (outcome.code, outcome.out) == (1, "")
    assert outcome.err.startswith("Error: clip.usda: odd.usda: is a pipe or a device")
