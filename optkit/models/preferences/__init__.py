"""Utilities and noise scales of workers, from logged offers."""
