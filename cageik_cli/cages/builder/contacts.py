"""Contacts of a cage with the samples that it must keep off, at one sheet of it, or at two."""

import igl
import numpy as np

from cageik_cli.cages.push import Contacts
from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.geometry.surface import winding_numbers
from cageik_cli.util.arrays import Floats, Mask

MAX_OPPOSITE_COSINE = -0.99
"""Between the outward directions of two sheets of a cage around a thin part of a model, at most."""


class ContactSearch:
    """The samples that a cage is too near to, while it is pushed off them.

    Each has a contact at its nearest face. Around a thin part of a model a second sheet of the cage
    is near: the face that was the nearest before, on the other side, stays a contact, too. Pushes
    would move both sheets to and fro otherwise.

    Parameters
    ----------
    samples : (s, 3) float64
    clearance : float
        Samples that are nearer, or outside, are too near.
    """

    def __init__(self, samples: Floats, clearance: float) -> None:
        self._samples, self._clearance = samples, clearance
        self._depths = np.full(len(samples), -np.inf)
        # Of the last contact of each sample, and of the last one on the other side of that.
        self._corners = np.zeros((2, len(samples), 3), np.int64)
        self._weights, self._directions = np.zeros((2, 2, len(samples), 3))

    def find(self, cage: TriMesh, longest: float) -> Contacts | None:
        """Return the contacts of the cage, whose vertices moved as far as `longest` at most."""
        # No point of the cage moves further than its vertices: what is deeper is no contact.
        self._depths -= longest
        near = np.flatnonzero(self._depths < self._clearance)
        if len(near) == 0:
            return None
        contacts, self._depths[near] = find_contacts(cage, self._samples[near], self._clearance)
        touched = near[self._depths[near] < self._clearance]
        turned = touched[_are_opposite(self._directions[0, touched], contacts.direction)]
        for kept, found in (
            (self._corners, contacts.corners),
            (self._weights, contacts.weights),
            (self._directions, contacts.direction),
        ):
            kept[1, turned] = kept[0, turned]
            kept[0, touched] = found
        # Those of the other sheets that are too near to these samples are contacts, too.
        corners, weights = self._corners[1, touched], self._weights[1, touched]
        direction = self._directions[1, touched]
        place = (weights[:, :, None] * cage.vertices[corners]).sum(axis=1)
        missing = self._clearance - ((place - self._samples[touched]) * direction).sum(axis=1)
        added = (missing > 0) & _are_opposite(direction, contacts.direction)
        return Contacts(
            np.concatenate([contacts.corners, corners[added]]),
            np.concatenate([contacts.weights, weights[added]]),
            np.concatenate([contacts.direction, direction[added]]),
            np.concatenate([contacts.missing, missing[added]]),
        )


def _are_opposite(first: Floats, second: Floats) -> Mask:
    return np.asarray((first * second).sum(axis=1) < MAX_OPPOSITE_COSINE)


def find_contacts(cage: TriMesh, samples: Floats, clearance: float) -> tuple[Contacts, Floats]:
    """Return the samples with less than the clearance; and how deep inside each sample is, (s,)."""
    signed, face, nearest, normal = igl.signed_distance(
        samples, cage.vertices, cage.faces, igl.SIGNED_DISTANCE_TYPE_PSEUDONORMAL
    )
    # libigl counts the inside negative. Where a cage crosses itself its normals mislead.
    doubtful = np.flatnonzero(signed > 0)
    if len(doubtful):
        inside = winding_numbers(cage, samples[doubtful]) > 0.5
        signed[doubtful[inside]] *= -1
    close = np.flatnonzero(signed > -clearance)
    corners = cage.faces[face[close]]
    a, b, c = (cage.vertices[corners[:, k]] for k in range(3))
    weights = igl.barycentric_coordinates(nearest[close].copy(), a, b, c).reshape(-1, 3)
    direction = (samples[close] - nearest[close]) * np.sign(signed[close])[:, None]
    length = np.linalg.norm(direction, axis=1, keepdims=True)
    direction = np.where(length > 1e-9, direction / np.maximum(length, 1e-9), normal[close])
    return Contacts(corners, weights, direction, signed[close] + clearance), -signed
