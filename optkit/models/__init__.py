"""The mathematics of one decision: choice, pricing, the pricing program and its certificate."""
