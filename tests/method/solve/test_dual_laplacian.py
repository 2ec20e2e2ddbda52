import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cageik_cli.cages.bind import bind
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.shape import uniform_laplacian
from cageik_cli.method.solve import dual_laplacian
from cageik_cli.method.solve.alignment import best_rotations, centroids
from cageik_cli.method.solve.dual_laplacian import DualLaplacianSolver
from cageik_cli.method.solve.settings import SolveSettings
from cageik_cli.method.solve.vertex_weights import normalize_weights
from cageik_cli.method.weights.binding import Binding
from cageik_cli.util.errors import FormatError, NumericalError, SettingError
from tests.shapes import ball, concave, finer, inside, octahedron, rotation

CAGE = finer(concave(), 1)


@pytest.fixture(scope="module")
def binding():
    """A cloud of 200 points in an L-shaped cage of 42 vertices; its faces do not matter here."""
    points = inside(concave(), 200, margin=0.01)
    faces = np.arange(201).reshape(-1, 3) % 200
    return bind(TriMesh(points, faces), CAGE)


def bent(points, amount):
    """A smooth motion that no cage reproduces exactly."""
    x, y, z = points.T
    return np.column_stack([x + amount * y * z, y + amount * np.sin(2 * x), z * (1 + amount * x)])


def clip(binding, count=5):
    rest = binding.rest.vertices
    return np.stack([bent(rest, 0.1 * k) @ rotation(k).T + [k, 0, -k] for k in range(count)])


@pytest.mark.parametrize("align", [True, False])
@pytest.mark.parametrize("alpha", [1e-3, 1.0])
def test_every_cage_is_the_least_squares_solution_of_the_stacked_system(binding, align, alpha):
    """Oracle: numpy's lstsq on the rows of both terms, frame by frame."""
    weights, (m, n) = binding.weights, binding.weights.shape
    beta, counts = 0.7, np.linspace(0.5, 1.5, m)
    settings_ = SolveSettings(alpha, beta, align)
    frames = clip(binding)
    solution = DualLaplacianSolver(binding, settings_, counts).solve(frames)
    origin = counts @ binding.rest.vertices / m
    centres = centroids(frames, counts)
    centred = frames - centres[:, None]
    turns = best_rotations(centred, binding.rest.vertices - origin, counts)
    laplacian = np.sqrt(alpha / n) * uniform_laplacian(binding.cage)
    scale = np.sqrt(beta / m * counts)[:, None]
    for k, frame in enumerate(frames):
        at_rest = centred[k] @ turns[k].T + origin if align else frame
        rows = np.vstack([laplacian, scale * weights])
        right = np.vstack([laplacian @ binding.cage.vertices, scale * at_rest])
        cage = np.linalg.lstsq(rows, right, rcond=None)[0]
        if align:
            cage = (cage - origin) @ turns[k] + centres[k]
        np.testing.assert_allclose(solution.cages[k], cage, atol=1e-10)
        np.testing.assert_allclose(solution.reconstructions[k], weights @ cage, atol=1e-10)


def test_the_cages_are_those_of_the_paper_with_its_alpha_and_delta_turned(binding):
    """Its sums are not means, and its δ stays that of the rest pose where the mesh turns."""
    (m, n), frames, alpha, beta = binding.weights.shape, clip(binding), 0.3, 0.7
    frames = frames @ rotation(5)
    solver = DualLaplacianSolver(binding, SolveSettings(alpha, beta))
    solution = solver.solve(frames)
    laplacian = np.sqrt(alpha * m / (beta * n)) * uniform_laplacian(binding.cage)
    rows, delta = np.vstack([laplacian, binding.weights]), laplacian @ binding.cage.vertices
    for frame, cage, turn in zip(frames, solution.cages, solution.rotations, strict=True):
        right = np.vstack([delta @ turn, frame])
        paper = np.linalg.lstsq(rows, right, rcond=None)[0]
        np.testing.assert_allclose(cage, paper, rtol=0, atol=1e-10)
        unturned = np.linalg.lstsq(rows, np.vstack([delta, frame]), rcond=None)[0]
        assert np.abs(cage - unturned).max() > 0.1


def test_a_frame_does_not_depend_on_those_before_it(binding):
    frames = clip(binding)
    solver = DualLaplacianSolver(binding, SolveSettings())
    forward, backward = (solver.solve(one).cages for one in (frames, frames[::-1]))
    np.testing.assert_allclose(forward, backward[::-1], rtol=0, atol=1e-12)


@pytest.mark.parametrize("align", [True, False])
def test_frames_made_from_known_cages_give_them_back(binding, align):
    generator = np.random.default_rng(7)
    cages = CAGE.vertices + 0.2 * generator.normal(size=(4, *CAGE.vertices.shape))
    solver = DualLaplacianSolver(binding, SolveSettings(alpha=0, align=align))
    found = solver.solve(binding.weights @ cages).cages
    np.testing.assert_allclose(found, cages, atol=1e-10 * binding.rest.diagonal)


def test_the_rest_pose_gives_the_rest_cage(binding):
    solver = DualLaplacianSolver(binding, SolveSettings())
    found = solver.solve(binding.rest.vertices[None]).cages[0]
    np.testing.assert_allclose(found, binding.cage.vertices, atol=1e-13)


def test_frames_moved_rigidly_give_cages_moved_rigidly(binding):
    solver, frames = DualLaplacianSolver(binding, SolveSettings()), clip(binding)
    cages = solver.solve(frames).cages
    for k, frame in enumerate(frames):
        turn, shift = rotation(50 + k), np.array([100.0, -k, 7])
        moved = solver.solve((frame @ turn.T + shift)[None]).cages[0]
        np.testing.assert_allclose(moved, cages[k] @ turn.T + shift, atol=1e-11)


def test_without_alignment_a_rotation_costs_accuracy(binding):
    """The check above must be able to fail: without alignment it does."""
    solver = DualLaplacianSolver(binding, SolveSettings(alpha=0.1, align=False))
    rest, turn = binding.rest.vertices, rotation(3)
    moved = solver.solve((rest @ turn.T)[None]).cages[0]
    assert np.abs(moved - binding.cage.vertices @ turn.T).max() > 1e-3


@settings(max_examples=20)
@given(st.floats(1e-3, 1e4))
def test_scaled_input_gives_scaled_cages(binding, scale):
    scaled = Binding(
        TriMesh(scale * binding.rest.vertices, binding.rest.faces),
        TriMesh(scale * CAGE.vertices, CAGE.faces),
        binding.weights,
    )
    frames = clip(binding)
    cages = DualLaplacianSolver(binding, SolveSettings()).solve(frames).cages
    found = DualLaplacianSolver(scaled, SolveSettings()).solve(scale * frames).cages
    np.testing.assert_allclose(found / scale, cages, atol=1e-11)


@settings(max_examples=20)
@given(st.integers(0, 1000))
def test_permuted_vertices_give_the_same_cages(binding, seed):
    order = np.random.default_rng(seed).permutation(len(binding.rest.vertices))
    permuted = Binding(
        TriMesh(binding.rest.vertices[order], binding.rest.faces), CAGE, binding.weights[order]
    )
    frames = clip(binding, 2)
    expected = DualLaplacianSolver(binding, SolveSettings()).solve(frames).cages
    found = DualLaplacianSolver(permuted, SolveSettings()).solve(frames[:, order]).cages
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_cages_do_not_depend_on_blocks(binding):
    solver, frames = DualLaplacianSolver(binding, SolveSettings()), clip(binding)
    one_by_one = [solver.solve(frame[None]).cages[0] for frame in frames]
    np.testing.assert_allclose(solver.solve(frames).cages, one_by_one, atol=1e-13)


def test_alpha_trades_fit_for_smoothness(binding):
    """More α: the cage's Laplacian nearer that of rest, the vertices further from the frame."""
    frames, rows = clip(binding)[4:], uniform_laplacian(binding.cage)
    rough, far = [], []
    for alpha in (1e-4, 1e-2, 1.0):
        solution = DualLaplacianSolver(binding, SolveSettings(alpha, align=False)).solve(frames)
        rough.append(np.linalg.norm(rows @ (solution.cages[0] - CAGE.vertices)))
        far.append(np.linalg.norm(solution.reconstructions - frames))
    assert rough[0] > rough[1] > rough[2]
    assert far[0] < far[1] < far[2]


def test_condition_number_is_that_of_the_normal_matrix(binding):
    solver = DualLaplacianSolver(binding, SolveSettings(alpha=0.5, beta=2))
    (m, n), rows = binding.weights.shape, uniform_laplacian(CAGE)
    normal = 0.5 / n * rows.T @ rows + 2 / m * binding.weights.T @ binding.weights
    assert solver.quality.condition_number == pytest.approx(np.linalg.cond(normal), rel=1e-8)


def nearly_singular(spread):
    """A binding whose first two cage vertices the model tells apart by no more than `spread`."""
    generator = np.random.default_rng(0)
    weights = generator.dirichlet(np.ones(6), 300)
    together, apart = weights[:, :2].sum(axis=1), generator.uniform(-1, 1, 300)
    weights[:, 0], weights[:, 1] = together / 2 + spread * apart, together / 2 - spread * apart
    cage = octahedron()
    return Binding(TriMesh(weights @ cage.vertices, np.arange(300).reshape(-1, 3)), cage, weights)


def test_refinement_recovers_digits(monkeypatch):
    binding = nearly_singular(1e-5)
    cages = octahedron().vertices + np.random.default_rng(1).normal(size=(3, 6, 3))
    frames = binding.weights @ cages

    def error(refined_above):
        monkeypatch.setattr(dual_laplacian, "MIN_REFINED_CONDITION", refined_above)
        solver = DualLaplacianSolver(binding, SolveSettings(alpha=0, align=False))
        assert 1e8 < solver.quality.condition_number < 1e12
        return np.abs(solver.solve(frames).cages - cages).max()

    refined, plain = error(1e6), error(np.inf)
    assert refined < 1e-10
    assert plain > 100 * refined


@pytest.mark.parametrize("spread", [1e-7, 0.0])
def test_a_singular_system_is_refused_with_the_remedy(spread):
    binding = nearly_singular(spread)
    with pytest.raises(NumericalError, match=r"condition number .* limit 1e\+12.* raise `alpha"):
        DualLaplacianSolver(binding, SolveSettings(alpha=0))
    assert DualLaplacianSolver(binding, SolveSettings()).quality.condition_number < 1e6


def test_fewer_vertices_than_the_cage_has_are_refused_with_the_remedy(binding):
    """Vertices of weight 0 do not count; the Laplacian alone makes the system regular."""
    m, n = binding.weights.shape
    few = normalize_weights((np.arange(m) < n - 1).astype(float), m)
    says = rf"{n - 1} vertices that are data .* {n} cage vertices: raise `alpha.*at most {n - 1} "
    with pytest.raises(NumericalError, match=says):
        DualLaplacianSolver(binding, SolveSettings(alpha=0), few)
    DualLaplacianSolver(binding, SolveSettings(), few)
    DualLaplacianSolver(binding, SolveSettings(alpha=0))


def test_a_vertex_of_weight_zero_is_missing_data(binding):
    counts = np.ones(len(binding.rest.vertices))
    counts[[3, 17]] = 0
    solver = DualLaplacianSolver(binding, SolveSettings(), counts)
    frames, spoilt = clip(binding), clip(binding)
    spoilt[:, [3, 17]] = 1e3
    np.testing.assert_allclose(solver.solve(spoilt).cages, solver.solve(frames).cages, atol=1e-12)
    assert 3 not in solver.data_vertices
    assert len(solver.data_vertices) == len(counts) - 2


def test_vertex_weights_have_mean_one():
    np.testing.assert_allclose(normalize_weights(np.array([1.0, 3.0]), 2), [0.5, 1.5])
    for scale in (1e308, 1e-320):
        weights = np.array([scale, 0, scale])
        np.testing.assert_allclose(normalize_weights(weights, 3), [1.5, 0, 1.5])


@pytest.mark.parametrize(
    ("weights", "says"),
    [
        ([1.0, 2.0], "the model has 3 vertices"),
        ([1.0, -1.0, 2.0], "weight of vertex 1 is -1.0"),
        ([1.0, 1.0, np.nan], "weight of vertex 2 is nan"),
        ([0.0, 0.0, 0.0], "all vertex weights are zero"),
    ],
)
def test_bad_vertex_weights_are_refused(weights, says):
    with pytest.raises(FormatError, match=says):
        normalize_weights(np.array(weights), 3)


@pytest.mark.parametrize(
    ("alpha", "beta", "says"),
    [
        (-1.0, 1.0, "`alpha=` is -1.0"),
        (np.nan, 1.0, "`alpha=` is nan"),
        (1.0, np.inf, "`beta=` is inf"),
        (0.0, 0.0, "alpha and beta are both 0"),
    ],
)
def test_invalid_settings_are_refused(alpha, beta, says):
    with pytest.raises(SettingError, match=says):
        SolveSettings(alpha, beta)


def test_without_vertices_translation_is_free():
    binding = bind(ball(1), concave_around_ball())
    with pytest.raises(NumericalError, match=r"singular.*raise `beta=` above 0"):
        DualLaplacianSolver(binding, SolveSettings(alpha=1, beta=0))


@pytest.mark.parametrize("alpha", [1e14, 1e200, 1e308])
def test_a_laplacian_that_outweighs_the_vertices_is_refused_with_the_remedy(binding, alpha):
    with pytest.raises(NumericalError, match=r"singular.*lower `alpha"):
        DualLaplacianSolver(binding, SolveSettings(alpha=alpha))
    assert DualLaplacianSolver(binding, SolveSettings()).quality.condition_number < 1e6


@pytest.mark.parametrize("scale", [1e-310, 1e-200, 1e200, 1e307])
def test_only_the_ratio_of_alpha_and_beta_matters(binding, scale):
    frames = clip(binding, 2)
    found = DualLaplacianSolver(binding, SolveSettings(0.1 * scale, scale)).solve(frames).cages
    expected = DualLaplacianSolver(binding, SolveSettings(0.1, 1.0)).solve(frames).cages
    np.testing.assert_allclose(found, expected, rtol=1e-8)


def concave_around_ball():
    return TriMesh(2 * (concave().vertices - [0.5, 0.5, 0.5]), concave().faces)
