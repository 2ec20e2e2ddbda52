"""Inverse kinematics: the same solve with a few anchors on the surface instead of all vertices.

Depends on `weights`, `solve` and `geometry`. Start with `poser`, from anchors' targets to a cage;
`anchors` are its rows, and `constraints` locks and mirrors cage vertices.
"""
