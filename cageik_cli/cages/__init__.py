"""Cages: tests whether a cage fits a model, and the weights of the model in it.

Depends on `coordinates` and `geometry`. Start with `bind`; `faults` tests the cage alone,
`enclosure` the cage around a model, and `diagnosis` collects all findings.
"""
