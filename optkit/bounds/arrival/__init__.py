"""Bounds of those who know every arrival, but not the workers' noise."""
