"""Scripts of the player are shortened to what means the same."""

import re
import shutil
import subprocess
from importlib.resources import files

import pytest

from cageik_cli.view.player.scripts import PLAYER_SCRIPTS, shorten_script

SCRIPTS = [*(files("cageik_cli.view") / "templates" / "player").iterdir()]


@pytest.mark.parametrize(
    ("script", "short"),
    [
        ("  // a word\nconst  far = 1;\n", "let far=1;"),
        ("a;\n  /** @param {string} text */\nb(text);\n", "a;b(text);"),
        ("a = b + +c - -d ;", "a=b+ +c- -d;"),
        ('return  "a  b" + \'c  //d\';', 'return"a  b"+\'c  //d\';'),
        ("if (a) {\n  b = `x  ${c}`;\n}\nelse d();", "if(a){b=`x  ${c}`}else d();"),
        ("const a = 1;\nconst b = a;\nf();", "let a=1,b=a;f();"),
        ("const a = () => { b; };\nconst c = 1;", "let a=()=>{b},c=1;"),
        ("let a = 1; f(); let b;\nif (a) { let c; }\nlet d;",
         "let a=1;f();let b;if(a){let c}let d;"),
        ("s = `${a  + 0.5} 0.5 ${b ? 'c  d' : 0}`;", "s=`${a+.5} 0.5 ${b ? 'c  d' : 0}`;"),
        ('let a = "x"; let b; for (let c of d) { e; } let g;',
         'let a="x",b;for(let c of d){e}let g;'),
        ("f(Infinity, Infinities, 2 * Infinity);", "f(1/0,Infinities,2*Infinity);"),
        ("return false;", "return!1;"),
        ("f((x) => x, async (y) => y, true, [0.5,],);", "f(x=>x,async(y)=>y,!0,[.5,],);"),
        ("s = `#version 300 es\nconst int a = 1 ;\nvoid f() { a; }`;",
         "s=`#version 300 es\nconst int a=1;void f(){a;}`;"),
        ('say("true;} const (x) => 0.5");', 'say("true;} const (x) => 0.5");'),
    ],
)  # fmt: skip
def test_what_is_left_means_the_same(script, short):
    assert shorten_script(script) == f"{short}\n"


def find_faults(script):
    """Return the lines of a script that do not keep to what is known."""
    code = re.sub(r"^\s*(?://|/\*\*).*\n", "", script, flags=re.MULTILINE)
    code = re.sub(r"`#version[^`]*`", "0", code)
    lines = [line.strip() for line in code.splitlines() if line.strip()]
    faults = [line for line in lines if re.search(r"//|/\*", re.sub(r'"[^"]*"', "", line))]
    faults += [line for line in lines if re.search(r"\$\{[^}`]*`", line)]
    for line, after in zip(lines, [*lines[1:], ";"], strict=True):
        is_whole = line[-1] in "{}([;,=:?&|`"
        goes_on = after[0] in ".?:&|)]}" or line.startswith(("for ", "if ", "else "))
        faults += [] if is_whole or goes_on else [line]
    return faults


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.name)
def test_our_scripts_keep_to_what_is_known(path):
    assert find_faults(path.read_text()) == []


@pytest.mark.parametrize(
    "line", ["f(); // a word", "f(/* no */);", "const a = b", "f()", "const a = `${b ? `c` : 0}`;"]
)
def test_other_scripts_are_found_out(line):
    assert set(find_faults(f"const a = 1;\n{line}\ng();\n")) == {line}


def parses(script, path):
    """Whether Node finds no fault in a script."""
    path.write_text(script)
    found = subprocess.run(
        [shutil.which("node"), "--check", path], capture_output=True, check=False
    )
    return found.returncode == 0


@pytest.mark.skipif(shutil.which("node") is None, reason="Node reads the script, and is not here")
def test_the_shortened_scripts_are_one_script(tmp_path):
    folder = files("cageik_cli.view") / "templates" / "player"
    names = (*PLAYER_SCRIPTS, "apply")
    whole = "".join(shorten_script((folder / f"{name}.js").read_text()) for name in names)
    assert parses(whole, tmp_path / "whole.js")
    assert not parses(whole.replace("}", "", 1), tmp_path / "broken.js")
