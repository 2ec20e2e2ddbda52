"""What the player of a page shows: meshes, weights and cages, packed for a script to draw."""
