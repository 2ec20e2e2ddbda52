"""Factors that make models and cages degenerate."""

import numpy as np

FACTORS = {
    "flat": (np.array([1.0, 1, 0]), 1.0),
    "thin": (np.array([1e-12, 1, 0]), 1.0),
    "a point": (np.zeros(3), 1.0),
    "nothing but a point": (np.zeros(3), 0.0),
    "huge": (np.full(3, 1e30), 1e30),
    "tiny": (np.full(3, 1e-30), 1e-30),
    "a cage far away": (np.ones(3), 1e30),
    "a cage turned inside out": (np.ones(3), -0.3),
}
