"""A small renderer in numpy: shaded meshes and cages as pixels. Start with `model_views`."""
