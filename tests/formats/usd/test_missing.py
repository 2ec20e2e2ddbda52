"""What a stage is composed of, and is not there: named before anything else is said."""

import pytest

from cageik_cli.formats.open import open_sequence
from cageik_cli.util.errors import FileAccessError, FormatError
from tests.formats.scenes import UsdScene, translation
from tests.refusals import refused
from tests.texts import texts

VARIANTS = """def Xform "hero" (
    variants = { string kind = "one" }
    prepend variantSets = "kind"
) {
    variantSet "kind" = {
        "one" ( references = @./one.usdc@ ) {
        }
        "two" ( references = @./two.usdc@ ) {
        }
    }
}"""

CLIPS = """def Xform "hero" (
    clips = { dictionary default = {
        asset[] assetPaths = [@./one.usdc@]
        double2[] active = [(0, 0)]
        string primPath = "/hero"
    } }
) {
}"""

SCENES = {
    "a reference": (
        'def Xform "hero" ( references = @./one.usdc@ ) {}',
        "/hero refers to one.usdc",
    ),
    "a reference below": (
        'def "a" {\n def Xform "hero" ( references = @./geo/one.usdc@</x> ) {}\n}',
        "/a/hero refers to geo/one.usdc",
    ),
    "a payload": (
        'def Xform "hero" ( payload = @geo/one.usdc@ ) {}',
        "/hero refers to geo/one.usdc",
    ),
    "a sublayer": ("( subLayers = [@./one.usdc@] )", "has the sublayer one.usdc"),
    "a nested layer": ("( subLayers = [@./folder/nested.usda@] )", "refers to folder/deep.usdc"),
    "the chosen variant": (VARIANTS, "/hero refers to one.usdc"),
    "a value clip": (CLIPS, "/hero has the value clip one.usdc"),
    "an expression": (
        '( expressionVariables = { string V = "one" } )\n'
        'def Xform "hero" ( references = @`"./${V}.usdc"`@ ) {}',
        "/hero refers to one.usdc",
    ),
    "a pattern": (
        'def Xform "hero" ( references = @./t.<UDIM>.usd@ ) {}',
        "refers to t.<UDIM>.usd",
    ),
    "an instance": (
        'def Xform "hero" ( references = @./one.usdc@\n instanceable = true ) {}',
        "/hero refers to one.usdc",
    ),
    "a prim": (
        'def Xform "hero" ( references = @./folder/nested.usda@</x> ) {}',
        "/hero refers to the prim /x of folder/nested.usda",
    ),
    "a default prim": (
        'def Xform "hero" ( references = @./folder/nested.usda@ ) {}',
        "/hero refers to the default prim of folder/nested.usda",
    ),
}


def write(folder, text):
    (folder / "folder").mkdir(exist_ok=True)
    nested = '#usda 1.0\ndef Xform "n" ( references = @./deep.usdc@ ) {}\n'
    (folder / "folder" / "nested.usda").write_text(nested)
    path = folder / "shot.usda"
    path.write_text(f"#usda 1.0\n{text}\n")
    return path


@pytest.mark.parametrize("kind", SCENES)
def test_what_is_missing_is_named_first(kind, tmp_path, capfd):
    text, says = SCENES[kind]
    path = write(tmp_path, text)
    with refused(FileAccessError, f"{says}, which is not there", path):
        open_sequence([str(path)])
    with refused(FileAccessError, "put what is missing there, or correct its path; without it: "):
        open_sequence([f"{path}::hero"])
    assert capfd.readouterr().err == ""


def test_variants_that_are_not_chosen_may_lack_their_files(tmp_path):
    path = write(tmp_path, VARIANTS)
    scene = UsdScene(tmp_path, "one.usdc")
    scene.transform([translation(1, 0, 0)], "top")
    scene.mesh(parent="top")
    scene.stage.SetDefaultPrim(scene.stage.GetPrimAtPath("/top"))
    scene.close()
    clip = open_sequence([str(path)])
    assert clip.first.attributes.parts.names == ("/hero/mesh",)
    assert "not there" not in " ".join(texts(clip.notes))


@pytest.mark.parametrize(
    ("name", "data", "says"),
    [
        ("one.usdc", b"PXR-USDC" + bytes(99), "is not a sound USD file ("),
        (
            "one.abc",
            b"Ogawa\xff" + bytes(99),
            "is an Alembic archive, which usd-core does not read",
        ),
        ("one.xyz", b"text", "is not a sound USD file ("),
    ],
)
def test_a_file_that_is_there_and_cannot_be_read_is_named(tmp_path, name, data, says):
    path = write(tmp_path, f'def Xform "hero" ( references = @./folder/{name}@ ) {{}}')
    (tmp_path / "folder" / name).write_bytes(data)
    with refused(FormatError, f"folder/{name}: {says}", path):
        open_sequence([str(path)])


def test_what_is_missing_beside_a_mesh_is_noted_first(tmp_path):
    scene = UsdScene(tmp_path, "mesh.usda")
    scene.mesh()
    for k in range(5):
        prim = scene.stage.DefinePrim(f"/gone_{k}", "Xform")
        prim.GetReferences().AddReference(f"./gone_{k}.usdc")
    notes = texts(scene.opened().notes)
    told = [
        f"/gone_{k} refers to gone_{k}.usdc, which is not there; it is left out" for k in (0, 1, 2)
    ]
    assert sorted(notes[:3]) == [f"warning: mesh.usda: {text}" for text in told]
    assert notes[3] == "warning: mesh.usda: 2 more that it refers to are not there"
    assert "USD warns" not in " ".join(notes)
