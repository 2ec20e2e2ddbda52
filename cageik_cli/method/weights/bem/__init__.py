"""Boundary elements for harmonic functions, with closed-form integrals over flat panels.

Depends on `geometry`. Start with `boundary_equation`, which assembles and solves; `panels` has
the integrals.
"""
