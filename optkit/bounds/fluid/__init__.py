"""Bounds from expected numbers of arrivals alone."""
