"""Hold the rest: dense constraints of the surface's own place, beside the sparse anchors.

The cage of a pose that holds the rest minimises, in displacements d of the cage,

    (α/n) |L d − b|²  +  (α κ/m) Σ_j |H_j d − u_j|²  +  (β/l) Σ_i w_i |t_i − a_i d|²,

b the change of δ by rotations (`method.pose.poser`). u_j is where vertex j would go: 0 outside the
radii of all anchors, so that the model stays there, and near an anchor with it. One factor of
LᵀL + κ (n/m) HᵀH serves all frames and all targets.

Each anchor has a reach: s_j falls from 1 at the anchor to 0 at its radius, over the surface, and
its limb swings about its pivot p, the middle of the ring near the radius. With the arm a = h − p of
the anchor at h, which goes to h + t, its motion at level s is

    M_s(x) = p + R^s S^s (x − p) + s τ,        u_j = M_s(v_j) − v_j  at  s = s_j,

R the least rotation from a to a + t, S the stretch along a that keeps the volume, limited, and τ
what is left of t. Where the arm is short, as on a back or a belly, the motion is the translation
s t. Several reaches share a vertex by s_j over the squared distance to their anchors.

u is linear in the levels s = k/K if levels between them are interpolated. Then, with
φ_jk the share of level k at vertex j,

    Hᵀ u = Σ_k G_k (c − p) (M_k − I)ᵀ + (k/K) g_k τᵀ,    G_k = Hᵀ diag(φ_k) H,  g_k = Hᵀ φ_k,

which does not depend on the number of vertices: an edit moves the cage of any frame c by small
products. Places here are H c, without the offsets that a binding may have.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import atan2, cos, hypot, sin

import numpy as np

from cageik_cli.geometry.mirror import Mirror
from cageik_cli.geometry.shape import lumped_areas
from cageik_cli.geometry.surface_distance import SurfaceDistances
from cageik_cli.method.pose.anchors import Anchor, SurfacePoint, point_at_vertex
from cageik_cli.method.weights.binding import Binding
from cageik_cli.util.arrays import Floats

HOLD = 300.0
"""κ: from 30 to 3000 an arm raised by a fifth of the size moves 12.6 to 13.5 % of a walking figure,
and its volume by -2.7 to -3.2 %."""

REACHED_SHARE, MIN_RADIUS, MAX_RADIUS = 0.12, 0.1, 0.4
"""A radius that is not given reaches this share of the area, within these shares of the diagonal:
an arm of a character to the shoulder, and nothing of its body."""

CORE = 0.25
"""Share of the radius in which all moves as the anchor does. With 0.5, 3 % more moves."""

RING, RING_WIDTH = 0.72, 0.12
"""Where the ring around the pivot is, and how wide it is to each side, in radii."""

LEVELS = 2
"""K: half of the motion, and all of it. More do not change volumes by 0.03 %."""

LEVEL_SHARES = [(k + 1) / LEVELS for k in range(LEVELS)]

MIN_STRETCH, MAX_STRETCH = 0.7, 1.4
"""Least and largest stretch of an arm; what is left of a motion is a translation."""

SHORT_ARM, LONG_ARM = 0.2, 0.45
"""Up to the first length, in radii, a motion is a translation; from the second on a swing."""

NEAREST = 1e-4
"""Anchors share the vertices that are closer to them than this, in diagonals, as they do there."""


@dataclass(frozen=True, slots=True, eq=False)
class Reach:
    """What an anchor, or its mirror image, takes with it.

    Attributes
    ----------
    anchor : int
        Its number.
    mirror : Mirror, optional
        That whose image it is; None for the anchor itself.
    row, pivot : (n,) float64
        The anchor and its pivot in cage space.
    radius : float
        Over the surface, in the units of the rest pose.
    strength : (m,) float64
        s, from 1 at the anchor to 0 at its radius.
    moments : (K, n, n) float64
        G_k.
    share : (n,) float64
        Σ_k (k/K) g_k.
    """

    anchor: int
    mirror: Mirror | None
    row: Floats
    pivot: Floats
    radius: float
    strength: Floats
    moments: Floats
    share: Floats

    def find_arms(self, cages: Floats) -> Floats:
        """Return the arms of the anchor in cages (…, n, 3): from its pivot to it, (…, 3)."""
        return np.asarray((self.row - self.pivot) @ cages)

    def compute_forces(self, cages: Floats) -> Floats:
        """Return the forces on cages (…, n, 3) per entry of a motion, (…, n, 3 K + 1)."""
        places = cages - (self.pivot @ cages)[..., None, :]
        turned = [moments @ places for moments in self.moments]
        share = np.broadcast_to(self.share[:, None], (*cages.shape[:-1], 1))
        return np.concatenate([*turned, share], axis=-1)

    def compute_motion(self, arm: Floats, displacement: Floats) -> Floats:
        """Return the motion (3 K + 1, 3) of a displacement (3,) of the anchor, as `swing` does.

        The image of an anchor moves by the mirror image of its displacement.
        """
        if self.mirror is not None:
            normal = self.mirror.normal
            displacement = displacement - 2 * (normal @ displacement) * normal
        return swing(arm, displacement, self.radius)


class HeldSurface:
    """The surface of a model in its cage, which anchors move near them and nowhere else.

    Parameters
    ----------
    binding : Binding
        m vertices in a cage of n.

    Attributes
    ----------
    gram : (n, n) float64
        κ (n/m) HᵀH.
    """

    def __init__(self, binding: Binding) -> None:
        self._binding = binding
        weights = binding.weights
        self.scale = HOLD * weights.shape[1] / max(1, len(weights))
        self.gram = self.scale * (weights.T @ weights)

    @cached_property
    def _distances(self) -> SurfaceDistances:
        return SurfaceDistances(self._binding.rest)

    @cached_property
    def _areas(self) -> Floats:
        rest = self._binding.rest
        areas = lumped_areas(rest)
        # Points have no area, and count alike.
        return areas if areas.any() else np.ones(len(rest.vertices))

    def find_reaches(self, anchors: Sequence[Anchor], mirror: Mirror | None = None) -> list[Reach]:
        """Return the reaches of anchors, and of their mirror images."""
        places: list[tuple[int, SurfacePoint, Mirror | None]] = [
            (k, anchor.point, None) for k, anchor in enumerate(anchors)
        ]
        if mirror is not None:
            places += [(k, self._reflect_point(p, mirror), mirror) for k, p, _ in places]
        if not places:
            return []
        distances = [self._distances.measure(p.corners, p.barycentric) for _, p, _ in places]
        radii = [
            anchors[k].radius or self.choose_radius(away)
            for (k, _, _), away in zip(places, distances, strict=True)
        ]
        with np.errstate(over="ignore"):  # of a radius of nearly nothing
            strengths = [fall_off(away / r) for away, r in zip(distances, radii, strict=True)]
        diagonal = self._binding.rest.diagonal or 1.0
        claims = np.stack(
            [
                strength / np.maximum(away / diagonal, NEAREST) ** 2
                for strength, away in zip(strengths, distances, strict=True)
            ]
        )
        claims /= np.maximum(claims.sum(axis=0), np.finfo(float).tiny)
        columns = zip(places, distances, radii, strengths, claims, strict=True)
        return [self._make_reach(*column) for column in columns]

    def choose_radius(self, distances: Floats) -> float:
        """Choose the radius of an anchor that is at distances (m,) over the surface."""
        order = np.argsort(distances, kind="stable")
        reached = np.cumsum(self._areas[order])
        at = min(int(np.searchsorted(reached, REACHED_SHARE * reached[-1])), len(order) - 1)
        diagonal = self._binding.rest.diagonal or 1.0
        return float(np.clip(distances[order[at]] / diagonal, MIN_RADIUS, MAX_RADIUS) * diagonal)

    def _make_reach(
        self,
        place: tuple[int, SurfacePoint, Mirror | None],
        distances: Floats,
        radius: float,
        strength: Floats,
        claim: Floats,
    ) -> Reach:
        anchor, point, mirror = place
        weights = self._binding.weights
        row = point.cage_weights(weights)
        with np.errstate(over="ignore"):
            ring = np.maximum(0, 1 - np.abs(distances / radius - RING) / RING_WIDTH) * self._areas
        pivot = ring @ weights / ring.sum() if ring.any() else row
        is_near = strength > 0
        near, level = weights[is_near], LEVELS * strength[is_near]
        hats = [np.maximum(0, 1 - np.abs(level - k)) * claim[is_near] for k in range(1, LEVELS + 1)]
        return Reach(
            anchor=anchor,
            mirror=mirror,
            row=row,
            pivot=pivot,
            radius=radius,
            strength=strength,
            moments=self.scale * np.stack([(near.T * hat) @ near for hat in hats]),
            share=self.scale
            * sum(s * hat for s, hat in zip(LEVEL_SHARES, hats, strict=True))
            @ near,
        )

    def _reflect_point(self, point: SurfacePoint, mirror: Mirror) -> SurfacePoint:
        """Return the vertex that is nearest to the mirror image of a point."""
        rest = self._binding.rest
        image = mirror.reflect(point.position(rest.vertices))
        return point_at_vertex(rest, int(np.linalg.norm(rest.vertices - image, axis=1).argmin()))


def fall_off(radii: Floats) -> Floats:
    """Return s at distances in radii: 1 in the core, 0 from 1 on, smooth between."""
    x = np.clip((radii - CORE) / (1 - CORE), 0, 1)
    return np.asarray(1 - x * x * (3 - 2 * x))


def swing(arm: Floats, displacement: Floats, radius: float) -> Floats:
    """Return the motion of an arm (3,) whose end goes by a displacement (3,), as (3 K + 1, 3).

    For each level (M − I)ᵀ, and then the translation τ: what is at x, from the pivot, moves by
    x (M − I)ᵀ + s τ. In the plane of the arm a and of b ⟂ a, to which it turns by θ, with
    the stretches λ along a and μ across,

        M − I = (μ − 1) I + (λ cos θ − μ) a aᵀ + λ sin θ b aᵀ − μ sin θ a bᵀ − μ (1 − cos θ) b bᵀ
    """
    # Numbers of Python: arrays of three take ten times as long.
    a, t = arm.tolist(), displacement.tolist()
    moved = [x + y for x, y in zip(a, t, strict=True)]
    length, new_length = hypot(*a), hypot(*moved)
    share = _smooth((length / radius - SHORT_ARM) / (LONG_ARM - SHORT_ARM))
    rows, left = [[0.0] * 3 for _ in range(3 * LEVELS)], t
    if share > 0 and new_length > 0:
        a = [x / length for x in a]
        along = sum(x * y for x, y in zip(a, moved, strict=True))
        across = [y - along * x for x, y in zip(a, moved, strict=True)]
        height = hypot(*across)
        # An arm that turns by 180 degrees may do so in any plane.
        b = [x / height for x in across] if height > 0 else _find_side(a)
        angle = atan2(height, along)
        stretch = min(max(new_length / length, MIN_STRETCH), MAX_STRETCH)
        for k, s in enumerate(LEVEL_SHARES):
            lam, mu, sine, cosine = stretch**s, stretch ** (-s / 2), sin(s * angle), cos(s * angle)
            for i in range(3):
                of_a = share * ((lam * cosine - mu) * a[i] - mu * sine * b[i])
                of_b = share * (lam * sine * a[i] - mu * (1 - cosine) * b[i])
                row = [of_a * x + of_b * y for x, y in zip(a, b, strict=True)]
                row[i] += share * (mu - 1)
                rows[3 * k + i] = row
        last = zip(t, *rows[-3:], strict=True)
        left = [d - length * (a[0] * x + a[1] * y + a[2] * z) for d, x, y, z in last]
    return np.array([*rows, left])


def _find_side(axis: list[float]) -> list[float]:
    """Return a direction across an axis."""
    unit = np.eye(3)[np.abs(axis).argmin()]
    across = np.cross(axis, unit)
    return list((across / np.linalg.norm(across)).tolist())


def _smooth(x: float) -> float:
    x = min(max(x, 0.0), 1.0)
    return x * x * (3 - 2 * x)
