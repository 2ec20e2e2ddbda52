"""What is wrong with a cage: alone, around a model, and how well it will hold it.

Start with `diagnosis`, which collects all findings; `faults` tests the cage alone, `enclosure` the
cage around a model, and `misfit` says why a model is not inside.
"""
