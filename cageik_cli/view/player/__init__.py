"""What the scripts of a page draw and pose: clips, cages and weights, packed for a page."""
