"""Price requests of your own from a CSV file, and prove the prices."""

import io

import pandas as pd

from optkit.models.pricing import certify, optimal_prices

# What a spreadsheet would export; utility is what serving a request is worth to the worker before pay, in money.
CSV = io.StringIO(
    """request,reward,penalty,expires,utility
lunch,30,-5,0,-10
parcel,45,-8,1,-22
keys,12,-2,1,-9
"""
)
requests = pd.read_csv(CSV, index_col="request")

# Serving what expires now also spares its penalty. Nothing is known of the future here, so waiting is worth nothing.
value = requests["reward"] - requests["penalty"] * requests["expires"]
best = optimal_prices(value, requests["utility"], mu=1.0)
requests["compensation"], requests["acceptance"] = best.compensation.round(2), best.acceptance.round(4)
print(requests)
print(f"expected profit {best.profit:.2f}, somebody refuses with probability {best.rejection:.3f}")

proof = certify(best.compensation, value, requests["utility"])
print(proof.summary())
assert proof.optimal

# Every request that is paid for leaves the platform the same markup.
paid = requests["compensation"] > 0
assert (value - requests["compensation"])[paid].round(1).nunique() == 1
