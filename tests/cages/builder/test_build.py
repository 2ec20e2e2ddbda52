import itertools

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from cageik_cli.cages.builder import build as build_module
from cageik_cli.cages.builder.build import SHELL_CANDIDATES, BuiltCage, Candidate, Clip, build_cage
from cageik_cli.cages.builder.judge import Verdict
from cageik_cli.cages.builder.loops import NO_LOOPS
from cageik_cli.cages.builder.shell import Shell
from cageik_cli.cages.check.diagnosis import diagnose
from cageik_cli.cages.settings import BuildSettings
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.util.errors import FormatError, NumericalError
from tests.cages.independent import examine
from tests.cages.torture import FAST, PIECES, SLOW, torus
from tests.shapes import ball, box, changed, concave, finer, merged, moved
from tests.texts import texts


def assert_good(cage, model, count, clearance=0.004):
    opinion = examine(cage, model, clearance, points=4000)
    assert opinion.faults == ()
    assert 0.9 * count <= len(cage.vertices) <= count
    return opinion


MARKS = {"octahedron": (), "far from the origin": pytest.mark.slow}
"""The odd models that the tests try; `make fuzz` tries all."""


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=MARKS.get(name, pytest.mark.fuzz)) for name in FAST]
)
def test_an_odd_model_gets_a_cage(name):
    model, count = FAST[name](), 16 if name == "octahedron" else 40
    built = build_cage(model, BuildSettings(vertices=count))
    opinion = assert_good(built.cage, model, count)
    assert opinion.smallest_angle > 2


@pytest.mark.fuzz
@pytest.mark.parametrize("name", SLOW)
def test_a_hard_model_gets_a_cage(name):
    model = SLOW[name]()
    built = build_cage(model, BuildSettings(vertices=100))
    assert_good(built.cage, model, 100)


MOST_CANDIDATES = {"20 boxes": 8, "soup of 72 small triangles": 8}
"""Of models in pieces whose shells fail by few faces; of the others, no more than 6 are tried."""


@pytest.mark.slow
@pytest.mark.parametrize("name", PIECES)
def test_a_model_in_pieces_gets_a_cage_of_few_candidates(name):
    model = PIECES[name]()
    built = build_cage(model, BuildSettings(vertices=100))
    assert_good(built.cage, model, 100)
    assert len(built.candidates) <= MOST_CANDIDATES.get(name, 6)
    assert np.isfinite(built.chosen.offset)


def try_all_shells(monkeypatch, *, count, genus=0):
    """The places in the ladder of the shells that are tried, of cages that are never sound."""
    tried, none = [], np.empty((0, 3))

    def make_shell(_, offset, closing):
        tried.append(SHELL_CANDIDATES.index((offset, closing)))
        return Shell(ball(1), none, none, none)

    verdict = Verdict(("crosses itself",), genus, 0.0, 20.0, 6, 0.01)
    patched = {
        "make_shell": make_shell,
        "refine_shell": lambda *_, **__: (ball(1), NO_LOOPS),
        "wrap_ellipsoid": lambda *_: ball(1),
        "judge": lambda *_: verdict,
    }
    for name, function in patched.items():
        monkeypatch.setattr(build_module, name, function)
    monkeypatch.setattr(build_module, "DistanceGrid", lambda *_: None)
    with pytest.raises(NumericalError, match="no cage passes the tests"):
        build_cage(box(), BuildSettings(vertices=count))
    return tried


@pytest.mark.parametrize("wrong", [{"count": 16}, {"count": 18, "genus": 3}])
def test_shells_that_are_hardly_looser_than_one_that_tangled_or_has_holes_are_not_tried(
    monkeypatch, wrong
):
    assert try_all_shells(monkeypatch, **wrong) == [0, 2, 4, 5, 6, 7]


@pytest.mark.parametrize("genus", [0, 2])
def test_all_shells_are_tried_if_few_faces_cross_and_there_are_few_holes(monkeypatch, genus):
    assert try_all_shells(monkeypatch, count=18, genus=genus) == list(range(8))


@pytest.mark.slow
def test_a_built_cage_is_found_fit_by_the_check_that_users_run():
    built = build_cage(ball(4), BuildSettings(vertices=60))
    assert diagnose(built.cage, ball(4)).verdict == "fit"
    assert built.chosen.verdict.smallest_angle >= 10
    assert built.chosen.verdict.largest_valence <= 10


@pytest.mark.slow
@pytest.mark.parametrize("name", ["tube", "torus"])
def test_a_round_model_gets_a_tight_cage(name):
    """A prism of eight sides around a circle has 1.06 times its area, the clearance adds 0.06."""
    model = torus() if name == "torus" else make_tube()
    built = build_cage(model, BuildSettings(vertices=60))
    assert built.cage.volume <= 1.35 * model.volume
    assert built.chosen.is_flawless


def make_tube():
    """Make a closed tube, four times as long as it is wide."""
    square = finer(box(), 4)
    x, y, z = square.vertices.T
    round_off = np.maximum(np.abs(x), np.abs(y)) / np.maximum(np.hypot(x, y), 1e-9)
    return changed(square, vertices=np.stack([x * round_off, y * round_off, 4 * z], axis=1))


@pytest.mark.slow
def test_a_model_in_another_order_turned_and_scaled_gets_the_same_cage():
    model = finer(concave(), 2)
    order = np.random.default_rng(3).permutation(len(model.vertices))
    turn = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
    other = TriMesh(0.01 * model.vertices[order] @ turn.T + 5, np.argsort(order)[model.faces])
    first, second = (build_cage(m, BuildSettings(vertices=30)).cage for m in (model, other))
    back = (second.vertices - 5) @ turn / 0.01
    np.testing.assert_allclose(back, first.vertices, rtol=0, atol=1e-3 * model.diagonal)
    np.testing.assert_array_equal(second.faces, first.faces)


@pytest.mark.slow
def test_the_same_model_gives_the_same_cage_to_the_last_bit():
    first, second = (build_cage(concave(), BuildSettings(vertices=30)).cage for _ in range(2))
    np.testing.assert_array_equal(first.vertices, second.vertices)
    np.testing.assert_array_equal(first.faces, second.faces)


@pytest.mark.parametrize("clearance", [0.001, 0.03])
@pytest.mark.slow
def test_the_clearance_is_the_one_that_was_asked_for(clearance):
    model = finer(concave(), 2)
    built = build_cage(model, BuildSettings(vertices=50, clearance=clearance))
    assert_good(built.cage, model, 50, clearance)


@pytest.mark.slow
def test_parts_that_were_joined_are_named_with_their_place():
    model = merged(ball(3), moved(ball(3), (8, 0, 0)))
    built = build_cage(moved(model, (100, 0, 0)), BuildSettings(vertices=50))
    (note,) = (note for note in texts(built.notes) if "apart were joined" in note)
    assert "(1), at (104, " in note


def make_wedge():
    """A body whose only plane of symmetry is z = 0, without the corners that boxes share."""
    model = moved(finer(concave(), 2), (0, 0, -0.5))
    x, y, z = model.vertices.T
    return changed(model, vertices=np.stack([x, 1.3 * y + 0.2 * x, z], axis=1))


@pytest.mark.slow
@pytest.mark.parametrize(("turn", "quads"), [(None, False), (5, False), (5, True)])
def test_a_symmetric_model_gets_a_cage_that_is_its_own_mirror_image(turn, quads, monkeypatch):
    """To the last bit about a coordinate plane, else up to rounding."""
    monkeypatch.setattr(build_module, "SHELL_CANDIDATES", ((0.03, 0.06),))
    model = moved(make_wedge(), turn=turn)
    built = build_cage(model, BuildSettings(vertices=20, symmetric="auto", quads=quads))
    assert_good(built.cage, model, 20)
    assert (built.cage.polygons.corner_counts == 4).any() == quads
    assert diagnose(built.cage, model).verdict == "fit"
    assert built.mirror is not None
    assert built.mirror.mirrors_polygons(built.cage)
    tolerance = 0 if turn is None else 1e-14
    assert built.mirror.find_pairs(built.cage.vertices, tolerance) is not None


@pytest.mark.slow
def test_a_cage_about_a_plane_that_is_stated_holds_any_model_and_one_for_a_clip_too(monkeypatch):
    monkeypatch.setattr(build_module, "SHELL_CANDIDATES", ((0.03, 0.06),))
    model = moved(make_wedge(), turn=2)
    clip = Clip(model.vertices[None] * [1, 1, 1.1], lambda cage: cage.volume)
    built = build_cage(model, BuildSettings(vertices=20, symmetric="y"), clip)
    assert_good(built.cage, model, 20)
    assert built.mirror is not None
    assert built.mirror.mirrors_polygons(built.cage)
    assert built.chosen.error == built.cage.volume


@pytest.mark.slow
def test_a_cage_that_cannot_be_symmetric_is_not_and_says_so(monkeypatch):
    """The shell of the symmetric cage is handed out as it is, with too many vertices."""
    refine = build_module.refine_shell
    monkeypatch.setattr(build_module, "SHELL_CANDIDATES", ((0.03, 0.06),))

    def leave_symmetric_shells(shell, demand, motion, **wanted):
        if demand.axis is None:
            return refine(shell, demand, motion, **wanted)
        return shell, NO_LOOPS

    monkeypatch.setattr(build_module, "refine_shell", leave_symmetric_shells)
    built = build_cage(make_wedge(), BuildSettings(vertices=20, symmetric="auto"))
    assert built.mirror is None
    assert built.chosen.verdict.is_valid
    assert "symmetric about the plane z = 0" in texts(built.notes)[0]


@pytest.mark.slow
@pytest.mark.parametrize("symmetric", ["off", "z"])
def test_a_flat_model_gets_a_cage_of_the_tightest_shell(symmetric):
    """Both sheets of the cage are pushed off it at once, and do not follow each other."""
    triangle = TriMesh([[0, 0, 0], [1, 0, 0], [0.5, 0.7, 0]], [[0, 1, 2]])
    built = build_cage(triangle, BuildSettings(60, symmetric=symmetric))
    assert [candidate.offset for candidate in built.candidates] == [SHELL_CANDIDATES[0][0]]
    assert built.chosen.verdict.faults == ()


def make_bent_rod(levels):
    """A rod, and a pose in which it is bent."""
    rod = finer(changed(box(), vertices=box().vertices * [0.2, 0.2, 1]), levels)
    x, y, z = rod.vertices.T
    return rod, np.stack([x + 0.3 * np.maximum(z, 0) ** 2, y, z], axis=1)


@pytest.mark.slow
def test_the_number_of_processes_does_not_change_the_cages(monkeypatch):
    monkeypatch.setattr(build_module, "COARSE_GRID", (0.03, 0.13))
    monkeypatch.setattr(build_module, "SHELL_CANDIDATES", ((0.04, 0.08), (0.05, 0.08)))
    model, bent = make_bent_rod(2)
    clip = Clip(bent[None], lambda cage: cage.volume)
    one, two = (
        build_cage(model, BuildSettings(20), clip, processes=count).candidates for count in (1, 2)
    )
    assert [candidate.recipe for candidate in one] == [candidate.recipe for candidate in two]
    assert sum("shifted" in candidate.recipe for candidate in two) == 2
    for first, second in zip(one, two, strict=True):
        assert first.cage.vertices.tobytes() == second.cage.vertices.tobytes()
        assert first.cage.faces.tobytes() == second.cage.faces.tobytes()


@pytest.mark.slow
def test_a_process_that_fails_is_named(monkeypatch):
    def fail_and_call(function, calls, processes, note):
        note(f"one of {processes} has failed")
        return itertools.starmap(function, calls)

    monkeypatch.setattr(build_module, "COARSE_GRID", (0.03, 0.13))
    monkeypatch.setattr(build_module, "SHELL_CANDIDATES", ((0.04, 0.08), (0.05, 0.08)))
    monkeypatch.setattr(build_module, "call_in_subprocesses", fail_and_call)
    model, bent = make_bent_rod(2)
    notes = []
    clip = Clip(bent[None], lambda cage: cage.volume)
    build_cage(model, BuildSettings(20), clip, processes=2, note=notes.append)
    assert notes == ["one of 2 has failed"]


@pytest.mark.slow
def test_the_candidate_of_the_least_error_is_taken_for_a_clip():
    model, bent = make_bent_rod(4)
    volumes = []

    def measure(cage):
        volumes.append(cage.volume)
        return cage.volume

    built = build_cage(model, BuildSettings(vertices=40), Clip(bent[None], measure))
    assert_good(built.cage, model, 40)
    assert built.cage.volume == min(volumes)
    assert {c.error for c in built.candidates if c.verdict.is_valid} == set(volumes)


@pytest.fixture(scope="module")
def looser():
    """A cage for a clip for which tight shells fail, what progress told, and threads of sums."""
    make_shell, told, threads = build_module.make_shell, [], set()

    def measure(cage):
        threads.update(lib["num_threads"] for lib in threadpool_info() if lib["user_api"] == "blas")
        return 1.0

    with pytest.MonkeyPatch.context() as patch, threadpool_limits(2, user_api="blas"):
        patch.setattr(build_module, "COARSE_GRID", (0.03, 0.13))
        patch.setattr(build_module, "SHELL_CANDIDATES", ((0.03, 0.04), (0.04, 0.08)))
        patch.setattr(build_module, "MAX_SHIFTED", 0)
        patch.setattr(
            build_module, "make_shell", lambda *a: None if a[1] == 0.03 else make_shell(*a)
        )
        clip = Clip(ball(3).vertices[None], measure)
        settings = BuildSettings(vertices=30)
        built = build_cage(ball(3), settings, clip, lambda *done: told.append(done))
    return built, told, threads


def test_looser_shells_are_tried_for_a_clip_when_the_tight_ones_fail(looser):
    assert looser[0].chosen.recipe == "shell 4 % closed by 8 %"


def test_every_candidate_is_kept_and_counted(looser):
    built, told, _ = looser
    assert told[-1][0] == told[-1][1]
    assert built.chosen in built.candidates
    assert all(candidate.recipe for candidate in built.candidates)


def test_the_number_of_threads_does_not_change_sums(looser):
    """Products of several threads are rounded otherwise: every choice is made with one."""
    assert looser[2] == {1}


def make_candidate(angle=20.0, genus=0, joined_holes=0, faults=(), **values):
    verdict = Verdict(faults, genus, 0.004, angle, 8, 0.01)
    values = {"offset": 0.01, "error": None, **values}
    return Candidate("a shell", box(), verdict, joined_holes=joined_holes, **values)


def test_a_hole_of_the_model_itself_is_no_flaw():
    ring, joined = (make_candidate(genus=1, joined_holes=holes) for holes in (0, 1))
    assert ring.is_flawless
    assert not joined.is_flawless
    assert ring.cost < joined.cost
    assert not make_candidate(angle=9.0).is_flawless
    assert not make_candidate(faults=("is open",)).is_flawless


@pytest.mark.parametrize(
    ("chosen", "words"),
    [
        ({}, "whose cage has good angles"),
        ({"angle": 6.0}, "counted against it"),
        ({"error": 0.5, "angle": 6.0}, "smallest error"),
        ({"offset": np.inf}, "no shell"),
    ],
)
def test_a_choice_has_its_reason(chosen, words):
    best = make_candidate(**chosen)
    assert words in BuiltCage(box(), best, (best,), ()).reason


def build_quads(monkeypatch, cage_of):
    """A cage for which quads are wanted, in a build that takes a ready one for each shell."""
    patched = {
        "refine_shell": lambda _, demand, __, **___: (
            TriMesh(demand.frame.to_units(ball(1, 1.5).vertices), ball(1).faces),
            NO_LOOPS,
        ),
        "make_quads": cage_of,
    }
    for name, function in patched.items():
        monkeypatch.setattr(build_module, name, function)
    return build_cage(ball(3), BuildSettings(vertices=len(ball(1).vertices), quads=True))


def test_few_quads_are_noted(monkeypatch, coarse_grids):
    built = build_quads(monkeypatch, lambda cage, *_: cage)
    (note,) = (note for note in texts(built.notes) if "quads" in note)
    assert note.startswith("0 % of the faces are quads, expected 70 % or more")
    assert built.chosen.recipe.endswith(", quads")


def test_triangles_are_kept_if_the_quads_are_not_valid(monkeypatch, coarse_grids):
    built = build_quads(monkeypatch, lambda cage, *_: cage.flip())
    assert not built.chosen.recipe.endswith(", quads")
    assert "this one is of triangles" in texts(built.notes)[-1]
    assert built.candidates[-1].recipe.endswith(", quads")


def test_a_hole_around_a_closed_model_is_one_between_parts_also_without_a_web(
    monkeypatch, coarse_grids
):
    ring, none = torus(1.0, 0.3, 10, 6), np.empty((0, 3))
    patched = {
        "make_shell": lambda *_: Shell(ring, none, none, none),
        "refine_shell": lambda _, demand, __, **___: (
            ring.move(demand.frame.to_units(ring.vertices)),
            NO_LOOPS,
        ),
        "replace_weak_vertices": lambda cage, *_: cage,
    }
    for name, function in patched.items():
        monkeypatch.setattr(build_module, name, function)
    model = moved(ball(2), (1, 0, 0), 0.2)
    built = build_cage(model, BuildSettings(vertices=len(ring.vertices)))
    assert [candidate.joined_holes for candidate in built.candidates] == [1]
    assert any(note.endswith("touch and move together (1)") for note in texts(built.notes))
    opened = TriMesh(model.vertices, model.faces[1:])
    assert build_cage(opened, BuildSettings(vertices=len(ring.vertices))).chosen.joined_holes == 0


def test_a_model_that_is_one_point_is_refused():
    with pytest.raises(FormatError, match="the model is one point, expected a surface"):
        build_cage(TriMesh(np.ones((3, 3)), [[0, 1, 2]]))


def test_positions_that_are_no_numbers_are_refused():
    with pytest.raises(FormatError, match="vertex 1 is \\(nan, 1, 1\\)"):
        build_cage(TriMesh([[0, 0, 0], [np.nan, 1, 1], [1, 0, 0]], [[0, 1, 2]]))


def test_the_hole_of_a_torus_is_not_said_to_be_where_parts_touch():
    turn = 2 * np.pi * np.arange(24) / 24
    around, across = np.meshgrid(turn, turn[::3], indexing="ij")
    radius = 1 + 0.3 * np.cos(across)
    rows = [radius * np.cos(around), radius * np.sin(around), 0.3 * np.sin(across)]
    first, second = np.divmod(np.arange(24 * 8), 8)
    right, up = 8 * ((first + 1) % 24), (second + 1) % 8
    corners = [8 * first + second, right + second, right + up, 8 * first + up]
    faces = np.concatenate(
        [np.stack([corners[k] for k in t], axis=1) for t in [(0, 1, 2), (0, 2, 3)]]
    )
    torus = TriMesh(np.stack([row.ravel() for row in rows], axis=1), faces)
    built = build_cage(torus, BuildSettings(vertices=40))
    assert diagnose(built.cage).cage.genus == 1
    assert not [note for note in texts(built.notes) if "touch" in note]
