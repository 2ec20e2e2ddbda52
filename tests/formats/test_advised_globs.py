"""The globs that a message advises work when they are typed in a shell."""

import subprocess
import sys

import pytest

from cageik_cli.formats.open import open_sequence
from cageik_cli.formats.settings import ClipSettings
from cageik_cli.util.errors import SettingError

CUBE_TEXT = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"

FOLDERS = ["plain", "-dash", "a [1] b", "it's", 'say "x"', "sp ace", "$HOME", "[x]-*"]


@pytest.mark.parametrize("folder", FOLDERS)
def test_an_advised_glob_gives_its_frames(folder, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / folder).mkdir()
    texts = {"walk_": range(-2, 3), "-run [b] ": range(1, 4), "it's_": range(1, 3)}
    for text, numbers in texts.items():
        for number in numbers:
            (tmp_path / folder / f"{text}{number}.obj").write_text(CUBE_TEXT)
    with pytest.raises(SettingError) as caught:
        open_sequence([folder if folder[0] != "-" else f"./{folder}"])
    choices = str(caught.value).partition("quoted glob: ")[2].split(" meshes)")
    found = []
    for choice in filter(None, choices):
        typed, _, count = choice.removeprefix(" or ").rpartition(" (")
        code = "import sys; print(*sys.argv[1:], sep='\\n')"
        done = subprocess.run(
            ["sh", "-c", f'"$0" -c "$1" {typed}', sys.executable, code],
            capture_output=True, text=True, check=True,
        )  # fmt: skip
        words = done.stdout.splitlines()
        assert not any(word.startswith("-") for word in words)
        assert len(open_sequence(words, ClipSettings(gaps="close"))) == int(count)
        found.append(int(count))
    assert sorted(found) == [2, 3, 5]
