"""Inverse kinematics: the same solve with a few anchors on the surface instead of all vertices.

Depends on `solver`, `coordinates` and `geometry`. Start with `poser`, from anchors' targets to a
cage; `handles` reads them from a file, and `edits` applies them to an animation.
"""
