"""The bound of who knows everything: a matching of workers and requests."""
