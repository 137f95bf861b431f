"""What knows nothing of the problem: errors, arrays, seeds, version, processes and files."""
