"""How a point inside a cage is written in the cage's vertices."""
