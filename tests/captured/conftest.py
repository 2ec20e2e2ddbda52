"""Noise that does not depend on the tests that ran before."""

import numpy as np
import pytest


@pytest.fixture(autouse=True)
def restarted_noise(request, monkeypatch):
    """Let each test draw what it draws alone, in whatever order tests run."""
    if hasattr(request.module, "RNG"):
        monkeypatch.setattr(request.module, "RNG", np.random.default_rng(11))
