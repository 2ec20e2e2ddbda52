"""What a user names, opened and checked: clips, rest poses, cages, weights, in one scene.

Depends on `formats`, `cages`, `fit` and `store`. `source` opens what a name means, `scene` knows
units and axes, `clip` a clip and its rest pose, and `weights` binds it.
"""
