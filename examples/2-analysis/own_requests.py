"""Price one decision of your own, prove it, and see what clipping the paper's prices at zero would have lost."""

import numpy as np

from optkit.models.pricing import certify, optimal_prices
from optkit.models.pricing_program import PricingProgram

# Three requests that a worker may take now: what serving each is worth to the platform, and its utility to the worker.
# The first two are worth little, but workers like them: they are taken even for nothing.
value = np.array([1.0, 2.0, 6.0])
utility = np.array([2.0, 1.0, -3.0])

best = optimal_prices(value, utility, mu=1.0)
print("compensations", best.compensation.round(4), " acceptance", best.acceptance.round(4))
print(f"expected profit {best.profit:.4f}, markup {best.markup:.4f}, rejection {best.rejection:.4f}")

# The certificate needs no trust in the formula: it bounds the profit of every price vector.
proof = certify(best.compensation, value, utility)
print(proof.summary())
assert proof.optimal

# An independent solver finds the same profit.
solved = PricingProgram(3).solve(value, utility)
assert abs(solved.profit - best.profit) < 1e-6

# The paper's clipping sets its negative prices to zero and keeps the other; that is not the optimum.
clipped = optimal_prices(value, utility, nonnegative="clip")
lost = best.profit - clipped.profit
print(f"clipping loses {lost:.4f} of {best.profit:.4f}")
assert lost > 0
assert not certify(clipped.compensation, value, utility).optimal
