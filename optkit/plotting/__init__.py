"""Figures, and the files that they make."""
