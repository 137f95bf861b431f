"""Clustered standard errors: by hand, statsmodels' own, replications, and what cannot be a cluster."""

import numpy as np
import pandas as pd
import pytest
import statsmodels.api as sm

from optkit.basics.errors import InputError
from optkit.models.estimation import ConditionalLogit, EstimationWarning

pytestmark = pytest.mark.filterwarnings("error")

WORKERS, TIMES = 40, 10
S = WORKERS * TIMES


@pytest.fixture(scope="module")
def data():
    """40 workers choose ten times among three offers, each by a taste of his own."""
    rng = np.random.default_rng(0)
    n = 3 * S
    d = pd.DataFrame({"pay": rng.normal(size=n), "km": rng.normal(size=n)}, index=[f"r{i}" for i in range(n)])
    d["s"], d["worker"] = np.repeat([f"s{i}" for i in range(S)], 3), np.repeat(np.arange(S) % WORKERS, 3)
    taste = (1 + rng.normal(size=WORKERS))[d.worker]
    utility = (taste * d.pay - d.km + rng.gumbel(size=n)).to_numpy().reshape(S, 3)
    d["y"] = (utility.argmax(axis=1)[:, None] == np.arange(3)).ravel().astype(int)
    return d


def fit(data, groups, **options):
    kwds = {"groups": groups} | {key: options.pop(key) for key in ("use_correction",) if key in options}
    return ConditionalLogit(data.y, data[["pay", "km"]], data.s, **options).fit(cov_type="cluster", cov_kwds=kwds)


def test_by_hand(data):
    """Sum over clusters of the outer product of their scores, one row of a situation after the other."""
    plain = ConditionalLogit(data.y, data[["pay", "km"]], data.s).fit()
    x, p = data[["pay", "km"]].to_numpy(), plain.predict().to_numpy()
    meat, spread = np.zeros((2, 2)), np.zeros((2, 2))
    for worker in range(WORKERS):
        rows = np.flatnonzero(data.worker == worker)
        score = sum((data.y.iloc[i] - p[i]) * x[i] for i in rows)
        meat += np.outer(score, score)
    for first in range(0, 3 * S, 3):
        part = slice(first, first + 3)
        mean = p[part] @ x[part]
        spread += (x[part] - mean).T @ np.diag(p[part]) @ (x[part] - mean)
    bread = np.linalg.inv(spread)
    factor = WORKERS / (WORKERS - 1) * (S - 1) / (S - 2)
    found = fit(data, data.worker)
    assert found.cov_params().to_numpy() == pytest.approx(factor * bread @ meat @ bread, rel=1e-8)
    bare = fit(data, data.worker, use_correction=False)
    assert bare.cov_params().to_numpy() == pytest.approx(bread @ meat @ bread, rel=1e-8)
    assert (found.params == plain.params).all()
    # Tastes differ between workers: the taste's error is that of 40 workers, not of 400 choices.
    assert found.bse["pay"] > 1.5 * plain.bse["pay"]
    assert float(found.t_test("pay = 0").sd.squeeze()) == pytest.approx(found.bse["pay"], rel=1e-12)


def test_statsmodels_clusters_the_same():
    """Pairs are a logistic regression on differences, whose clustered errors statsmodels has."""
    rng = np.random.default_rng(1)
    x, worker = rng.normal(size=(2 * S, 2)), np.repeat(np.arange(WORKERS), TIMES)
    utility = (x @ [1.0, -0.5] + rng.gumbel(size=2 * S)).reshape(S, 2)
    first = (utility[:, 0] > utility[:, 1]).astype(float)
    choice = np.column_stack([first, 1 - first]).ravel()
    for correct in (True, False):
        kwds = {"groups": worker, "use_correction": correct}
        ours = ConditionalLogit(choice, x, np.repeat(np.arange(S), 2)).fit(cov_type="cluster", cov_kwds=kwds)
        logit = sm.Logit(first, x[::2] - x[1::2])
        theirs = logit.fit(method="newton", tol=1e-14, disp=0, cov_type="cluster", cov_kwds=kwds)
        assert ours.bse == pytest.approx(theirs.bse, rel=1e-8)
        assert ours.cov_type == theirs.cov_type == "cluster"
        assert ours.cov_kwds["use_correction"] is correct


def test_one_situation_each_is_the_plain_sandwich(data):
    alone = fit(data, data.s, use_correction=False)
    robust = ConditionalLogit(data.y, data[["pay", "km"]], data.s).fit(cov_type="HC0")
    assert alone.cov_params().to_numpy() == pytest.approx(robust.cov_params().to_numpy(), rel=1e-10)


def test_weights_are_replications_within_the_cluster(data):
    times = np.random.default_rng(2).integers(0, 3, S)
    weighted = fit(data, data.worker, weights=times)
    again = np.repeat(np.arange(3 * S), np.repeat(times, 3))
    copy = np.concatenate([np.arange(t) for t in np.repeat(times, 3)])
    more = data.iloc[again].assign(s=list(zip(data.s.iloc[again], copy, strict=True))).reset_index(drop=True)
    repeated = fit(more, more.worker)
    assert weighted.bse.to_numpy() == pytest.approx(repeated.bse.to_numpy(), rel=1e-9)


def test_clusters_are_found_by_row_by_situation_and_by_label(data):
    right = fit(data, data.worker).bse
    by_situation = data.drop_duplicates("s").set_index("s")["worker"]
    names = data.worker.map("worker {}".format)
    shuffled = data.worker.sample(frac=1.0, random_state=0)
    ways = (data.worker.to_numpy(), names, names.tolist(), shuffled, by_situation, by_situation.to_numpy())
    for groups in (*ways, by_situation.sample(frac=1.0, random_state=0), names.astype("category")):
        assert fit(data, groups).bse.to_numpy() == pytest.approx(right.to_numpy(), rel=1e-12)
    hidden = (data.y == 0) & (np.arange(3 * S) % 7 == 0)
    holed = data.assign(open=~hidden, worker=data.worker.astype(float).mask(hidden))
    model = ConditionalLogit.from_formula("y ~ pay + km", holed, groups="s", available="open")
    formula = model.fit(cov_type="cluster", cov_kwds={"groups": "worker"})
    assert formula.bse.to_numpy() == pytest.approx(fit(data, data.worker, available=~hidden).bse.to_numpy(), rel=1e-9)
    words = str(formula.summary())
    assert "Standard errors: Sandwich of 40 clusters, with the small-sample correction." in words
    assert formula.cov_kwds["n_groups"] == WORKERS


def test_sets_of_one_are_in_no_cluster(data):
    alone = pd.DataFrame({"pay": 1.0, "km": 2.0, "s": "solo", "worker": 999, "y": 1}, index=["solo"])
    more = pd.concat([data, alone])
    with pytest.warns(EstimationWarning, match="1 situations offer nothing but what was chosen"):
        found = fit(more, more.worker)
    assert found.bse.to_numpy() == pytest.approx(fit(data, data.worker).bse.to_numpy(), rel=1e-9)


@pytest.mark.parametrize(
    ("kwds", "words"),
    [
        (None, "needs cov_kwds = .'groups'"),
        ({}, "needs cov_kwds = .'groups'"),
        ([1], "cov_kwds is a list; give a dict"),
        ({"groups": "worker"}, "'worker' is not a column of the data of a formula"),
        ({"groups": np.zeros(S)}, "all situations are in one cluster"),
        ({"groups": np.arange(7)}, r"the clusters has shape .7,.; give one per row .1200. or one per situation"),
        ({"groups": np.arange(3 * S)}, "the clusters differ within situation 's0'"),
        ({"groups": np.where(np.arange(S) == 5, np.nan, 1.0)}, "the cluster of situation 's5' is missing"),
        ({"groups": pd.Series(range(S))}, "the clusters has no label 's0'"),
        ({"groups": np.arange(S), "df_correction": True}, "cov_kwds has 'df_correction'"),
        ({"groups": np.arange(S), "use_correction": "hac"}, "use_correction = 'hac' is neither True nor False"),
    ],
)
def test_what_cannot_be_clusters_is_refused(data, kwds, words):
    with pytest.raises(InputError, match=words) as caught:
        ConditionalLogit(data.y, data[["pay", "km"]], data.s).fit(cov_type="cluster", cov_kwds=kwds)
    assert "\n" not in str(caught.value)


def test_other_errors_know_no_clusters_and_few_clusters_are_told(data):
    with pytest.raises(InputError, match="cov_kwds has 'groups', which cov_type = 'HC0' does not know"):
        ConditionalLogit(data.y, data[["pay", "km"]], data.s).fit(cov_type="HC0", cov_kwds={"groups": data.worker})
    with pytest.warns(EstimationWarning, match="4 clusters are few"):
        fit(data, data.worker % 4)
