"""Small models to fit weights to: convex weights, and motions that they cannot reproduce."""

import numpy as np

from cageik_cli.geometry.mesh import TriMesh
from cageik_cli.method.weights.binding import Binding
from tests.shapes import ball, rotation


def small_binding(levels: int = 2, seed: int = 0) -> Binding:
    """A bumpy ball in a ball of 18 vertices; weights fall with the distance in direction."""
    cage, directions = ball(1, 1.0), ball(levels, 1.0)
    closeness = np.exp(4 * directions.vertices @ cage.vertices.T)
    closeness *= np.random.default_rng(seed).uniform(0.5, 1.5, closeness.shape)
    weights = closeness / closeness.sum(axis=1, keepdims=True)
    return Binding(TriMesh(weights @ cage.vertices, directions.faces), cage, weights)


def true_weights(binding: Binding, size: float = 0.05) -> np.ndarray:
    """Affine-exact weights that differ from those of the binding by smooth functions."""
    from cageik_cli.fit.problem import complement_basis

    basis = complement_basis(binding.cage)
    x = binding.rest.vertices
    shapes = np.column_stack([x, x**2, np.sin(3 * x)])
    mixed = shapes @ np.random.default_rng(5).normal(size=(shapes.shape[1], basis.shape[1]))
    return binding.weights + size * mixed @ basis.T


def cage_motion(binding: Binding, count: int, size: float = 0.1) -> np.ndarray:
    """Random displacements of the cage, (n, 3 count)."""
    generator = np.random.default_rng(7)
    return size * generator.normal(size=(len(binding.cage.vertices), 3 * count))


def clip_of(binding: Binding, weights: np.ndarray, count: int, size: float = 0.1) -> np.ndarray:
    """Frames, (count, m, 3), that `weights` give for random cages, turned and moved."""
    n = len(binding.cage.vertices)
    moves = cage_motion(binding, count, size).reshape(n, count, 3).transpose(1, 0, 2)
    cages = binding.cage.vertices + moves
    frames = weights @ cages
    return np.stack([f @ rotation(k).T + [k, 0, -k] for k, f in enumerate(frames)])


def smooth_motion(binding: Binding, count: int, seed: int = 7) -> np.ndarray:
    """Frames, (count, m, 3), of smooth motion that the weights of the binding cannot reproduce."""
    times = np.arange(count) / 6
    shapes = 0.12 * np.random.default_rng(seed).normal(size=(3, len(binding.cage.vertices), 3))
    waves = np.stack([np.sin(times), np.cos(2 * times), np.sin(3 * times + 1)], axis=1)
    moves = np.einsum("fs,snx->fnx", waves, shapes)
    frames = true_weights(binding) @ (binding.cage.vertices + moves)
    return np.stack([frame @ rotation(k).T + [k, 0, 0] for k, frame in enumerate(frames)])


class Frames:
    """An array of frames as a clip."""

    def __init__(self, frames: np.ndarray) -> None:
        self.frames = frames

    def __len__(self) -> int:
        return len(self.frames)

    def read_frame(self, index: int) -> np.ndarray:
        return self.frames[index]
