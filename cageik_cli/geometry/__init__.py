"""Triangle meshes and the geometry of surfaces: distances, intersections, rotations.

Depends on `util` only. Start with `mesh`, whose `TriMesh` is what everything else takes.
"""
