"""Inverse kinematics: the same solve with a few anchors on the surface instead of all vertices.

Depends on `method.weights` and `method.solve`. Start with `poser`, from anchors' targets to a cage;
`anchors` are points of the surface, and `constraints` what holds them.
"""
