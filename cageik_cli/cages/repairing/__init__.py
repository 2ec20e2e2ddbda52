"""The steps of a repair: tidy the faces, close holes, push outward, untangle, judge.

Depends on `cages` (the checks) and `geometry`. Start with `cages/repair.py`, which runs them.
"""
