"""Generalised barycentric coordinates: the weights H of a model in the vertices of a cage.

Depends on `geometry`. Start with `harmonic`; `bem` holds its boundary elements, and `binding` the
record of a model, its cage and its weights. `mean_value` computes another kind. `settings` has the
table of kinds, which names what computes each.
"""
