"""The files that other programs read: the action, the hooks of pre-commit, and the completion."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from cageik_cli.cli import main
from tests.docs.test_blocks import check_command

ROOT = Path(__file__).resolve().parents[1]
ACTION = yaml.safe_load((ROOT / ".github/actions/cageik/action.yml").read_text())
HOOKS = {one["id"]: one for one in yaml.safe_load((ROOT / ".pre-commit-hooks.yaml").read_text())}
STEPS = ACTION["runs"]["steps"]
USED = re.compile(r"\$\{\{ inputs\.([\w-]+)")


@pytest.fixture
def shell(folder, tmp_path_factory):
    """A function that runs words with `cageik` among the programs; its folder has a tiny clip."""
    programs = tmp_path_factory.mktemp("bin")
    program = programs / "cageik"
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m cageik_cli "$@"\n')
    program.chmod(0o755)
    path = f"{programs}{os.pathsep}{os.environ['PATH']}"

    def execute(*words, **environment):
        known = os.environ | {"PATH": path, "PYTHONPATH": str(ROOT)} | environment
        return subprocess.run(words, capture_output=True, text=True, timeout=120, env=known)

    return execute


def find_step(name: str) -> dict:
    return next(step for step in STEPS if step.get("name") == name)


def test_the_action_is_complete():
    assert ACTION["runs"]["using"] == "composite"
    for step in STEPS:
        assert ("run" in step) != ("uses" in step)
        assert "run" not in step or step["shell"] == "bash"
        # What users give is no part of a script, in which it would run.
        assert "${{" not in step.get("run", "")
    assert set(USED.findall(yaml.safe_dump(ACTION))) == set(ACTION["inputs"])
    for name, given in ACTION["inputs"].items():
        assert given["description"], name
        assert given.get("required") is True or isinstance(given["default"], str)
    # The folder of the action is so deep in the project that is installed.
    assert (ROOT / ".github/actions/cageik" / "../../.." / "pyproject.toml").exists()


def list_uploads(output: str) -> list[str]:
    (step,) = (step for step in STEPS if "upload-artifact" in step.get("uses", ""))
    assert step["if"] == "always()"
    return USED.sub(output, step["with"]["path"]).replace(" }}", "").split()


@pytest.mark.parametrize(("options", "code"), [("", 0), ("--max-rms 0.0001% --jobs 1", 3)])
def test_the_action_extracts_and_keeps_what_it_uploads(shell, folder, options, code):
    Path("all").mkdir()
    Path("frames").rename("all/frames")
    step = find_step("Extract and check")
    assert set(step["env"]) == {"FOLDERS", "OUTPUT", "OPTIONS"}
    given = {
        "FOLDERS": "all", "OUTPUT": "my out", "OPTIONS": f"--cage cage.obj {options}",
        "RUNNER_TEMP": str(folder),
    }  # fmt: skip
    done = shell("bash", "-e", "-c", step["run"], **given)
    assert done.returncode == code, done.stderr
    uploads = list_uploads("my*out")
    assert len(uploads) == 5
    assert all(list(Path().glob(pattern)) for pattern in uploads)
    assert re.search(r'time="\d+\.\d+"', Path("my out/junit.xml").read_text())
    outputs = [
        USED.sub("my out", one["value"]).replace(" }}", "") for one in ACTION["outputs"].values()
    ]
    assert all(Path(path).is_file() for path in outputs)


def test_the_action_runs_twice_in_a_job(shell, folder):
    """Each step has its own file of seconds, and a later run continues the first."""
    Path("all").mkdir()
    Path("frames").rename("all/frames")
    script = find_step("Extract and check")["run"]
    given = {"FOLDERS": "all", "RUNNER_TEMP": str(folder), "OPTIONS": "--cage cage.obj"}
    for output, options in (("out", ""), ("other", ""), ("out", " --resume")):
        options = given["OPTIONS"] + options
        done = shell("bash", "-e", "-c", script, **given | {"OUTPUT": output, "OPTIONS": options})
        assert done.returncode == 0, done.stderr
    assert len(list(folder.glob("cageik-*/seconds.json"))) == 3


def test_steps_of_other_inputs_have_caches_of_their_own(shell, folder):
    script, names = find_step("Name the cache")["run"], set()
    first = {"FOLDERS": "a b", "OUTPUT": "out", "OPTIONS": ""}
    others = [{"FOLDERS": "a"}, {"OUTPUT": "other"}, {"OPTIONS": "b"}]
    others += [{"FOLDERS": "a", "OPTIONS": "b"}, {"FOLDERS": "a bout", "OUTPUT": ""}, {}]
    for other in others:
        given = first | other | {"GITHUB_OUTPUT": "said", "RUNNER_OS": "Linux"}
        done = shell("bash", "-e", "-c", script, **given)
        assert done.returncode == 0, done.stderr
        (name,) = re.findall(
            r"^prefix=(cageik-Linux-[0-9a-f]{40}-)$", Path("said").read_text(), re.M
        )
        names.add(name)
        Path("said").unlink()
    assert len(names) == len(others)
    (step,) = (step for step in STEPS if "actions/cache" in step.get("uses", ""))
    assert step["with"]["key"].startswith("${{ steps.cache.outputs.prefix }}${{ github.run_id }}-")


def test_the_commands_of_action_and_hooks_exist():
    script = find_step("Extract and check")["run"].splitlines()[-1]
    assert check_command(shlex.split(script)[1:]) is None
    assert check_command(shlex.split(script.replace("--timings", "--timing"))[1:]) is not None
    for hook in HOOKS.values():
        command = re.search(r"cageik ((?:[a-z]+) [^;]*)", hook["entry"])[1]
        assert check_command(shlex.split(command)) is None


def start_hook(shell, name: str, *files: str, args=None):
    hook = HOOKS[name]
    assert hook["language"] == "python"
    assert all(re.search(hook["files"], file) for file in files)
    given = hook.get("args", []) if args is None else args
    return shell(*shlex.split(hook["entry"]), *given, *files)


def test_the_hook_of_cages_names_all_that_are_unfit(shell, folder):
    lines = Path("cage.obj").read_text().splitlines(keepends=True)
    Path("my cages").mkdir()
    Path("my cages/cage one.obj").write_text("".join(lines))
    assert start_hook(shell, "cageik-check", "cage.obj", "my cages/cage one.obj").returncode == 0
    for name in ("cage_a.obj", "cage_b.obj"):
        Path(name).write_text("".join(lines[:-1]))
    done = start_hook(shell, "cageik-check", "cage_a.obj", "cage.obj", "cage_b.obj")
    assert done.returncode == 1
    assert "cage_a.obj" in done.stderr + done.stdout
    assert "cage_b.obj" in done.stderr + done.stdout


def test_the_hook_of_limits_refuses_results_over_them(shell, extracted):
    args = ["--max-rms", "100%"]
    assert start_hook(shell, "cageik-limits", "cages.h5", args=args).returncode == 0
    done = start_hook(shell, "cageik-limits", "cages.h5")
    assert done.returncode == 3
    assert "over limit: rms" in done.stderr


def test_hooks_take_files_of_their_names_only():
    check, limits = (re.compile(HOOKS[name]["files"]) for name in ("cageik-check", "cageik-limits"))
    assert all(map(check.search, ["cage.obj", "a/b/cage_rest.ply", "cage.off"]))
    assert not any(map(check.search, ["package.obj", "cages.h5", "cage.py", "cage/model.obj"]))
    assert all(map(limits.search, ["cages.h5", "a/cages_walk.h5"]))
    assert not any(map(limits.search, ["weights.h5", "cages.h5.partial"]))


def test_the_page_names_all_inputs_and_hooks():
    page = (ROOT / "docs/continuous-integration.md").read_text()
    inputs, hooks = re.split("## Hooks of pre-commit", page)
    rows = re.findall(r"^\| `([\w-]+)` \|", inputs, re.M)
    assert rows == list(ACTION["inputs"])
    assert re.findall(r"^\| `([\w-]+)` \|", hooks, re.M) == list(HOOKS)
    block = re.search(r"```text\n(repos:.*?)```", hooks, re.S)[1]
    (repo,) = yaml.safe_load(block)["repos"]
    assert [hook["id"] for hook in repo["hooks"]] == list(HOOKS)


def complete(monkeypatch, capsys, shell_name: str, words: str) -> str:
    """Return what the command answers to a shell that asks how the last word may go on."""
    monkeypatch.setenv("_CAGEIK_COMPLETE", f"{shell_name}_complete")
    monkeypatch.setenv("COMP_WORDS", words)
    *before, last = words.split(" ")
    monkeypatch.setenv("COMP_CWORD", last if shell_name == "fish" else str(len(before)))
    with pytest.raises(SystemExit) as end:
        main(prog_name="cageik")
    assert end.value.code == 0
    return capsys.readouterr().out


SHELLS = ("bash", "zsh", "fish")


@pytest.mark.parametrize("shell_name", SHELLS)
def test_shells_get_their_completion(run_process, monkeypatch, shell_name):
    monkeypatch.setenv("_CAGEIK_COMPLETE", f"{shell_name}_source")
    start = "import sys; sys.argv = ['cageik']; from cageik_cli.__main__ import main; main()"
    done = run_process("-c", start, cwd=ROOT)
    assert done.code == 0
    assert f"_CAGEIK_COMPLETE={shell_name}_complete" in done.out


@pytest.mark.parametrize("shell_name", SHELLS)
@pytest.mark.parametrize(
    ("words", "expected", "other"),
    [
        ("cageik ext", "extract", "export"),
        ("cageik report --mark", "--markdown", "--json"),
        ("cageik extract --accuracy pre", "preview", "fine"),
    ],
)
def test_commands_options_and_choices_are_completed(
    monkeypatch, capsys, shell_name, words, expected, other
):
    answer = complete(monkeypatch, capsys, shell_name, words)
    lines = [re.split(r"[,\t]", line) for line in answer.splitlines()]
    assert any(expected in line for line in lines)
    assert not any(other in line for line in lines)


def test_files_are_completed(monkeypatch, capsys):
    assert complete(monkeypatch, capsys, "bash", "cageik report ca") == "file,ca\n"
