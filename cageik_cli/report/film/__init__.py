"""Films of a result for people without cageik: a clip, or a turn around the model."""
