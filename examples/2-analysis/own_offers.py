"""Learn what workers want from a log of offers, and see a log that cannot tell.

The log is a table with one row per request shown: the situation, the compensation, whether it was taken, and what
describes the request. Here a small platform's log is simulated; yours comes from a file.
"""

import numpy as np
import pandas as pd

from optkit.models.estimation import NotIdentifiedError, identification
from optkit.models.preferences.fit import fit_preferences
from optkit.models.preferences.offers import Offers


def platform_log(situations: int, least_pay: float, seed: int) -> pd.DataFrame:
    """Offers of two to four rides each to workers with utility -3 - 1.2 kilometres and noise scale 1.5."""
    rng = np.random.default_rng(seed)
    rows = []
    for situation in range(situations):
        n = rng.integers(2, 5)
        kilometres = rng.uniform(1.0, 8.0, n)
        pay = rng.uniform(least_pay, least_pay + 10.0, n)
        noise = rng.gumbel(-1.5 * np.euler_gamma, 1.5, n + 1)
        utility = np.append(-3.0 - 1.2 * kilometres + pay, 0.0) + noise
        for i in range(n):
            rows.append((f"night {situation}", kilometres[i], pay[i], int(utility.argmax() == i)))
    return pd.DataFrame(rows, columns=["situation", "kilometres", "compensation", "chosen"])


# Offers around what a ride is worth to workers: some are taken, some nights all are refused.
offers = Offers.from_frame(platform_log(3000, least_pay=2.0, seed=1))
learned = fit_preferences(offers)
table = learned.table().set_index("parameter")
print(table)
print(identification(learned.results[0]).summary())
for name, truth in {"kilometres": -1.2, "constant": -3.0, "mu": 1.5}.items():
    row = table.loc[name]
    assert abs(row["estimate"] - truth) < 4 * row["standard_error"], name

# Offers so generous that nobody ever refuses: the log cannot tell how much less would have done.
generous = Offers.from_frame(platform_log(3000, least_pay=40.0, seed=2))
assert generous.n_choices == generous.n_situations
try:
    fit_preferences(generous)
except NotIdentifiedError as error:
    print(f"\nrefused: {error}")
else:
    raise AssertionError("a log without a refusal says nothing of the level of utility")
