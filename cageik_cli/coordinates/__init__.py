"""Generalised barycentric coordinates: the weights H that write a model in a cage's vertices.

Depends on `geometry`. Start with `harmonic`; `bem` holds the boundary elements that it solves
with, and `binding` the model, its cage and its weights together.
"""
