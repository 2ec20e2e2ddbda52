"""Closed-form Laplace integrals over flat triangles, many points and panels at once.

For a panel with unit outward normal n, corners a_k, altitudes A_k, and its side k (opposite corner
k) with outward in-plane normal m_k, seen from a point x whose foot in the panel's plane is p, and
with r the distances to the corners:

    h    = n · (a − x)                                  height of the plane over x
    t_k  = m_k · (a − x), a on side k                   so that φ_k(p) = t_k / A_k
    f_k  = ln((r_a + r_b + L) / (r_a + r_b − L))        of the side's edge ab of length L
    B_k  = (t_k² + h²) f_k + s_b r_b − s_a r_a          of the edge; s = d · (corner − x)
    Ω    = solid angle, positive for h > 0

    ∫ 1/r dA        = Σ_k t_k f_k − h Ω
    ∫ (y − p)/r dA  = ½ Σ_k m_k B_k
    ∫ φ_i h/r³ dA   = φ_i(p) Ω − h Σ_k (∇φ_i · m_k) f_k

with φ_i the linear function that is 1 at corner i and 0 at the others. t_k² + h² is the squared
distance to the edge's line, so f and B belong to the edge and are computed once for both panels at
it; that both panels see the same f also makes linear functions exact whatever f's rounding.

Sources: Wilton et al. 1984 (IEEE Trans. Antennas Propag. 32) for the single layer; Van Oosterom
and Strackee 1983, eq. 8, for the solid angle.

Arrays have panels along the first axis and points along the last, so that gathering by panel copies
whole rows.
"""

import math
from dataclasses import dataclass

import numpy as np

from cageik_cli.coordinates.panel_geometry import Panels
from cageik_cli.mesh import Floats, Integers

EDGE_ON = 1e-13
"""A panel whose plane passes a point within this (in units of the cage) is seen edge-on: Ω = 0."""

NEAREST = 1e-15
"""Smallest (r_a + r_b − L) / L; below it f is rounding, and so is the distance it multiplies."""


INSIDE = 1e-3
"""Solid angles that sum to 4π within this share are those of a point inside."""

SMALL_TANGENT = 0.03
"""Tangents z below which z − z³/3 + z⁵/5 − z⁷/7 + z⁹/9 is arctan z to the last bit."""


class Scratch:
    """Arrays that are used again block after block, so that memory is asked for once.

    Fresh arrays of a block's size cost more in page faults than in arithmetic. One thread's own.
    """

    def __init__(self) -> None:
        self._arrays: dict[str, Floats] = {}

    def array(self, name: str, *shape: int) -> Floats:
        """The array of that name, of that shape, with anything in it."""
        size = math.prod(shape)
        held = self._arrays.get(name)
        if held is None or held.size < size:
            held = self._arrays[name] = np.empty(size)
        return held[:size].reshape(shape)

    def rows(self, name: str, source: Floats, chosen: Integers) -> Floats:
        """`source[chosen]` in the array of that name."""
        out = self.array(name, len(chosen), source.shape[1])
        return np.take(source, chosen, axis=0, out=out, mode="clip")


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """What the integrals need of p panels with e edges seen from q points (module formulas).

    The arrays are scratch: good until the next view with the same scratch.

    Attributes
    ----------
    height : (p, q)
        h of each panel's plane over each point.
    side : (3, p, q)
        t_k of each side.
    foot : (2, p, q)
        Coordinates u, v of the foot p along the panel's axes, from its centroid.
    solid_angle : (p, q)
        Ω, steradians in [−2π, 2π]: positive when the point lies behind the outward normal, so that
        a closed surface's sum to 4π inside and to 0 outside.
    edge_log, edge_moment : (e, q)
        f and B of each edge.
    """

    height: Floats
    side: Floats
    foot: Floats
    solid_angle: Floats
    edge_log: Floats
    edge_moment: Floats


def view(panels: Panels, points: Floats, scratch: Scratch) -> View:
    """Look at `panels` from `points`, (q, 3)."""
    p, q = len(panels.corners), len(points)
    forms = scratch.array("forms", len(panels.forms), q)
    np.matmul(panels.forms, np.vstack([points.T, np.ones(q)]), out=forms)
    height, along = forms[:p], forms[6 * p :]
    side, foot = forms[p : 4 * p].reshape(3, p, q), forms[4 * p : 6 * p].reshape(2, p, q)
    distance = _distances(panels, points, scratch)
    edge_log, edge_moment, products = _edge_terms(panels, distance, along, scratch)
    angle = _solid_angle(panels, height, distance, products, scratch)
    return View(height, side, foot, angle, edge_log, edge_moment)


def close_angles(seen: View) -> None:
    """Give the solid angles of a closed surface the sum 4π that they have from inside.

    Within δ of an edge the angle of each panel there is ill-conditioned, with an error of rounding
    over δ; their sum is not. What it lacks goes to the largest, whose panel is near and so has
    the smallest h: constants and linear functions stay exact. Points whose angles do not sum to 4π
    but for such errors are not inside, and are left alone.
    """
    angle = seen.solid_angle
    lacking = 4 * np.pi - angle.sum(axis=0)
    lacking[np.abs(lacking) > 4 * np.pi * INSIDE] = 0.0
    angle[np.abs(angle).argmax(axis=0), np.arange(angle.shape[1])] += lacking


def _distances(panels: Panels, points: Floats, scratch: Scratch) -> Floats:
    """From every vertex to every point, (v, q)."""
    distance = scratch.array("distance", len(panels.vertices), len(points))
    offset = scratch.array("offset", *distance.shape)
    distance[:] = 0
    for k in range(3):
        np.subtract(panels.vertices[:, k, None], points[:, k], out=offset)
        offset *= offset
        distance += offset
    return np.sqrt(distance, out=distance)


def _edge_terms(
    panels: Panels, distance: Floats, along: Floats, scratch: Scratch
) -> tuple[Floats, Floats, Floats]:
    """f, B and 2 (a − x) · (b − x) of every edge ab, (e, q) each; `along` is s of a."""
    length = panels.edge_lengths[:, None]
    r_a = scratch.rows("r_a", distance, panels.edges.ends[:, 0])
    r_b = scratch.rows("r_b", distance, panels.edges.ends[:, 1])
    log = np.add(r_a, r_b, out=scratch.array("log", *along.shape))
    gap = np.subtract(log, length, out=scratch.array("gap", *along.shape))
    np.maximum(gap, NEAREST * length, out=gap)
    log += length
    log /= gap
    np.log(log, out=log)
    square_a = np.multiply(r_a, r_a, out=gap)
    products = np.multiply(r_b, r_b, out=scratch.array("products", *along.shape))
    products += square_a
    products -= length * length
    # B = (r_a² − s²) f + s (r_b − r_a) + L r_b, for s of b is s + L.
    moment = np.multiply(along, along, out=scratch.array("moment", *along.shape))
    np.subtract(square_a, moment, out=moment)
    moment *= log
    np.subtract(r_b, r_a, out=r_a)
    r_a *= along
    moment += r_a
    r_b *= length
    moment += r_b
    return log, moment, products


def _solid_angle(
    panels: Panels, height: Floats, distance: Floats, products: Floats, scratch: Scratch
) -> Floats:
    """Ω by Van Oosterom and Strackee, given 2 a · b of each edge's ends seen from the points."""
    corner = [scratch.rows(f"r_{k}", distance, panels.corners[:, k]) for k in range(3)]
    denominator = scratch.array("denominator", *height.shape)
    np.multiply(corner[0], corner[1], out=denominator)
    denominator *= corner[2]
    denominator *= 2
    for k in range(3):
        corner[k] *= scratch.rows("gathered", products, panels.edges.of_side[:, k])
        denominator += corner[k]
    numerator = scratch.array("numerator", *height.shape)
    np.multiply(height, 4 * panels.areas[:, None], out=numerator)
    angle = _arctan2(numerator, denominator, scratch)
    angle *= 2
    return angle


def _arctan2(y: Floats, x: Floats, scratch: Scratch) -> Floats:
    """arctan2 for angles of which nearly all are small, as those of far panels are.

    Those are summed as a series, several times faster than the library's function where that is
    not vectorised.
    """
    with np.errstate(all="ignore"):  # a quotient that is not finite is not small
        tangent = np.divide(y, x, out=scratch.array("tangent", *x.shape))
        square = np.multiply(tangent, tangent, out=scratch.array("square", *x.shape))
        angle = np.multiply(square, 1 / 9, out=scratch.array("angle", *x.shape))
        for term in (-1 / 7, 1 / 5, -1 / 3):
            angle += term
            angle *= square
        angle += 1
        angle *= tangent
    large = np.flatnonzero(~((square < SMALL_TANGENT**2) & (x > 0)))
    angle.reshape(-1)[large] = np.arctan2(y.reshape(-1)[large], x.reshape(-1)[large])
    return angle


def single_layer_moments(panels: Panels, seen: View, scratch: Scratch) -> Floats:
    """∫ (1, u, v) / r dA of every panel, (3, p, q) indexed [moment, panel, point]; scratch.

    u and v run along `axes` from the panel's centroid, so that the moments of a far panel are as
    small as its share of an integral, and sums over panels do not cancel.
    """
    shape = seen.height.shape
    moments = scratch.array("moments", 3, *shape)
    product = scratch.array("product", *shape)
    np.multiply(seen.height, seen.solid_angle, out=moments[0])
    np.negative(moments[0], out=moments[0])
    for k in range(3):
        moments[0] += np.multiply(
            seen.side[k],
            scratch.rows("gathered", seen.edge_log, panels.edges.of_side[:, k]),
            out=product,
        )
    np.multiply(seen.foot, moments[0], out=moments[1:])
    for k in range(3):
        edge = scratch.rows("gathered", seen.edge_moment, panels.edges.of_side[:, k])
        for axis in range(2):
            moments[1 + axis] += np.multiply(
                edge, panels.half_normals[axis, k][:, None], out=product
            )
    return moments


def double_layer(panels: Panels, seen: View, scratch: Scratch) -> Floats:
    """∫ φ_i h/r³ dA of every panel and corner, (3, p, q) indexed [corner, panel, point]; scratch.

    The principal value, which is zero, for a point in the panel's own plane.
    """
    shape = seen.height.shape
    integrals = scratch.array("integrals", 3, *shape)
    product = scratch.array("product", *shape)
    angle = np.where(np.abs(seen.height, out=product) < EDGE_ON, 0.0, seen.solid_angle)
    for i in range(3):
        np.multiply(seen.side[i], angle, out=integrals[i])
        integrals[i] /= panels.altitudes[i][:, None]
    for k in range(3):
        scaled = scratch.rows("gathered", seen.edge_log, panels.edges.of_side[:, k])
        scaled *= seen.height
        for i in range(3):
            integrals[i] -= np.multiply(scaled, panels.slopes[i, k][:, None], out=product)
    return integrals
