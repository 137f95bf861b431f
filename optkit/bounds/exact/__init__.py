"""Small models solved exactly, over all their states."""
