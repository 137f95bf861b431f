"""The paper's experiments as named studies: grids of cells, each worked out once, kept, and drawn together."""
