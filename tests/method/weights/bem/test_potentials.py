import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from cageik_cli.method.weights.bem import potentials as module
from cageik_cli.method.weights.bem.boundary_mesh import BoundaryMesh
from cageik_cli.method.weights.bem.panels import (
    CLOSED_ANGLE_TOL,
    EDGE_ON_TOL,
    LINEAR_TERMS,
    MIN_GAP_RATIO,
    NEAR_EDGE_RATIO,
    monomials,
    orthogonal_basis,
)
from cageik_cli.method.weights.bem.potentials import FADE_FACTOR, compute_potentials
from cageik_cli.util import compiled
from tests.method.weights.bem import derive_functions
from tests.shapes import ball, box, concave, inside

needs_core = pytest.mark.skipif(compiled.kernel is None, reason="the core was not compiled")

FAR = 1e3
"""A reach at which nothing has faded out."""


def raised(mesh, order, reach):
    """The panels of a surface, some with densities of higher order."""
    panels = np.array([0, 3, 5, 11, len(mesh.faces) - 1])
    return BoundaryMesh.from_cage(mesh).raise_order(panels, np.full(5, order), np.full(5, reach))


def copied(mesh, points, *, is_inside=True):
    """The potentials, out of the workspace."""
    found = compute_potentials(mesh, points, is_inside=is_inside)
    return [np.array(part) for part in (found.linear, found.higher, found.double)]


def by_both(mesh, points, monkeypatch, *, is_inside):
    """The potentials of the compiled body and of the one in Python."""
    if compiled.kernel is None:
        pytest.skip("the core was not compiled")
    found = copied(mesh, points, is_inside=is_inside)
    monkeypatch.setattr(compiled, "kernel", None)
    return zip(found, copied(mesh, points, is_inside=is_inside), strict=True)


def test_linear_potentials_equal_quadrature(seen, core):
    _, points, _, barycentric, single, _ = seen
    mesh = BoundaryMesh.from_cage(concave())
    expected = np.einsum("pqg,dg->dpq", single, monomials(1, barycentric))
    np.testing.assert_allclose(
        copied(mesh, points)[0], expected.reshape(-1, len(points)), rtol=1e-9, atol=1e-10
    )


def test_the_double_layer_of_hats_equals_quadrature(seen, core):
    panels, points, _, barycentric, _, double = seen
    mesh = BoundaryMesh.from_cage(concave())
    of_corners = np.einsum("pqg,gk->pkq", double, barycentric)
    expected = np.zeros((len(panels.vertices), len(points)))
    np.add.at(expected, panels.corners, of_corners)
    np.testing.assert_allclose(copied(mesh, points)[2], expected, rtol=1e-9, atol=1e-10)


@pytest.mark.parametrize(("order", "digits"), [(2, 1e-11), (3, 1e-10), (4, 1e-8), (5, 1e-6)])
def test_higher_potentials_equal_quadrature(seen, core, order, digits):
    _, points, _, barycentric, single, _ = seen
    mesh = raised(concave(), order, FAR)
    polynomials = orthogonal_basis(order)[LINEAR_TERMS:] @ monomials(order, barycentric)
    expected = np.einsum("pqg,dg->dpq", single[mesh.high_panels, :7], polynomials)
    found = copied(mesh, points[:7])[1]
    np.testing.assert_allclose(found, expected, rtol=0, atol=digits)


def test_higher_potentials_fade_out(core):
    """Full at reach / 1.25, half at the reach, none from 1.25 times it."""
    mesh = concave()
    centre = mesh.vertices[mesh.faces[0]].mean(axis=0)
    points = np.array([[2.0, 1, 3], [-1, -2, 2]])
    for share, strength in ((0.7, 1.0), (0.8, 1.0), (1.25, 0.0), (1.3, 0.0)):
        for point in points:
            reach = np.linalg.norm(point - centre) / share
            near, full = raised(mesh, 3, reach), raised(mesh, 3, FAR)
            expected = strength * copied(full, point[None], is_inside=False)[1][:, 0]
            found = compute_potentials(near, point[None], is_inside=False)
            at = np.flatnonzero(found.near_panels == 0)
            faded = found.higher[:, at[0]] if len(at) else np.zeros_like(expected)
            np.testing.assert_allclose(faded, expected, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("mesh", [box(), concave(), ball(2)], ids=["box", "concave", "ball"])
def test_double_layers_sum_to_4_pi_inside_and_0_outside(mesh, core):
    points = inside(mesh, 50)
    closed = BoundaryMesh.from_cage(mesh)
    sums = copied(closed, points)[2].sum(axis=0)
    np.testing.assert_allclose(sums, 4 * np.pi, rtol=2e-15)
    outside = copied(closed, points + 3 * mesh.diagonal)[2].sum(axis=0)
    np.testing.assert_allclose(outside, 0, atol=1e-13)


@pytest.mark.parametrize("depth", [1e-3, 1e-6, 1e-9, 1e-12])
def test_angles_beside_edges_are_closed_for_points_inside_alone(core, depth):
    mesh = BoundaryMesh.from_cage(box())
    points = np.array([[1 - depth, 1 - 2 * depth, 0.3], [1 + depth, 1 + depth, 0.3]])
    sums = copied(mesh, points)[2].sum(axis=0)
    np.testing.assert_allclose(sums, [4 * np.pi, 0], rtol=2e-15, atol=1e-15 / depth)


def test_points_in_faces_have_the_principal_value(core):
    mesh = BoundaryMesh.from_cage(box())
    points = np.array([[1.0, 0.3, 0.1], [-1.0, 0.2, 0.7]])
    sums = copied(mesh, points, is_inside=False)[2].sum(axis=0)
    np.testing.assert_allclose(sums, 2 * np.pi, rtol=1e-14)


@pytest.mark.parametrize("order", [1, 2, 3, 4, 5])
@pytest.mark.parametrize("count", [1, 31, 32, 33, 100])
def test_both_bodies_agree(monkeypatch, order, count):
    """The recurrences of higher orders enlarge the differences, as they do rounding errors."""
    surface = ball(2, 1.0)
    mesh = raised(surface, order, 0.5) if order > 1 else BoundaryMesh.from_cage(surface)
    points = inside(surface, count)
    linear, higher, double = by_both(mesh, points, monkeypatch, is_inside=True)
    for found, expected in (linear, double):
        np.testing.assert_allclose(found, expected, rtol=1e-13, atol=1e-13 * np.abs(expected).max())
    np.testing.assert_allclose(*higher, rtol=1e-13, atol=10.0 ** (order - 16))


@pytest.mark.parametrize("ratio", [0.5, 0.99, 1.01, 2.0])
@pytest.mark.parametrize(
    "limit", [NEAR_EDGE_RATIO, EDGE_ON_TOL, CLOSED_ANGLE_TOL, MIN_GAP_RATIO, 1e-6, 1e-9]
)
def test_both_bodies_agree_around_their_limits(monkeypatch, ratio, limit):
    """Beside an edge, above a face and beside a corner, at distances about each limit."""
    depth = ratio * limit
    points = np.array(
        [
            [1 - depth, 1 - 2 * depth, 0.3],
            [1 - depth, 0.3, 0.1],
            [1 - depth, 1 - depth, 1 - depth],
            [1 - np.sqrt(depth), 1 - np.sqrt(depth), -0.2],
        ]
    )
    mesh = BoundaryMesh.from_cage(box())
    for is_inside in (True, False):
        with monkeypatch.context() as patch:
            for found, expected in by_both(mesh, points, patch, is_inside=is_inside):
                np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)


def test_the_coefficients_of_the_compiled_body_are_the_derived_ones():
    source = Path("cageik_cli/kernel/functions.h").read_text()
    for line in derive_functions.format_constants():
        assert line in " ".join(source.split())


@pytest.mark.parametrize(
    ("derive", "exact", "first", "end"),
    [
        (derive_functions.derive_log, lambda s: 2 * np.arctanh(s), 2, 3 - np.sqrt(8)),
        (derive_functions.derive_arctan, np.arctan, 1, 0.55),
    ],
)
def test_the_errors_of_the_polynomials_are_far_below_rounding(derive, exact, first, end):
    coefficients, error = derive()
    assert float(error) < 2.0**-58
    x = np.linspace(0.01, 1, 100, dtype=np.longdouble) * end
    found = derive_functions.evaluate([np.longdouble(str(value)) for value in coefficients], x * x)
    np.testing.assert_allclose(first + x * x * found, exact(x) / x, rtol=2.0**-58)


@needs_core
def test_the_logarithm_and_the_arctangent_are_exact_to_two_units():
    generator = np.random.default_rng(0)
    x = np.concatenate(
        [
            np.exp(generator.uniform(-600, 600, 50_000)),
            generator.uniform(0.5, 2, 50_000),
            np.nextafter(1, [0, 2]),
            [1.0, np.finfo(float).tiny, np.finfo(float).max, 0.5, 2.0],
        ]
    )
    slopes = [generator.uniform(-1, 1, size=50_000), np.tan(np.linspace(-1.5, 1.5, 50_007))]
    y = np.minimum(x, 1e300) * np.concatenate(slopes)
    logs, angles = np.empty_like(x), np.empty_like(x)
    compiled.kernel.compute_functions(y, x, logs, angles)
    assert _units(logs, np.log(x.astype(np.longdouble))).max() < 1
    assert _units(angles, np.arctan2(y.astype(np.longdouble), x)).max() < 2
    compiled.kernel.compute_functions(y, -x, logs, angles)
    assert _units(angles, np.arctan2(y.astype(np.longdouble), -x)).max() < 2


@needs_core
def test_the_arctangent_of_axes_is_exact():
    y = np.array([0.0, -0.0, 0.0, 1.0, -1.0, 1.0, 5e-324, 0.0])
    x = np.array([1.0, 1.0, -1.0, 0.0, 0.0, 1.0, 1.0, 0.0])
    logs, angles = np.empty_like(x), np.empty_like(x)
    compiled.kernel.compute_functions(y, x, logs, angles)
    np.testing.assert_array_equal(angles, np.arctan2(y, x))


def _units(found, exact):
    """Differences in units of the last place."""
    return np.abs(found - exact) / np.spacing(np.abs(exact).astype(np.float64))


def _arguments(monkeypatch):
    """The arguments of a call of the compiled body, as lists that a test may spoil."""
    if compiled.kernel is None:
        pytest.skip("the core was not compiled")
    taken = []

    class Kernel:
        def compute_potentials(self, *arguments):
            taken.extend(arguments)

    points = inside(ball(2, 1.0), 40)
    with monkeypatch.context() as patch:
        patch.setattr(compiled, "kernel", Kernel())
        compute_potentials(raised(ball(2, 1.0), 3, 0.5), points, is_inside=True)
    return [list(part) if isinstance(part, tuple) else part for part in taken]


def _call(arguments):
    compiled.kernel.compute_potentials(
        *(tuple(part) if isinstance(part, list) else part for part in arguments)
    )


def test_the_compiled_body_refuses_arrays_that_do_not_fit(monkeypatch):
    """Each array with another length, another type, and read backwards."""
    arguments = _arguments(monkeypatch)
    _call(arguments)
    places = [(None, 0), (None, 4)]
    places += [(part, k) for part in (1, 2, 3, 6) for k in range(len(arguments[part]))]
    for part, k in places:
        owner = arguments if part is None else arguments[part]
        kept = owner[k]
        if isinstance(kept, int):
            continue
        short = np.ascontiguousarray(kept[..., :-1])
        kinds = [kept.astype(np.float32), kept[..., ::-1], None, kept[..., None]]
        for spoilt in kinds + ([] if (part, k) in _FREE_LENGTHS else [short]):
            owner[k] = spoilt
            with pytest.raises((TypeError, ValueError)):
                _call(arguments)
        owner[k] = kept
    _call(arguments)


_FREE_LENGTHS = {(3, 1)}
"""Arrays whose length others follow, which are refused with them: fewer near panels."""


def test_the_compiled_body_refuses_numbers_out_of_range(monkeypatch):
    arguments = _arguments(monkeypatch)
    for part, k in ((1, 1), (1, 2), (1, 3), (1, 4), (2, 0), (2, 1), (3, 1), (3, 2)):
        kept = arguments[part][k]
        for wrong in (-1, 1 << 30):
            arguments[part][k] = kept.copy()
            arguments[part][k].flat[len(kept) // 2] = wrong
            with pytest.raises(ValueError, match="expected"):
                _call(arguments)
        arguments[part][k] = kept
    for order in (-1, 0, 1, 6, 1 << 20):
        arguments[3][0] = order
        with pytest.raises(ValueError, match="expected 2 to 5"):
            _call(arguments)


def test_the_compiled_body_refuses_results_that_cannot_be_written(monkeypatch):
    arguments = _arguments(monkeypatch)
    arguments[6][0].flags.writeable = False
    with pytest.raises(TypeError):
        _call(arguments)


def test_the_compiled_body_refuses_a_surface_without_panels(monkeypatch):
    """Angles to close would be those of a panel that is not there."""
    arguments = _arguments(monkeypatch)
    n, (basis_functions, points) = arguments[1][1].shape[0], arguments[6][2].shape
    empty = [np.zeros([0 if length in (n, 3 * n) else length for length in part.shape], part.dtype)
             for part in arguments[1]]  # fmt: skip
    empty[-1] = np.zeros((len(arguments[1][5]), 4))
    no_hats = (np.zeros(1, np.int32), np.zeros(0, np.int32), np.zeros(0))
    results = (np.zeros((0, points)), np.zeros((0, 0, points)), np.zeros((basis_functions, points)))
    limits = np.full_like(arguments[0], 2.0)
    with pytest.raises(ValueError, match="expected a panel at least"):
        _call([limits, empty, no_hats, None, arguments[4], True, results])


def test_the_compiled_body_refuses_lists_in_place_of_tuples(monkeypatch):
    arguments = [tuple(p) if isinstance(p, list) else p for p in _arguments(monkeypatch)]
    for k in (1, 2, 3, 6):
        with pytest.raises(TypeError, match="tuple"):
            compiled.kernel.compute_potentials(
                *(list(part) if place == k else part for place, part in enumerate(arguments))
            )


@needs_core
def test_the_compiled_core_refuses_numbers_that_are_not_aligned():
    crooked = memoryview(bytearray(8 * 5))[1:-7].cast("d")
    straight = np.empty(4)
    with pytest.raises(TypeError, match="expected an array that is aligned"):
        compiled.kernel.compute_functions(crooked, straight, straight, straight)


def test_no_points_need_no_memory_for_hats(monkeypatch):
    arguments = _arguments(monkeypatch)
    arguments[4] = arguments[4][:0]
    n, extra, near = *arguments[6][0].shape[:1], *arguments[6][1].shape[:2]
    sizes = ((n, 0), (extra, near, 0), (2**45, 0))
    arguments[6] = [np.empty(size) for size in sizes]
    _call(arguments)


def test_limits_are_those_of_the_reference():
    assert module._LIMITS[-1] == FADE_FACTOR
    assert module._LIMITS[0] == EDGE_ON_TOL


@pytest.mark.parametrize(("value", "is_pure"), [("1", True), ("0", False), ("", False)])
def test_a_variable_turns_the_compiled_core_off(value, is_pure):
    code = "from cageik_cli.util import compiled; print(compiled.describe_core())"
    told = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | {"CAGEIK_PURE": value},
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    assert ("CAGEIK_PURE" in told) is is_pure
