"""What a user names, opened and checked: clips, rest poses, cages, weights, in one scene.

Depends on `formats`, `cages`, `fit` and `store`. `scene` knows units and axes, `mesh_source` reads
one mesh, `rest_pose` opens a clip, and `weights` binds it.
"""
