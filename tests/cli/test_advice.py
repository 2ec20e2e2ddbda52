"""The step that a first page advises is followed, and the error to the true motion does not rise.

Six clean clips and captured ones of three kinds are extracted in given cages. What is advised is
typed as it is printed, again and again until nothing is.
"""

import re
from pathlib import Path

import numpy as np
import pytest

from cageik_cli.method.weights.binding import reconstruct_frames
from cageik_cli.store.result import load_binding, read_poses, read_result
from tests.corruptions import corrupt
from tests.shapes import ball, changed

TIMES = np.linspace(0, 1, 24)
"""Times of the frames."""


def bend(points, time):
    """Bend about y, by up to a radian at the ends."""
    angle = np.sin(2 * np.pi * time) * points[:, 0]
    x, y, z = points.T
    return np.stack([x * np.cos(angle) - z * np.sin(angle), y, x * np.sin(angle) + z], axis=1)


def twist(points, time):
    """Twist about x, with a bump that wanders."""
    angle = 2 * time * points[:, 0]
    x, y, z = points.T
    return np.stack(
        [x, y * np.cos(angle) - z * np.sin(angle), y * np.sin(angle) + z * np.cos(angle)], axis=1
    )


def squash(points, time):
    """Flatten and stretch, more at the top than at the bottom."""
    share = 1 + 0.4 * np.sin(4 * time) * points[:, 2:]
    return points * np.concatenate([share, share, 1 / share], axis=1)


def swing(points, time):
    """Swing one end to and fro."""
    return points + np.maximum(points[:, :1], 0) ** 2 * [0, np.sin(9 * time), np.cos(9 * time)]


def ripple(points, time):
    """Waves that run along x."""
    return points + 0.1 * np.sin(4 * points[:, :1] - 7 * time) * [0, 0, 1]


def pinch(points, time):
    """Pinch the middle, and let go."""
    share = 1 - 0.5 * np.sin(np.pi * time) * np.exp(-4 * points[:, :1] ** 2)
    return points * np.concatenate([np.ones_like(share), share, share], axis=1)


def hide_wandering_piece(frames):
    """Hide a fifth of each frame but the first in a piece that wanders: gaps of a few frames."""
    seen = frames.copy()
    for k, frame in enumerate(seen[1:], start=1):
        centre = np.array([1.5 * np.cos(0.9 * k), 0.6 * np.sin(1.1 * k), 0])
        distances = np.linalg.norm(BODY.vertices - centre, axis=1)
        frame[np.argsort(distances)[: len(frame) // 5]] = np.nan
    return seen


CLIPS = (bend, twist, squash, swing, ripple, pinch)
BODY = changed(ball(3, 1.0), vertices=ball(3, 1.0).vertices * [1.5, 0.6, 0.6])


@pytest.fixture
def clip(tmp_path, monkeypatch, write_obj, coarse_panels, coarse_grids):
    """Writes a clip of the body and its cage; returns the true frames."""
    monkeypatch.chdir(tmp_path)

    def write(move, corruption=None, cage=1.0):
        frames = np.stack([move(BODY.vertices, time) for time in TIMES])
        frames[0] = BODY.vertices
        if corruption == "gaps":
            seen = hide_wandering_piece(frames)
        else:
            seen = frames if corruption is None else corrupt(corruption, frames)
        np.savez("clip.npz", verts=seen, faces=BODY.faces)
        loose = ball(1, 1.0)
        given = loose.vertices * [2.2, 1, 1]
        write_obj(tmp_path / "cage.obj", cage * given, loose.faces)
        write_obj(tmp_path / "rest.obj", BODY.vertices, BODY.faces)
        return frames

    return write


@pytest.fixture
def measure(run):
    """Extracts with options; returns the true error, and the line `better` ("" without one)."""

    def extract(frames, options, output="cages.h5"):
        outcome = run("extract", "clip.npz", *options, "-o", output, "--overwrite")
        assert outcome.code == 0, outcome.err
        result = read_result(Path(output))
        binding = load_binding(result, "the test")
        rebuilt = [reconstruct_frames(binding, poses) for poses in read_poses(result, 64)]
        error = np.sqrt(((np.concatenate(rebuilt) - frames) ** 2).sum(axis=2).mean())
        text = " ".join(outcome.err.split())
        if " quality good:" in text:
            assert 100 * error / result.rest.diagonal <= 0.75
        found = re.search(r" better (.*?) (?:limits|notes) ", text)
        return 100 * error / result.rest.diagonal, found[1] if found else ""

    return extract


def follow(options, step):
    """The options of the step, as its line says."""
    found = re.fullmatch(
        r"extract again with (.*?)--overwrite(?:, without (--\w+)(?:: a tighter cage is built)?)?"
        r"(?: \([\d.e-]+ % to [\d.e-]+ % on \d+ frames\))?",
        step,
    )
    assert found, step
    words = list(options)
    if found[2]:
        place = words.index(found[2])
        del words[place : place + 2]
    added = found[1].split()
    for k, word in enumerate(words):
        if word in added:  # another number of vertices, or another period
            words[k : k + 2] = []
    return [*words, *added]


def follow_all(measure, frames, options, most=3):
    """Follow what is advised until nothing is; return the steps, and check each error."""
    error, step = measure(frames, options)
    taken = []
    while step and len(taken) < most:
        options = follow(options, step)
        before, (error, after) = error, measure(frames, options)
        assert error <= 1.001 * before, (step, before, error)
        taken.append(step)
        step = after
    return taken


@pytest.mark.parametrize("move", CLIPS)
def test_advice_on_a_clean_clip_does_not_raise_the_true_error(clip, measure, move):
    taken = follow_all(measure, clip(move), ["--cage", "cage.obj"], most=1)
    assert "--fit" in taken[0]
    assert "--robust" not in taken[0]


def slow(*values):
    return pytest.param(*values, marks=pytest.mark.slow)


@pytest.mark.parametrize(
    ("move", "corruption", "first"),
    [
        (bend, "noise", "--fit"),
        (ripple, "outliers", "--robust --fit"),
        (swing, "jitter", "--fit"),
        slow(bend, "patches", "--fit"),
        slow(bend, "outliers", "--robust --fit"),
        slow(bend, "jitter", "--fit"),
        slow(swing, "noise", "--fit"),
        slow(swing, "patches", "--fit"),
        slow(swing, "outliers", "--robust --fit"),
        slow(ripple, "noise", "--fit"),
        slow(ripple, "patches", "--fit"),
        slow(ripple, "jitter", "--fit"),
    ],
)
def test_advice_on_a_captured_clip_does_not_raise_the_true_error(
    clip, measure, move, corruption, first
):
    taken = follow_all(measure, clip(move, corruption), ["--cage", "cage.obj"])
    assert taken[0].startswith(f"extract again with {first} --overwrite (")


@pytest.mark.parametrize("move", [bend, *map(slow, CLIPS[1:])])
@pytest.mark.parametrize("options", [[], slow(["--fit"])])
def test_nothing_that_follows_the_pieces_of_a_torn_surface_is_advised(clip, measure, move, options):
    for step in follow_all(measure, clip(move, "tears"), ["--cage", "cage.obj", *options]):
        assert step.startswith("extract again with --robust --overwrite (")


@pytest.mark.slow
@pytest.mark.parametrize("move", CLIPS)
def test_more_vertices_and_a_built_cage_do_not_raise_the_true_error(clip, measure, move):
    """Of a fitted cage that is too coarse, more vertices are advised until little is missed."""
    taken = follow_all(measure, clip(move), ["--cage", "cage.obj", "--fit"])
    assert all("--cage-vertices" in step for step in taken)


@pytest.mark.parametrize("move", [swing, *map(slow, (bend, ripple))])
def test_a_built_cage_in_place_of_a_loose_one_does_not_raise_the_true_error(clip, measure, move):
    taken = follow_all(measure, clip(move, cage=3.0), ["--cage", "cage.obj"])
    assert any("without --cage" in step for step in taken)


@pytest.mark.parametrize("move", [twist, slow(pinch)])
def test_a_fitted_binding_does_not_raise_the_true_error(clip, measure, run, move):
    frames = clip(move)
    cage = ("--cage", "cage.obj", "--rest", "rest.obj", "--overwrite", "-o", "binding.h5")
    assert run("bind", *cage).code == 0
    before, step = measure(frames, ["--binding", "binding.h5"])
    assert step.startswith("bind again with --fit FRAMES, then extract with that --binding (")
    assert run("bind", *cage, "--fit", "clip.npz").code == 0
    after, _ = measure(frames, ["--binding", "binding.h5"])
    assert after <= before


@pytest.fixture
def fitted(clip, run):
    """Writes a clip, and a binding that is fitted to the true frames; returns the true frames."""

    def write(move, corruption):
        frames = clip(move)
        words = ("--cage", "cage.obj", "--rest", "rest.obj", "--fit", "clip.npz")
        assert run("bind", *words, "-o", "binding.h5").code == 0
        clip(move, corruption)
        return frames

    return write


@pytest.mark.parametrize("move", [bend, *map(slow, CLIPS[1:])])
def test_smoothing_is_advised_where_it_places_what_is_missing(fitted, measure, move):
    frames = fitted(move, "gaps")
    taken = follow_all(measure, frames, ["--binding", "binding.h5", "--missing"])
    assert all(step.startswith("extract again with --smooth auto --overwrite (") for step in taken)
    assert len(taken) <= 1


@pytest.mark.parametrize(
    ("move", "corruption"),
    [(bend, None), (twist, "jitter"), *(slow(swing, one) for one in ("noise", "jitter", "gaps"))],
)
def test_another_period_does_not_raise_the_true_error(fitted, measure, move, corruption):
    frames = fitted(move, corruption)
    options = ["--binding", "binding.h5", "--smooth", "0.6"]
    options += ["--missing"] if corruption == "gaps" else []
    taken = follow_all(measure, frames, options)
    if move is not swing:
        assert (move is bend) == ("--smooth auto" in "".join(taken))
