"""Cages: built around a model, checked, repaired, and bound to it.

Depends on `method`. `builder` builds one, `check` finds what is wrong with one, `repair` mends it;
`bind` checks a cage around a rest pose and computes the weights.
"""
