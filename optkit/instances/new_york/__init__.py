"""Instances from New York's taxi trip records."""
