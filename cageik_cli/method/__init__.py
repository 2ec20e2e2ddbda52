"""The paper on one page, with the names of the functions that do it.

Y. Savoye and J.-S. Franco, *CageIK: Dual-Laplacian Cage-Based Inverse Kinematics*, AMDO 2010. Steps
3, 4 and 6 have the numbers of the paper's equations. Sums are means here, so that α and β mean the
same on every mesh. This folder imports `geometry` and `util` only; `docs/method.md` has
what the paper leaves open.

=====================  ============================================================================
m, n, l, k             vertices of the model and of its cage, anchors, frames
H (m, n)               weights of the model's vertices in the cage's
L (n, n)               uniform Laplacian of the cage, I − D⁻¹A
c (n, 3), v (m, 3)     a cage, and the mesh that it gives, in the units of the files
δ (n, 3)               differential coordinates of the cage
=====================  ============================================================================

A ball in a box, whose faces turn counter-clockwise seen from outside, as those of all cages:

>>> import numpy as np
>>> from scipy.spatial import ConvexHull
>>> from cageik_cli.geometry.mesh import TriMesh
>>> def hull(points):
...     faces = ConvexHull(points).simplices
...     is_inward = np.linalg.det(points[faces]) < 0
...     faces[is_inward] = faces[is_inward][:, ::-1]
...     return TriMesh(points, faces)
>>> corners = np.array([[x, y, z] for x in (-1.0, 1) for y in (-1.0, 1) for z in (-1.0, 1)])
>>> height = np.linspace(-0.98, 0.98, 60)
>>> turn, radius = 2.4 * np.arange(60), np.sqrt(1 - height**2)
>>> rest = hull(0.6 * np.stack([radius * np.cos(turn), radius * np.sin(turn), height], axis=1))
>>> cage = hull(corners)
>>> m, n = len(rest.vertices), len(cage.vertices)

**1. The mesh is a combination of the cage: v_j = Σ_k H_jk c_k.** H_jk is the value at vertex j of
the function that is harmonic inside the cage and on it the piecewise linear basis function of cage
vertex k. `harmonic_weights` finds it by boundary elements (`bem`); `mean_value_weights` are another
kind, in closed form. Rows sum to one, H c_rest is the rest pose, and both are exact to rounding.
`Binding` holds H with both meshes, and `reconstruct` is the product for many cages.

>>> from cageik_cli.method.weights.binding import Binding, reconstruct
>>> from cageik_cli.method.weights.harmonic import harmonic_weights
>>> found = harmonic_weights(cage, rest.vertices)
>>> H = found.values
>>> bool(np.abs(H.sum(axis=1) - 1).max() < 1e-12)
True
>>> bool(np.abs(H @ cage.vertices - rest.vertices).max() < 1e-12)
True
>>> binding = Binding(rest, cage, H)

**2. The cage has a shape of its own: δ = L c_rest.** δ_i is cage vertex i minus the mean of its
neighbours (`uniform_laplacian`). Where nothing is known of the model, the cage keeps δ.

>>> from cageik_cli.geometry.shape import uniform_laplacian
>>> L = uniform_laplacian(cage)
>>> delta = L @ cage.vertices
>>> bool(np.abs(L @ (cage.vertices + [3.0, 0, 0]) - delta).max() < 1e-12)
True

**3. An anchor is a point of the surface: q = Σ_i γ_i v_i**, over the corners of its face, with
barycentric coordinates γ (`point_on_face`, `point_at_vertex`, `closest_point`).

>>> from cageik_cli.method.pose.anchors import Anchor, anchor_matrix, point_at_vertex, point_on_face
>>> top, side = point_at_vertex(rest, m - 1), point_on_face(rest, 0, np.array([0.2, 0.3, 0.5]))
>>> q = side.position(rest.vertices)
>>> bool(np.allclose(q, [0.2, 0.3, 0.5] @ rest.vertices[rest.faces[0]], rtol=0, atol=1e-12))
True

**4. In the space of the cage it is one row: q = a c, a = Σ_i γ_i H_i** (`anchor_matrix`, for all).

>>> anchors = [Anchor("top", top), Anchor("side", side)]
>>> A = anchor_matrix(anchors, H)
>>> A.shape
(2, 8)
>>> bool(np.allclose(A[1] @ cage.vertices, q, rtol=0, atol=1e-12))
True

**5. What is known of a pose is linear in the cage.** Of a frame of an animation all m vertices are
known, |v_j − H_j c|²; of a pose by hand l anchors, |q_j − a_j c|². The rows are H, or A.

**6. The cage is the one that fits best and keeps its shape.** It minimises

    (α/n) Σ_i |(L c)_i − δ_i|²  +  (β/m) Σ_j |v_j − Σ_k H_jk c_k|²

Its normal matrix (α/n) LᵀL + (β/m) HᵀH does not know the frame: `DualLaplacianSolver` factors it
once, and each frame is three more right-hand sides. They are displacements from the rest pose, in
which nothing large cancels. Before, each frame is moved rigidly onto the rest pose, and its cage
back behind it (`best_motions`): so δ need not turn, and moved frames have moved cages.

>>> from cageik_cli.method.solve.dual_laplacian import DualLaplacianSolver
>>> from cageik_cli.method.solve.settings import SolveSettings
>>> settings = SolveSettings()
>>> settings
SolveSettings(alpha=0.001, beta=1.0, align=True, norm=None)
>>> solver = DualLaplacianSolver(binding, settings)
>>> normal = settings.alpha / n * L.T @ L + settings.beta / m * H.T @ H
>>> bool(np.allclose(solver.normal, normal, rtol=0, atol=1e-12))
True

Frames that were made from known cages, also turned ones, give these cages back: without α exactly,
with its default nearly. `BlockSolver` does this for the blocks of a clip, and measures the errors
(`measure`).

>>> generator = np.random.default_rng(0)
>>> cages = cage.vertices + 0.2 * generator.normal(size=(5, n, 3))
>>> cages[1:] = cages[1:] @ np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]]) + [4.0, 0, 0]
>>> frames = reconstruct(H, cages)
>>> exact = DualLaplacianSolver(binding, SolveSettings(alpha=0.0)).solve(frames)
>>> bool(np.abs(exact.cages - cages).max() < 1e-10)
True
>>> misses = solver.solve(frames).reconstructions - frames
>>> bool(np.sqrt(np.square(misses).sum(axis=2).mean()) < 0.01 * rest.diagonal)
True

For a pose, anchors replace the frame: β/l and A stand in place of β/m and H, with a small α, so
that few anchors are met closely. `Poser` factors LᵀL once per cage (`CageResponseSolver`), and a
system of the size of the anchors per set of anchors; a pose is then one product. What turns far is
sheared, as L does not turn: `rigidity` rotates δ with the cells of the cage (Sorkine and Alexa
2007). All of the model follows few anchors; beyond the paper, `Poser` holds what is far from them
(`hold`), with all m vertices as weak constraints.

>>> from cageik_cli.method.pose.poser import Poser
>>> poser = Poser(binding, anchors, hold=False)
>>> moves = np.array([[0.0, 0.0, 0.3], [0.0, 0.0, 0.0]])
>>> posed = poser.solve_cage(moves)
>>> bool(np.abs(A @ posed - A @ cage.vertices - moves).max() < 1e-5)
True
>>> bool(np.allclose(poser.solve_mesh(moves), H @ posed, rtol=0, atol=1e-12))
True

What else a cage moves: `PointMotion` takes points of other meshes with it, and turns their normals
and splats by the derivative of H c, whose gradients `HarmonicField` computes.
"""
