"""The options of a fit: what contradicts another is wrong usage, whatever command it is."""

import json
from dataclasses import asdict, dataclass, replace

import click
import h5py
import numpy as np
import pytest

from cageik_cli.cli import main
from cageik_cli.cli.extract import EXTRACT_OPTIONS
from cageik_cli.cli.options.group import list_options
from cageik_cli.fit.settings import FitSettings
from cageik_cli.report.fit_rows import format_fit_rows
from cageik_cli.report.vocabulary import SETTING_MEANINGS
from cageik_cli.util.settings import declare_setting, describe_settings, list_meanings
from tests.store.bindings import record


def refused(run, *words):
    outcome = run(*words)
    assert outcome.code == 2, outcome.err
    return outcome.err


EXTRACT = ("extract", "frames", "--cage", "cage.obj")
BIND = ("bind", "--cage", "cage.obj", "--rest", "frames/frame_1.obj")


@pytest.mark.parametrize("command", [EXTRACT, BIND])
@pytest.mark.parametrize("name", list_meanings(FitSettings))
def test_options_of_a_fit_need_one(folder, run, command, name):
    option, value = f"--{name.replace('_', '-')}", "play" if name == "fit_for" else "3"
    assert f"{option} is for weights that are fitted" in refused(run, *command, option, value)


@dataclass(frozen=True, slots=True)
class ToySettings(FitSettings):
    """The settings of a fit, and one more of each kind."""

    seed: int = declare_setting(0, "Draws frames.", name="fit_seed", meaning="seed of the draw")
    limit: int | None = declare_setting(None, "Ends.", name="fit_limit", unset="never")
    twice: bool = declare_setting(False, "Does it again.", name="fit_twice")


def test_an_option_of_a_fit_is_one_declaration():
    """Name, kind and default of the option, and how the value is recorded and printed."""
    given = {}
    command = click.Command("fit", callback=lambda **values: given.update(values))
    for add_option in list_options(ToySettings):
        command = add_option(command)
    words = ["--fit-seed", "1234567", "--fit-twice", "--fit-regularization", "auto"]
    command.main(words, standalone_mode=False)
    settings = ToySettings(**given | {"regularization": None, "smoothness": None})
    assert settings == ToySettings(regularization=None, seed=1234567, twice=True)
    assert type(settings.seed) is int
    assert describe_settings(settings) == describe_settings(FitSettings()) | {
        "fit_seed": 1234567, "fit_limit": None, "fit_twice": True
    }  # fmt: skip
    (_, text), *_ = format_fit_rows(replace(record(), settings=settings))
    assert text.startswith("regularization 0.1, smoothness 1, seed 1234567, twice True; ")
    with pytest.raises(click.BadParameter, match="not a valid integer"):
        command.main(["--fit-seed", "1.5"], standalone_mode=False)


def test_every_setting_of_a_fit_has_a_meaning():
    for name, meaning in list_meanings(FitSettings).items():
        assert SETTING_MEANINGS[name] == meaning != ""


@pytest.mark.parametrize("command", [(*EXTRACT, "--fit"), (*BIND, "--fit", "frames")])
@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("--fit-regularization", "much"), "'much' is not a number"),
        (("--fit-regularization", "0"), "regularization is 0"),
        (("--fit-regularization", "nan"), "regularization is nan"),
        (("--fit-smoothness", "-1"), "smoothness is -1"),
        (("--fit-for", "fun"), "'fun' is not one of 'edit', 'play'"),
        (
            ("--fit-for", "play", "--fit-regularization", "0.1"),
            "the fit is for play, but its regularization is 0.1",
        ),
        (("--fit-rank", "0"), "rank is 0"),
        (("--influences", "0"), "influences is 0"),
        (("--fit-rank", "3", "--influences", "4"), "a fit has one of them"),
    ],
)
def test_impossible_values_are_wrong_usage(folder, run, command, words, says):
    assert says in refused(run, *command, *words)


def test_a_binding_brings_its_weights(folder, run):
    words = ("extract", "frames", "--binding", "b.h5", "--fit")
    assert "brings its weights" in refused(run, *words)


def test_fitted_weights_must_be_stored(folder, run):
    assert "--no-weights" in refused(run, *EXTRACT, "--fit", "--no-weights")


@pytest.mark.parametrize(
    "words", [("--vertex-weights", "w.txt"), ("--alpha", "1"), ("--beta", "2"), ("--align",)]
)
def test_other_options_of_a_binding_need_a_fit(folder, run, words):
    assert f"{words[0]} is for weights that are fitted; add --fit" in refused(run, *BIND, *words)


def test_a_binding_is_fitted_with_the_solve_that_is_asked_for(folder, run):
    """The same solve gives the weights that extract fits; another gives others."""
    solve = ("--alpha", "0.1", "--beta", "2", "--no-align")
    assert run(*BIND, "--fit", "frames", *solve).code == 0
    assert run(*EXTRACT, "--fit", *solve).code == 0
    assert run(*BIND, "--fit", "frames", "-o", "default.h5").code == 0
    weights = []
    for name in ("binding.h5", "cages.h5", "default.h5"):
        with h5py.File(name) as file:
            weights.append(file["weights"][:])
    np.testing.assert_array_equal(weights[0], weights[1])
    assert np.abs(weights[0] - weights[2]).max() > 1e-6
    assert (
        "\n  fit cages      alpha 0.1, beta 2, not aligned, norm 6\n"
        in run("info", "binding.h5").out
    )
    assert "\n  fit cages      alpha 0.001, beta 1, norm 6\n" in run("info", "default.h5").out


def test_a_fit_is_reported_when_it_is_bound_and_described(folder, run):
    bound = run(*BIND, "--fit", "frames", "--fit-for", "play", "-v")
    assert bound.code == 0, bound.err
    described = run("info", "binding.h5").out
    for text in (bound.err, described):
        for label in ("fit", "fitted frames", "kept aside", "last third", "fitted weights"):
            assert f"\n  {label:<14} " in text, label
        assert "regularization" in text
    assert "\n  tried          regularization 1, smoothness 1: kept aside " in bound.err
    assert "\n  tried " not in described
    run("extract", "frames", "--binding", "binding.h5", "-q")
    assert "fit_regularization auto" in run("info", "cages.h5").out


def test_a_file_of_options_may_ask_for_a_fit(folder, run):
    (folder / "options.toml").write_text(
        '[extract]\nfit = true\nfit-regularization = "auto"\nfit-rank = 2\n'
    )
    outcome = run(*EXTRACT, "--config", "options.toml", "-q")
    assert outcome.code == 0, outcome.err
    with h5py.File("cages.h5") as file:
        settings = json.loads(file.attrs["fit"])["settings"]
    assert settings == asdict(FitSettings(regularization=None, rank=2))


def test_a_file_of_options_without_a_fit_is_wrong_usage(folder, run):
    (folder / "options.toml").write_text("[extract]\nfit-rank = 2\n")
    assert "--fit-rank" in refused(run, *EXTRACT, "--config", "options.toml")


def test_each_clip_of_a_batch_has_its_own_fit(folder, run, write_obj, animation):
    for name, scale in (("walk", 1.0), ("run", 0.5)):
        rest = animation.frames[0]
        for k, frame in enumerate(animation.frames, start=1):
            place = folder / "clips" / name / f"f_{k}.obj"
            write_obj(place, rest + scale * (frame - rest), animation.rest.faces)
    outcome = run("batch", "clips", "--cage", "cage.obj", "-o", "out", "--fit", "--no-pages")
    assert outcome.code == 0, outcome.err
    names = set()
    for name in ("walk", "run"):
        with h5py.File(folder / "out" / "clips" / f"{name}.h5") as file:
            (clip,) = json.loads(file.attrs["fit"])["clips"]
            names.add(clip["sha256"])
    assert len(names) == 2
    entries = json.loads((folder / "out" / "report.json").read_text())["clips"]
    assert all(entry["fit"]["report"]["fitted_frames"] == 5 for entry in entries)
    again = run("batch", "clips", "--cage", "cage.obj", "-o", "out", "--fit", "--no-pages",
                "--resume")  # fmt: skip
    assert again.err.count("unchanged") == 2


def test_a_cage_that_is_built_can_be_fitted(folder, run, coarse_grids):
    outcome = run("extract", "frames", "--fit", "--cage-vertices", "20", "-v")
    assert outcome.code == 0, outcome.err
    assert (
        "\n  strength       chosen; of fewer than 30 distinct frames, it stays smooth"
        in outcome.err
    )


@pytest.mark.parametrize(
    ("words", "fit"),
    [
        ((), None),
        (("--no-fit",), False),
        (("--fit",), FitSettings()),
        (("--fit-smoothness", "2"), FitSettings(smoothness=2)),
    ],
)
@pytest.mark.usefixtures("folder")
def test_a_fit_is_asked_for_refused_or_left_to_the_run(words, fit):
    command = main.commands["extract"]
    with command.make_context("extract", ["frames", *words]) as context:
        assert EXTRACT_OPTIONS.make_record(context.params).fit == fit


def test_options_of_a_fit_are_refused_beside_no_fit(folder, run):
    said = refused(run, "extract", "frames", "--no-fit", "--fit-rank", "3")
    assert "--fit-rank is for weights that are fitted" in said
