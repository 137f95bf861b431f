# /// script
# [tool.marimo.display]
# theme = "system"
# ///
"""Post-decision states and Lemma 1, with a small model solved exactly by hand-written backward induction."""

import marimo

app = marimo.App(width="compact", app_title="5 Post-decision states · optkit")

with app.setup:
    from base64 import b64encode
    from functools import cache
    from itertools import product

    import marimo as mo
    import numpy as np
    from matplotlib.figure import Figure

    from optkit import simulate
    from optkit.bounds import SmallModel, exact_value
    from optkit.bounds.exact.exact_value import solve_exactly
    from optkit.bounds.exact.table import ExactTable
    from optkit.learning.beliefs import BelievedValue
    from optkit.models.choice import acceptance_probabilities
    from optkit.models.pricing import optimal_prices
    from optkit.plotting.boxes import COLOURS
    from optkit.plotting.files import figure_bytes
    from optkit.policies import PostDecisionPricing

    ARRIVAL = np.array([0.6, 0.4])
    LIFETIME = (1, 2)
    UTILITY = np.array([-10.0, -28.0])
    MU = 4.0

    def picture(axes, alt):
        """Show a figure at a size that can be read on a phone and does not shout on a screen."""
        # Within the page: a file of its own might be gone, once a slider moves on, before a browser has it.
        data = "data:image/png;base64," + b64encode(figure_bytes(axes, "png")).decode()
        return mo.image(data, alt=alt, style={"width": "100%", "max-width": "36rem"})


@app.cell
def _():
    mo.md(r"""
    # 5 · What waiting is worth

    Notebooks 3 and 4 took the values $v_i$ as given. They hold an opportunity cost: serve a request now, and it is not
    there for a later worker. This notebook computes that cost exactly, on a model that is small enough.

    Two types of requests arrive with probabilities 0.6 and 0.4 a step. They bring rewards 30 and 50, have utilities
    $-10$ and $-28$ to the worker, and can wait one and two further steps. All end with the last step. Moods have scale
    $\mu = 4$, and to take none has utility 0.
    """)
    return


@app.cell
def _():
    steps = mo.ui.slider(2, 6, 1, value=5, label="Steps $T$", show_value=True, full_width=True)
    worker = mo.ui.slider(
        0.1, 1, 0.1, value=0.8, label="Probability of a worker, a step", show_value=True, full_width=True
    )
    beta = mo.ui.slider(-20, 0, 1, value=-15, label=r"Penalty $\beta$ (money)", show_value=True, full_width=True)
    mo.vstack([steps, worker, beta])
    return beta, steps, worker


@app.cell
def _(beta, steps, worker):
    T, q = steps.value, worker.value
    reward, penalty = np.array([30.0, 50.0]), float(beta.value)
    return T, penalty, q, reward


@app.cell
def _():
    mo.md(r"""
    ## Two moments in a step

    Before the decision the platform sees the open requests $R_t$ and the worker, if there is one. After it, whoever
    was chosen has left, the expired have left, and nothing new has come yet: the *post-decision state* (paper, sections
    2 and 3.1). From there to the next decision only arrivals are random; up to there
    only the worker's choice is.
    """)
    return


@app.cell
def _():
    mo.md(r"""
    ## Lemma 1

    Let $R'_t$ be the requests that do not expire now, and $V^p_t$ the value of a post-decision state. Then

    $$\begin{aligned} V_t(R_t, \text{worker}) = \; &\max_c \sum_i P_i(c)\,(v_i - c_i) \\
      &+ V^p_t(R'_t) + \sum_{i \text{ expires}} \beta_i, \end{aligned}$$

    $$v_i = r_i - \beta_i\,1[i \text{ expires}] - \Delta_i,$$

    $$\Delta_i = V^p_t(R'_t) - V^p_t(R'_t \setminus i).$$

    Without a worker the first term is missing. So the whole future enters through one number per request, and the
    decision is the pricing problem of notebooks 3 and 4.
    """)
    return


@app.cell
def _():
    mo.md(r"""
    ## Backward induction, by hand

    A request is a pair (type, last step), a state is a sorted tuple of them. Two functions call each other, from the
    end backwards: the value after a decision averages over arrivals, the value before it uses Lemma 1.
    """)
    return


@app.cell
def _(T, penalty, q, reward):
    def without(state, request):
        """The state less one of its requests; the same if it is not there, since it expires."""
        rest = list(state)
        if request in rest:
            rest.remove(request)
        return tuple(rest)

    @cache
    def after(t, waiting):
        """V^p_t: what waiting requests, and those to come, will earn."""
        if t == T - 1:
            return 0.0
        total = 0.0
        for comes in product((0, 1), repeat=2):
            p = np.prod(np.where(comes, ARRIVAL, 1 - ARRIVAL))
            new = [(k, min(t + 1 + LIFETIME[k], T - 1)) for k in range(2) if comes[k]]
            open_now = tuple(sorted([*waiting, *new]))
            total += p * (q * before(t + 1, open_now, True) + (1 - q) * before(t + 1, open_now, False))
        return total

    def values(t, state):
        """The values v_i of Lemma 1."""
        keeps = tuple(r for r in state if r[1] > t)
        return np.array(
            [
                reward[k] - penalty * (end == t) - (after(t, keeps) - after(t, without(keeps, (k, end))))
                for k, end in state
            ]
        )

    @cache
    def before(t, state, has_worker):
        """V_t by Lemma 1."""
        keeps = tuple(r for r in state if r[1] > t)
        rest = after(t, keeps) + penalty * (len(state) - len(keeps))
        if not has_worker or not state:
            return rest
        return rest + optimal_prices(values(t, state), UTILITY[[k for k, _ in state]], MU).profit

    by_hand = after(-1, ())
    return after, before, by_hand, values, without


@app.cell
def _():
    mo.md(r"""
    ## The same by optkit

    `optkit.bounds.exact.exact_value` solves small models with an induction of its own, over numbers of identical
    requests instead of lists, and certifies the result. The two must agree to the last digits.
    """)
    return


@app.cell
def _(T, by_hand, penalty, q, reward):
    model = SmallModel(
        horizon=T,
        reward=reward,
        penalty=[penalty, penalty],
        lifetime=LIFETIME,
        utility=[UTILITY],
        mu=[MU],
        arrivals=ARRIVAL,
        workers=[1 - q, q],
    )
    bound = exact_value(model)
    assert abs(bound.value - by_hand) < 1e-9 * (1 + abs(by_hand))
    assert bound.certificate.check(model).gap < 1e-9
    mo.md(
        f"By hand: <output data-number='by-hand'>{by_hand:.6f}</output> money over {T} steps; by optkit: "
        f"<output data-number='exact'>{bound.value:.6f}</output>, from {bound.solver.details['states']} states, with a "
        f"certificate that checks."
    )
    return (model,)


@app.cell
def _():
    mo.md(r"""
    ## Is Lemma 1 true?

    The induction used it, so let us test it on its own. Take two open requests of which one expires, a worker, and
    *any* prices. Write down what can happen, one choice after the other, and compare with the lemma's form.
    """)
    return


@app.cell
def _(T, after, penalty, reward, values, without):
    _t = T - 2
    _state = ((0, _t), (1, T - 1))  # the first expires now, the second can wait
    _keeps = (_state[1],)
    _u = UTILITY[[0, 1]]
    _worst = 0.0
    for _prices in np.random.default_rng(2).uniform(0, 40, (200, 2)):
        _p, _none = acceptance_probabilities(_prices, _u, MU)
        # The Bellman equation: each choice with its own payment, penalty and post-decision state.
        _direct = _none * (penalty + after(_t, _keeps))
        _direct += _p[0] * (reward[0] - _prices[0] + after(_t, _keeps))
        _direct += _p[1] * (reward[1] - _prices[1] + penalty + after(_t, without(_keeps, _state[1])))
        _lemma = _p @ (values(_t, _state) - _prices) + after(_t, _keeps) + penalty
        _worst = max(_worst, abs(_direct - _lemma))
    assert _worst < 1e-10
    mo.md(f"Over 200 random price vectors the two sides differ by at most {_worst:.0e} money.")
    return


@app.cell
def _():
    mo.md(r"""
    ## Opportunity costs

    At each step but the last, one request of each type has just arrived and waits. A positive $\Delta_i$ is a reason to
    pay less for it now. A negative one is a reason to pay more: to let it wait is expected to cost more in penalties
    than a later worker brings.
    """)
    return


@app.cell
def _(T, after, model):
    solution = solve_exactly(model)
    _rows = []
    for _t in range(T - 1):
        _left = [min(life, T - 1 - _t) for life in LIFETIME]
        _delta = solution.opportunity_cost(_t, [0, 1], _left)
        _state = ((0, _t + _left[0]), (1, _t + _left[1]))
        _hand = [after(_t, _state) - after(_t, _state[1:]), after(_t, _state) - after(_t, _state[:1])]
        assert np.allclose(_delta, _hand, atol=1e-8)
        _rows.append(f"| {_t} | {_delta[0]:.3f} | {_delta[1]:.3f} |")
    mo.md(
        "| step | $\\Delta_1$ (money) | $\\Delta_2$ (money) |\n|:--|--:|--:|\n"
        + "\n".join(_rows)
        + "\n\nThe table is optkit's; the induction by hand gives the same."
    )
    return (solution,)


@app.cell
def _():
    mo.md(r"""
    ## More workers, dearer waiting

    How much a request that waits is worth depends on who may come. Here is $\Delta$ of each type, alone and in the
    company of the other, as workers become more likely.
    """)
    return


@app.cell
def _(T, penalty, q, reward):
    _grid = np.linspace(0.1, 1.0, 7)
    _delta = []
    for _q in _grid:
        _one = SmallModel(
            horizon=T, reward=reward, penalty=[penalty] * 2, lifetime=LIFETIME, utility=[UTILITY], mu=[MU],
            arrivals=ARRIVAL, workers=[1 - _q, _q],
        )  # fmt: skip
        _kinds, _there = [[0, 0], [1, 1], [0, 1]], [[True, False], [True, False], [True, True]]
        _cost = solve_exactly(_one).opportunity_cost(0, _kinds, np.minimum(np.take(LIFETIME, _kinds), T - 1), _there)
        _delta.append([_cost[0, 0], _cost[1, 0], _cost[2, 0], _cost[2, 1]])
    _ax = Figure(figsize=(4.4, 3.1), layout="constrained").subplots()
    _lines = np.array(_delta).T
    for _i, _name in enumerate(["type 1 alone", "type 2 alone", "type 1, with type 2", "type 2, with type 1"]):
        _ax.plot(_grid, _lines[_i], color=COLOURS[_i % 2], linestyle="-" if _i < 2 else "--", label=_name)
    _ax.axhline(0, color="0.8", linewidth=1, zorder=0)
    _ax.axvline(q, color="0.6", linewidth=1)
    _ax.set_xlabel("probability of a worker, a step")
    _ax.set_ylabel(r"opportunity cost $\Delta$ (money)")
    _ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, frameon=False, fontsize=9)
    picture(_ax, "Opportunity costs against the probability of a worker")
    return


@app.cell
def _():
    mo.md(r"""
    ## Does it pay to think ahead?

    Simulate 750 days with Gumbel moods, twice: the *myopic* policy takes $\Delta = 0$, the *optimal* one the exact
    $\Delta$, and both price by notebook 4. The optimal mean must be the value that we computed, within chance. Since
    both meet the same days, their difference is known better than either mean.
    """)
    return


@app.cell
def _(by_hand, model, solution):
    days = model.sample(750, seed=1)
    myopic = simulate(days, PostDecisionPricing()).reward
    optimal = simulate(days, PostDecisionPricing(value_function=BelievedValue(ExactTable(solution)))).reward
    error, paired = (x.std(ddof=1) / len(days) ** 0.5 for x in (optimal, optimal - myopic))
    assert abs(optimal.mean() - by_hand) < 5 * error
    assert (optimal - myopic).mean() > -5 * paired
    mo.md(
        f"Optimal: {optimal.mean():.2f} ± {1.96 * error:.2f} (95 %), computed: {by_hand:.2f}. Optimal less myopic: "
        f"{(optimal - myopic).mean():.2f} ± {1.96 * paired:.2f} money a day."
    )
    return


@app.cell
def _():
    mo.md(r"""
    ## Beyond the small

    Real platforms have too many states for tables. The paper, and optkit, then learn $V^p_t$ from data: the pricing
    formula stays as it is, and only $\Delta_i$ becomes an estimate.
    """)
    return


if __name__ == "__main__":
    app.run()
