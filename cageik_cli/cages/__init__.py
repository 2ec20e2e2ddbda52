"""Cages: built around a model, checked, repaired, and bound to it.

Depends on `method`, `geometry` and `util`. Start with `bind`; `check/diagnosis` collects all that
is wrong with a cage, `builder/build` makes one, and `repair/repair` mends one.
"""
