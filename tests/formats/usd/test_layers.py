"""The layers of a stage are found as USD composes them, before USD opens them."""

import random
from pathlib import Path

import pytest
from pxr import Tf, Usd

from cageik_cli.formats.open import open_sequence
from cageik_cli.formats.usd import library
from cageik_cli.formats.usd.library import check_layers
from cageik_cli.util.errors import FormatError
from tests.refusals import refused

NAMES = "abcdef"

ARC = '@`"./${X}.usda"`@'


def write_layer(name, *metadata, arcs=(), below=""):
    """Write a text layer with a prim, its arcs, and what is below it."""
    text = ["#usda 1.0", "(", 'defaultPrim = "m"', *metadata, ")", 'def "m" (', *arcs, ") {", below]
    Path(name).write_text("\n".join([*text, "}", ""]))


def set_variables(**values):
    texts = (f'string {name} = "{value}"' for name, value in values.items())
    return "expressionVariables = {\n" + "\n".join(texts) + "\n}"


def name_at_random(generator):
    """A file by its name, or by an expression."""
    one = generator.choice(NAMES)
    return generator.choice(
        [
            f"@./{one}.usda@",
            ARC,
            '@`"./${Y}.usda"`@',
            f'@`if(defined("X"), "./${{X}}.usda", "./{one}.usda")`@',
            f'@`if(eq("${{X}}", "a"), "./${{Y}}.usda", "./{one}.usda")`@',
        ]
    )


def write_at_random(generator):
    """Layers that name each other, by variables that any of them may set."""
    for name in NAMES:
        chosen = [each for each in "XY" if generator.random() < 0.6]
        values = {each: generator.choice([*NAMES, "`'${Y}'`"]) for each in chosen}
        below = [name_at_random(generator) for _ in range(generator.choice([0, 0, 1, 2]))]
        kind = generator.choice(["references", "payload", "inherits"])
        arc = "</m/k>" if kind == "inherits" else name_at_random(generator)
        write_layer(
            f"{name}.usda",
            set_variables(**values) if values else "",
            f"subLayers = [{', '.join(below)}]",
            arcs=[f"prepend {kind} = {arc}"],
            below=f'class "k" (prepend references = {name_at_random(generator)}) {{\n}}',
        )


def test_every_layer_that_usd_uses_was_checked(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    # Those of cycles are found, too, before these are refused.
    monkeypatch.setattr(library._PrimCounter, "count_stage", lambda self, layer: 0)
    found = 0
    for seed in range(20):
        write_at_random(random.Random(seed))
        with Tf.DiagnosticTrap() as trap:
            checked = check_layers(Path("a.usda"))
            stage = Usd.Stage.Open("a.usda")
            list(stage.TraverseAll())
            used = [layer.realPath for layer in stage.GetUsedLayers() if not layer.anonymous]
            trap.Clear()
        assert set(used) <= {layer.realPath for layer in checked}
        found += len(used)
    assert found > 40


def test_a_layer_is_followed_for_each_value_of_its_variables(tmp_path, monkeypatch):
    """One layer, referred to by two that set its variable."""
    monkeypatch.chdir(tmp_path)
    for name in ("one", "two"):
        write_layer(
            f"{name}.usda", set_variables(X=f"{name}_end"), arcs=["references = @end.usda@"]
        )
        write_layer(f"{name}_end.usda")
    write_layer("end.usda", set_variables(X="end"), arcs=[f"references = {ARC}"])
    write_layer("top.usda", "subLayers = [@low.usda@]", arcs=["references = @one.usda@"])
    write_layer("low.usda", below='def "n" (references = @two.usda@) {\n}')
    found = {Path(layer.realPath).name for layer in check_layers(Path("top.usda"))}
    assert found >= {"one_end.usda", "two_end.usda"}


def test_prims_behind_expressions_are_counted(tmp_path, monkeypatch):
    """Each layer brings the next in three times, by a variable of the first."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(library, "MAX_PRIMS", 1000)
    for k in range(8):
        arcs = f'@`"./${{P}}{k + 1}.usda"`@'
        below = "".join(f'def "c{n}" (references = {arcs}) {{\n}}\n' for n in range(3))
        variables = [set_variables(P="x")] if k == 0 else [set_variables(P="nowhere")]
        write_layer(f"x{k}.usda", *variables, below=below)
    write_layer("x8.usda")
    with refused(FormatError, "more than 1000 prims", at="x0.usda"):
        open_sequence(["x0.usda"])


def test_layers_that_are_many_by_their_variables_are_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(library, "MAX_LAYERS", 20)
    below = "".join(f'def "n{k}" (references = @v{k}.usda@) {{\n}}\n' for k in range(15))
    write_layer("top.usda", below=below)
    for k in range(15):
        write_layer(f"v{k}.usda", set_variables(X=str(k)), arcs=["references = @end.usda@"])
    write_layer("end.usda")
    with refused(FormatError, "more than 20 layers"):
        check_layers(Path("top.usda"))


def write_cross(folder, names=range(6)):
    """Prims that each refer to all others: the ways through them are 6 factorial."""
    parts = "".join(
        f'def "p{k}" {{\n'
        + "".join(f'def "q{j}" (references = </m/p{j}>) {{\n}}\n' for j in names)
        + "}\n"
        for k in names
    )
    write_layer(folder / "top.usda", below=parts)


def write_sublayers(folder):
    write_layer(folder / "top.usda", "subLayers = [@low.usda@]")
    write_layer(folder / "low.usda", "subLayers = [@top.usda@]")


def write_arcs_behind_sublayers(folder):
    """A layer whose prims are in its sublayer, which refers to the first again."""
    write_layer(folder / "top.usda", below='def "n" (references = @stack.usda@</m>) {\n}')
    (folder / "stack.usda").write_text("#usda 1.0\n(subLayers = [@held.usda@])\n")
    write_layer(folder / "held.usda", below='def "n" (payload = @top.usda@) {\n}')


CYCLES = {
    "itself": lambda folder: write_layer(folder / "top.usda", arcs=["references = @top.usda@"]),
    "its parent": lambda folder: write_layer(
        folder / "top.usda", below='def "n" (inherits = </m>) {\n}'
    ),
    "each other": write_cross,
    "behind sublayers": write_arcs_behind_sublayers,
}


@pytest.mark.parametrize("name", CYCLES)
def test_prims_that_refer_to_themselves_are_refused(tmp_path, monkeypatch, name):
    CYCLES[name](tmp_path)
    monkeypatch.chdir(tmp_path)
    with refused(FormatError, "refers to itself, or to what holds it; export the mesh alone"):
        check_layers(Path("top.usda"))


def test_a_sublayer_of_itself_is_refused(tmp_path, monkeypatch):
    write_sublayers(tmp_path)
    monkeypatch.chdir(tmp_path)
    with refused(FormatError, "top.usda is a sublayer of itself"):
        check_layers(Path("top.usda"))


def test_layers_may_refer_to_each_other_without_a_cycle(tmp_path, monkeypatch):
    """A sublayer brings in again what is below it, and a prim refers to one beside it."""
    monkeypatch.chdir(tmp_path)
    both = "".join(
        f'def "{name}" ({arc}) {{\n}}\n'
        for name, arc in {"a": "", "b": "references = </m/a>", "c": "payload = @x.usda@"}.items()
    )
    write_layer("x.usda", below='def "a" {\n}')
    write_layer("top.usda", "subLayers = [@x.usda@]", arcs=["references = @x.usda@"], below=both)
    names = {Path(layer.realPath).name for layer in check_layers(Path("top.usda"))}
    assert names == {"top.usda", "x.usda"}


def test_prims_of_sublayers_are_counted(tmp_path, monkeypatch):
    """What refers to a layer gets the prims of its sublayers."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(library, "MAX_PRIMS", 50)
    write_layer("low.usda", below="".join(f'def "n{k}" {{\n}}\n' for k in range(40)))
    Path("stack.usda").write_text("#usda 1.0\n(subLayers = [@low.usda@])\n")
    write_layer("top.usda", arcs=["references = @stack.usda@</m>"])
    check_layers(Path("top.usda"))
    twice = "".join(f'def "{name}" (references = @stack.usda@</m>) {{\n}}\n' for name in "no")
    write_layer("top.usda", below=twice)
    with refused(FormatError, "more than 50 prims"):
        check_layers(Path("top.usda"))


def write_twice(part, count=12):
    """Prims that each bring in twice what the one before has, at a path of `part`."""
    prims = "".join(
        part.format(k=k, below=k - 1)
        + f'def "twice_{k}" {{\ndef "c" {{\n'
        + "".join(
            f'def "{name}" (references = </m/by_{k - 1}/c>) {{\n}}\n' if k else "" for name in "lr"
        )
        + "}\n}\n"
        for k in range(count)
    )
    relocated = "".join(f"</m/by_{k}/old>: </m/by_{k}/c>, " for k in range(count) if "old" in part)
    write_layer("top.usda", f"relocates = {{{relocated}}}", below=prims)


COMPOSED = {
    "reference": 'def "by_{k}" (references = </m/twice_{k}>) {{\n}}\n',
    "payload": 'def "by_{k}" (payload = </m/twice_{k}>) {{\n}}\n',
    "inherit": 'def "by_{k}" (inherits = </m/twice_{k}>) {{\n}}\n',
    "specialize": 'def "by_{k}" (specializes = </m/twice_{k}>) {{\n}}\n',
    "over": 'def "by_{k}" (references = </m/twice_{k}>) {{\nover "c" {{\n}}\n}}\n',
    "variant": (
        'def "by_{k}" (variantSets = "v"\nvariants = {{ string v = "x" }}) {{\n'
        'variantSet "v" = {{\n"x" (references = </m/twice_{k}>) {{\n}}\n}}\n}}\n'
    ),
    "prim in a variant": (
        'def "by_{k}" (variantSets = "v"\nvariants = {{ string v = "x" }}) {{\n'
        'variantSet "v" = {{\n"x" {{\ndef "c" (references = </m/twice_{k}/c>) {{\n}}\n}}\n}}\n}}\n'
    ),
    "relocated": (
        'def "hold_{k}" {{\ndef "old" (references = </m/twice_{k}/c>) {{\n}}\n}}\n'
        'def "by_{k}" (references = </m/hold_{k}>) {{\n}}\n'
    ),
}


@pytest.mark.parametrize("name", COMPOSED)
def test_prims_at_paths_that_are_composed_are_counted(tmp_path, monkeypatch, name):
    """USD composes more prims than are allowed, and a clip that has fewer is not refused."""
    monkeypatch.chdir(tmp_path)
    write_twice(COMPOSED[name])
    stage = Usd.Stage.Open("top.usda")
    composed = len(list(stage.Traverse()))
    assert composed > 2**12
    monkeypatch.setattr(library, "MAX_PRIMS", 2**12)
    with refused(FormatError, "more than 4096 prims"):
        check_layers(Path("top.usda"))
    monkeypatch.setattr(library, "MAX_PRIMS", 8 * composed)
    check_layers(Path("top.usda"))


def test_a_prim_may_refer_to_one_that_what_holds_it_brings_in(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    parts = 'def "a" (references = </m/b>) {\ndef "x" (references = </m/a/c>) {\n}\n}\n'
    write_layer("top.usda", below=parts + 'def "b" {\ndef "c" {\ndef "d" {\n}\n}\n}\n')
    stage = Usd.Stage.Open("top.usda")
    assert stage.GetPrimAtPath("/m/a/x/d")
    check_layers(Path("top.usda"))


ENDLESS = {
    "a part of itself": 'def "a" (references = </m/a/c>) {\n}\n',
    "each other": 'def "a" (references = </m/b/x>) {\n}\ndef "b" (references = </m/a>) {\n}\n',
}


@pytest.mark.parametrize("name", ENDLESS)
def test_prims_that_are_brought_in_by_themselves_are_refused(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    write_layer("top.usda", below=ENDLESS[name])
    with refused(FormatError, "its references are nested too deeply; export the mesh alone"):
        check_layers(Path("top.usda"))
