"""Points, splats and gradients in a cage: what else moves with the model.

Start with `motion`; `field` evaluates harmonic weights and their gradients at any point.
"""
