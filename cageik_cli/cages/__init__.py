"""Cages: is one fit for a model, what is wrong with it, and the weights of a model in it.

Depends on `coordinates` and `geometry`. Start with `bind`; `soundness` tests the cage alone,
`enclosure` the cage around a model, and `diagnosis` gathers every finding.
"""
