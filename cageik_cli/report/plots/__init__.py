"""Plots drawn by matplotlib: errors per frame, and a pose before and after."""
