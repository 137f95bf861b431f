# /// script
# [tool.marimo.display]
# theme = "system"
# ///
"""The first-order condition, the constant markup and Lambert's W; a solver beside the formula; the dual certificate."""

import marimo

app = marimo.App(width="compact", app_title="3 Markup · optkit")

with app.setup:
    from base64 import b64encode

    import marimo as mo
    import numpy as np
    from matplotlib.figure import Figure
    from scipy.special import lambertw

    from optkit.models.choice import acceptance_probabilities
    from optkit.models.pricing import certify, optimal_prices
    from optkit.models.pricing_program import PricingProgram
    from optkit.plotting.boxes import COLOURS
    from optkit.plotting.files import figure_bytes

    PROGRAM = PricingProgram(3, nonnegative=False)

    def picture(axes, alt):
        """Show a figure at a size that can be read on a phone and does not shout on a screen."""
        # Within the page: a file of its own might be gone, once a slider moves on, before a browser has it.
        data = "data:image/png;base64," + b64encode(figure_bytes(axes, "png")).decode()
        return mo.image(data, alt=alt, style={"width": "100%", "max-width": "36rem"})


@app.cell
def _():
    mo.md(r"""
    # 3 · One markup for all

    Serving request $i$ now is worth $v_i = r_i - \beta_i\,1[i \text{ expires now}] - \Delta_i$ before paying for it:
    its reward and the penalty that is avoided, less the opportunity cost of not having it later. Notebook 5 finds
    $\Delta_i$. Here there are no penalties, and waiting is worth nothing, so that $v_i = r_i$.

    Three requests: the first is yours to shape, the others bring 20 and 15 and have utilities $-11$ and $-6$; to take
    none has utility $u_0 = 0$. Prices may have either sign, as in Lemma 3; notebook 4 forbids negative ones.
    """)
    return


@app.cell
def _():
    r = mo.ui.slider(0, 30, 0.5, value=18, label="Reward of request 1, $r_1$ (money)", show_value=True, full_width=True)
    u = mo.ui.slider(-20, 0, 0.5, value=-8, label="Its utility, $u_1$ (money)", show_value=True, full_width=True)
    mu = mo.ui.slider(0.5, 6, 0.1, value=2, label=r"Noise scale $\mu$ (money)", show_value=True, full_width=True)
    mo.vstack([r, u, mu])
    return mu, r, u


@app.cell
def _(r, u):
    value = np.array([r.value, 20.0, 15.0])
    utility = np.array([u.value, -11.0, -6.0])
    advantage = value + utility
    return advantage, utility, value


@app.cell
def _():
    mo.md(r"""
    ## The first-order condition

    Write $a_i = v_i + u_i - u_0$. The profit over probabilities is $\sum_i P_i\,(a_i - \mu \ln P_i + \mu \ln P_0)$ with
    $P_0 = 1 - \sum_i P_i$, and it is concave: its derivatives vanish at the optimum and only there.

    $$a_i - \mu \ln P_i + \mu \ln P_0 - \frac{\mu}{P_0} = 0 \quad \text{for every } i$$

    Since $c_i = u_0 - u_i + \mu \ln P_i - \mu \ln P_0$, this says $v_i - c_i = \mu / P_0$. The right-hand side does not
    know $i$: **every request has the same markup** $m = \mu / P_0$.
    """)
    return


@app.cell
def _(advantage, mu, utility, value):
    best = optimal_prices(value, utility, mu.value, nonnegative=False)
    residual = advantage - mu.value * np.log(best.acceptance / best.rejection) - mu.value / best.rejection
    assert np.abs(residual).max() < 1e-8
    assert np.allclose(value - best.compensation, best.markup)
    assert np.isclose(best.markup, mu.value / best.rejection)
    mo.md(
        f"Prices ({', '.join(f'{c:.2f}' for c in best.compensation)}), all of them "
        f"<output data-number='markup'>{best.markup:.4f}</output> below the values. The largest derivative of the "
        f"profit is {np.abs(residual).max():.2g} money per unit of probability."
    )
    return (best,)


@app.cell
def _():
    mo.md(r"""
    ## Lambert's W

    The condition gives $P_i = P_0\, e^{(a_i - m)/\mu}$ with $P_0 = \mu / m$. All probabilities make 1; multiply that by
    $e^{m/\mu - 1}\, m/\mu$ and one equation in one unknown is left (Lemma 3, appendix A.3):

    $$y\,e^{y} = \sum_i e^{a_i/\mu - 1}, \qquad y = \frac{m}{\mu} - 1 .$$

    The function that solves $y e^y = x$ has a name, Lambert's $W_0(x)$. So $m = \mu\,(1 + W_0(\sum_i e^{a_i/\mu - 1}))$
    and the expected profit is $m - \mu = \mu y$.
    """)
    return


@app.cell
def _(advantage, best, mu):
    x = np.exp(advantage / mu.value - 1).sum()
    y = lambertw(x).real
    assert np.isclose(y * np.exp(y), x)
    assert np.isclose(mu.value * (1 + y), best.markup)
    assert np.isclose(mu.value * y, best.profit)
    mo.md(
        f"Here $x$ = {x:.6g} and $y$ = {y:.6f}: the markup is {mu.value * (1 + y):.4f} and the profit "
        f"{mu.value * y:.4f}."
    )
    return


@app.cell
def _():
    mo.md(r"""
    For large $a_i/\mu$ the sum $x$ overflows, while $y$ is a moderate number. optkit therefore works with $\ln x$ and
    evaluates $W_0(e^z)$ as SciPy's `wrightomega(z)`.
    """)
    return


@app.cell
def _():
    huge = optimal_prices([3000.0, 2000.0], [0.0, 0.0], 1.0)
    with np.errstate(over="ignore"):
        assert np.isinf(np.exp(3000.0 - 1))
    assert certify(huge.compensation, [3000.0, 2000.0], [0.0, 0.0]).optimal
    mo.md(f"With a request worth 3000 at $\\mu = 1$, $x$ overflows; the markup is {huge.markup:.3f}, and certified.")
    return


@app.cell
def _():
    mo.md(r"""
    ## The whole family at a glance

    Since one number decides, we can draw the problem: the profit of the prices $v_i - m$ for every markup $m$. Its top
    is where the curve meets the straight line $m - \mu$.
    """)
    return


@app.cell
def _(best, mu, utility, value):
    _m = np.linspace(0, 2.2 * best.markup, 201)
    _p, _ = acceptance_probabilities(value - _m[:, None], utility, mu.value)
    _profit = _p.sum(axis=1) * _m
    assert (_profit <= best.profit + 1e-9).all()
    _ax = Figure(figsize=(4.4, 3.1), layout="constrained").subplots()
    _ax.plot(_m, _profit, color=COLOURS[0], label="profit of the prices $v_i - m$")
    _ax.plot(_m, _m - mu.value, color="0.45", linestyle="--", label=r"$m - \mu$")
    _ax.plot(best.markup, best.profit, "o", color=COLOURS[1], label="optimum")
    _ax.set_xlim(0, _m[-1])
    _ax.set_ylim(0, 1.15 * best.profit)
    _ax.set_xlabel("markup $m$ (money)")
    _ax.set_ylabel("expected profit (money)")
    _ax.legend(loc="lower center", bbox_to_anchor=(0.45, 1.0), ncols=3, frameon=False, fontsize=9, columnspacing=1.0)
    picture(_ax, "Expected profit against the common markup, with the optimum")
    return


@app.cell
def _():
    mo.md(r"""
    ## A solver that knows none of this

    CVXPY gets the concave program and hands it to Clarabel, an interior-point solver for exponential cones:
    `a @ P - mu * sum(rel_entr(P, P0))` over the simplex. The two columns must agree.
    """)
    return


@app.cell
def _(best, mu, utility, value):
    solved = PROGRAM.solve(value, utility, mu.value)
    assert abs(solved.profit - best.profit) < 1e-5 * (mu.value + best.profit)
    assert np.allclose(solved.acceptance, best.acceptance, atol=5e-4)
    rows = [("profit (money)", best.profit, solved.profit), ("markup (money)", best.markup, solved.markup)]
    rows += [(f"price {i + 1} (money)", best.compensation[i], solved.compensation[i]) for i in range(3)]
    rows += [(f"probability {i + 1}", best.acceptance[i], solved.acceptance[i]) for i in range(3)]
    rows += [("rejection", best.rejection, solved.rejection)]
    table = "\n".join(f"| {name} | {one:.4f} | {two:.4f} |" for name, one, two in rows)
    mo.md(
        f"| | closed form | CVXPY |\n|:--|--:|--:|\n{table}\n\nExpected profit by formula: "
        f"<output data-number='profit'>{best.profit:.4f}</output>, by CVXPY: "
        f"<output data-number='profit-cvxpy'>{solved.profit:.4f}</output> money."
    )
    return


@app.cell
def _():
    mo.md(r"""
    ## A certificate

    Whoever does not trust formulas or solvers wants a proof. Take any number $R$ with

    $$\mu \sum_i e^{(a_i - R)/\mu - 1} \le R .$$

    For every price, $e^{(u_i - u_0 + c_i)/\mu}\,(v_i - c_i - R)$ is at most $\mu\, e^{(a_i - R)/\mu - 1}$, its largest
    value over $c_i$. Add up and multiply by $P_0$: $\sum_i P_i (v_i - c_i) \le R$. So **no prices whatever earn more
    than $R$**, and the smallest such $R$ is the optimal profit.
    """)
    return


@app.cell
def _():
    guess = mo.ui.slider(50, 150, 1, value=110, label="$R$ (per cent of the profit)", show_value=True, full_width=True)
    guess
    return (guess,)


@app.cell
def _(advantage, best, guess, mu):
    R = guess.value / 100 * best.profit
    left = mu.value * np.exp((advantage - R) / mu.value - 1).sum()
    proves = left <= R * (1 + 1e-12)
    if guess.value != 100:
        assert proves == (guess.value > 100)
    mo.md(
        f"$R$ = {R:.4f}: the left-hand side is {left:.4f}. "
        + (f"**It proves that nobody earns more than {R:.4f}.**" if proves else "**It proves nothing.**")
    )
    return


@app.cell
def _():
    mo.md(r"""
    `optkit.models.pricing.certify` does this for any prices, whoever proposed them: it compares their profit with an
    $R$ that satisfies the inequality, rounding included. Spoil the price of request 1 and see the verdict.
    """)
    return


@app.cell
def _():
    spoil = mo.ui.slider(
        -5, 5, 0.5, value=1, label="Added to the price of request 1 (money)", show_value=True, full_width=True
    )
    spoil
    return (spoil,)


@app.cell
def _(best, mu, spoil, utility, value):
    proposed = best.compensation + np.array([spoil.value, 0.0, 0.0])
    proof = certify(proposed, value, utility, mu.value, nonnegative=False)
    assert proof.bound >= best.profit - 1e-9
    if spoil.value == 0:
        assert proof.optimal
    mo.md(
        f"Verdict: **{'optimal' if proof.optimal else 'not optimal'}**. These prices earn {proof.profit:.4f}, "
        f"nobody can earn more than {proof.bound:.4f}: the gap is "
        f"<output data-number='gap'>{abs(proof.gap):.4f}</output> money."
    )
    return


@app.cell
def _(best, mu, utility, value):
    _tries = best.compensation + np.random.default_rng(5).normal(0, 2 * mu.value, (2000, 3))
    found = certify(_tries, np.tile(value, (2000, 1)), utility, mu.value, nonnegative=False)
    assert (found.profit <= found.bound).all()
    mo.md(f"Of 2,000 random prices none beats the bound {best.profit:.4f}; the best earns {found.profit.max():.4f}.")
    return


if __name__ == "__main__":
    app.run()
