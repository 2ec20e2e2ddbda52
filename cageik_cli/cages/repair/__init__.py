"""The parts of a repair: tidy the faces, close holes, untangle, push outward.

Depends on `check` beside it and on `geometry`. Start with `repair`, which runs them.
"""
