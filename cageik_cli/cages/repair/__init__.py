"""The parts of a repair: tidy the faces, close holes, untangle, push outward.

Depends on `cages.check` and `geometry`. Start with `repair`, which runs them.
"""
