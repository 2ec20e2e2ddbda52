"""Pictures with axes, drawn by matplotlib: errors over frames, and a pose before and after."""
