# /// script
# [tool.marimo.display]
# theme = "system"
# ///
"""Non-negative compensation: where setting negative prices to zero loses money, and the exact solution."""

import marimo

app = marimo.App(width="compact", app_title="4 Non-negative · optkit")

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

    PROGRAM = PricingProgram(3)

    def picture(axes, alt):
        """Show a figure at a size that can be read on a phone and does not shout on a screen."""
        # Within the page: a file of its own might be gone, once a slider moves on, before a browser has it.
        data = "data:image/png;base64," + b64encode(figure_bytes(axes, "png")).decode()
        return mo.image(data, alt=alt, style={"width": "100%", "max-width": "36rem"})


@app.cell
def _():
    mo.md(r"""
    # 4 · Nobody pays to work

    The problem demands $c_i \ge 0$ (paper, section 2), but Lemma 3 may ask for negative prices. The paper sets those
    to 0, keeps the others, and says that this does no harm in practice. It can: take a request that workers like so
    much that they would do it for nothing, while the platform would rather keep it.

    Requests 1 and 2 are worth 8 each and have utilities $1$ and $-4$; to take none has utility $u_0 = 0$. Request 3 is
    yours to shape.
    """)
    return


@app.cell
def _():
    v3 = mo.ui.slider(-8, 8, 0.5, value=-4, label="Value of request 3, $v_3$ (money)", show_value=True, full_width=True)
    u3 = mo.ui.slider(-4, 8, 0.5, value=6, label="Its utility, $u_3$ (money)", show_value=True, full_width=True)
    mu = mo.ui.slider(0.5, 4, 0.1, value=1, label=r"Noise scale $\mu$ (money)", show_value=True, full_width=True)
    mo.vstack([v3, u3, mu])
    return mu, u3, v3


@app.cell
def _(u3, v3):
    value = np.array([8.0, 8.0, v3.value])
    utility = np.array([1.0, -4.0, u3.value])
    return utility, value


@app.cell
def _():
    mo.md(r"""
    ## Three rules

    *Free*: Lemma 3, prices of either sign, not allowed here. *Clipped*: Lemma 3 with negative prices set to 0.
    *Exact*: the best of all prices that are at least 0.
    """)
    return


@app.cell
def _(mu, utility, value):
    free = optimal_prices(value, utility, mu.value, nonnegative=False)
    clipped = optimal_prices(value, utility, mu.value, nonnegative="clip")
    exact = optimal_prices(value, utility, mu.value)
    assert clipped.profit <= exact.profit + 1e-9 <= free.profit + 2e-9
    _rows = "\n".join(
        f"| {name} | {' | '.join(f'{c:.2f}' for c in one.compensation)} | {one.profit:.3f} |"
        for name, one in (("free", free), ("clipped", clipped), ("exact", exact))
    )
    mo.md(
        f"| | $c_1$ | $c_2$ | $c_3$ | profit |\n|:--|--:|--:|--:|--:|\n{_rows}\n\n"
        f"The exact prices earn <output data-number='exact'>{exact.profit:.4f}</output>, the clipped ones "
        f"<output data-number='clipped'>{clipped.profit:.4f}</output>: clipping loses "
        f"<output data-number='lost'>{max(exact.profit - clipped.profit, 0.0):.4f}</output> money a decision."
    )
    return clipped, exact, free


@app.cell
def _():
    reference = [optimal_prices([8.0, 8.0, -4.0], [1.0, -4.0, 6.0], nonnegative=how).profit for how in (True, "clip")]
    assert np.allclose(reference, [0.502, -3.822], atol=5e-4)
    mo.md(
        f"Where the sliders start, the exact prices earn {reference[0]:.3f} and the clipped ones {reference[1]:.3f}: "
        f"clipping turns a profit into a loss."
    )
    return


@app.cell
def _():
    mo.md(r"""
    ## Why clipping loses

    Free prices would charge for request 3, so that almost nobody takes it. At price 0 nearly everybody does. Then the
    other prices are wrong too: they should rise, to draw workers away from a request that costs the platform money.
    Clipping keeps prices that were made for a world in which request 3 is unpopular.
    """)
    return


@app.cell
def _(clipped, exact):
    _ax = Figure(figsize=(4.4, 3.1), layout="constrained").subplots()
    _x = np.arange(4)
    for _shift, _one, _name, _colour in ((-0.2, clipped, "clipped", COLOURS[1]), (0.2, exact, "exact", COLOURS[0])):
        _height = np.append(_one.acceptance, _one.rejection)
        _ax.bar(_x + _shift, _height, 0.4, color=_colour, label=_name)
        for _i in range(4):
            _ax.annotate(f"{_height[_i]:.2f}", (_i + _shift, _height[_i]), ha="center", va="bottom", fontsize=10)
    _ax.set_xticks(_x, ["request 1", "request 2", "request 3", "none"])
    _ax.set_ylabel("probability")
    _ax.set_ylim(0, 1.1)
    _ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, frameon=False, fontsize=9)
    picture(_ax, "What the worker takes at clipped and at exact prices")
    return


@app.cell
def _():
    mo.md(r"""
    ## Still a concave program

    Over probabilities, $c_i \ge 0$ says $P_i \ge P_0\, e^{(u_i - u_0)/\mu}$: a linear constraint. The program of
    notebook 3 stays concave, and CVXPY solves it with one more line.
    """)
    return


@app.cell
def _(exact, mu, utility, value):
    solved = PROGRAM.solve(value, utility, mu.value)
    assert PROGRAM.problem.is_dcp()
    assert abs(solved.profit - exact.profit) < 1e-5 * (mu.value + abs(exact.profit))
    mo.md(f"CVXPY: profit {solved.profit:.4f}; closed form: {exact.profit:.4f}.")
    return


@app.cell
def _():
    mo.md(r"""
    ## Still one number

    The optimal prices are $c_i = \max(0, v_i - m)$ with $m = \mu + \phi$, where the optimal profit $\phi$ counts the
    requests that are held at 0. Draw the profit of $\max(0, v_i - m)$ over $m$: it meets the line $m - \mu$ once, and
    there it is largest.
    """)
    return


@app.cell
def _(clipped, exact, mu, utility, value):
    _m = np.linspace(min(exact.markup, clipped.markup) - 4, max(exact.markup, clipped.markup) + 4, 401)
    _c = np.maximum(value - _m[:, None], 0.0)
    _p, _ = acceptance_probabilities(_c, utility, mu.value)
    _profit = (_p * (value - _c)).sum(axis=1)
    _above = _profit > _m - mu.value
    assert np.isclose(exact.markup, mu.value + exact.profit)
    assert np.allclose(exact.compensation, np.maximum(0.0, value - exact.markup))
    assert (_profit <= exact.profit + 1e-9).all()
    assert np.count_nonzero(np.diff(_above)) == 1
    _ax = Figure(figsize=(4.4, 3.1), layout="constrained").subplots()
    _ax.plot(_m, _profit, color=COLOURS[0], label=r"profit of $\max(0, v_i - m)$")
    _ax.plot(_m, _m - mu.value, color="0.45", linestyle="--", label=r"$m - \mu$")
    _ax.plot(clipped.markup, clipped.profit, "s", color=COLOURS[1], label="clipped")
    _ax.plot(exact.markup, exact.profit, "o", color=COLOURS[0], label="exact")
    _low, _high = _profit.min(), _profit.max()
    _ax.set_ylim(_low - 0.06 * (_high - _low), _high + 0.15 * (_high - _low))
    _ax.set_xlabel("markup $m$ (money)")
    _ax.set_ylabel("expected profit (money)")
    _ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, frameon=False, fontsize=9)
    picture(_ax, "Expected profit against the markup, with the clipped and the exact one")
    return


@app.cell
def _():
    mo.md(r"""
    ## Lambert's W again

    Let $C$ be the requests held at 0, $w_i = e^{(u_i - u_0)/\mu}$, $W_C = \sum_{i \in C} w_i$ and
    $s = \sum_{i \in C} w_i v_i / (\mu (1 + W_C))$. Then

    $$m = \mu \Big(1 + s + W_0\Big(\frac{\sum_{i \notin C} e^{a_i/\mu - 1 - s}}{1 + W_C}\Big)\Big).$$

    Requests of low value are held first. So try $C = \emptyset$, then the lowest value, then the two lowest, and so on:
    the right $C$ is the one whose $m$ holds just those with $v_i < m$.
    """)
    return


@app.cell
def _(exact, mu, utility, value):
    def trial_markup(held):
        """The markup if exactly these requests are held at 0, by the formula above."""
        w = np.exp(utility / mu.value)
        W_C = w[held].sum()
        s = (w * value)[held].sum() / (mu.value * (1 + W_C))
        rest = np.exp((value + utility)[~held] / mu.value - 1 - s).sum() / (1 + W_C)
        return mu.value * (1 + s + lambertw(rest).real)

    order = np.argsort(value)
    trials = []
    for k in range(4):
        _held = np.zeros(3, bool)
        _held[order[:k]] = True
        _m = trial_markup(_held)
        trials.append((k, _m, int((value < _m).sum())))
    right = [m for k, m, implied in trials if implied == k]
    assert len(right) == 1
    assert np.isclose(right[0], exact.markup)
    _rows = "\n".join(f"| {k} | {m:.4f} | {n} | {'yes' if n == k else 'no'} |" for k, m, n in trials)
    mo.md(
        f"| held | markup $m$ | values below $m$ | agree? |\n|--:|--:|--:|:--|\n{_rows}\n\noptkit: {exact.markup:.4f}."
    )
    return


@app.cell
def _():
    mo.md(r"""
    ## The certificate

    The multiplier of $c_i \ge 0$ is $\max(0, \mu + R - v_i)$: how much worse than the others a held request is. With
    it the dual of notebook 3 bounds all prices that are at least 0, and tells the two rules apart.
    """)
    return


@app.cell
def _(clipped, exact, mu, utility, value):
    proof = certify(exact.compensation, value, utility, mu.value)
    doubt = certify(clipped.compensation, value, utility, mu.value)
    assert proof.optimal
    assert doubt.optimal == (exact.profit - clipped.profit <= 1e-8)
    assert np.isclose(doubt.gap, exact.profit - clipped.profit, atol=1e-8)
    assert np.allclose(proof.multiplier * exact.compensation, 0.0, atol=1e-6)
    mo.md(
        f"Exact prices: **{'optimal' if proof.optimal else 'not optimal'}**, nobody earns more than {proof.bound:.4f}. "
        f"Clipped prices: **{'optimal' if doubt.optimal else 'not optimal'}**, {max(doubt.gap, 0.0):.4f} short of it. "
        f"Multipliers: {', '.join(f'{x:.2f}' for x in proof.multiplier)} (money)."
    )
    return


@app.cell
def _():
    mo.md(r"""
    ## Where clipping loses

    Two things must come together: a value below the markup, so that the free price is negative, and a utility that
    makes workers take the request for nothing. Unpopular requests lose next to nothing; they are
    what the paper had in mind.
    """)
    return


@app.cell
def _(mu, u3, v3):
    _u = np.linspace(-4, 8, 97)
    _utility = np.column_stack([np.full(97, 1.0), np.full(97, -4.0), _u])
    _ax = Figure(figsize=(4.4, 3.1), layout="constrained").subplots()
    for _v, _colour, _style in ((v3.value, COLOURS[1], "-"), (v3.value + 4, COLOURS[0], "--")):
        _best, _clip = (
            optimal_prices([8.0, 8.0, _v], _utility, mu.value, nonnegative=h).profit for h in (True, "clip")
        )
        assert (_best - _clip > -1e-9).all()
        _ax.plot(_u, _best - _clip, color=_colour, linestyle=_style, label=f"$v_3$ = {_v:g}")
    _ax.axvline(u3.value, color="0.6", linewidth=1)
    _ax.set_ylim(bottom=-0.05 * max(_ax.get_ylim()[1], 0.1), top=max(_ax.get_ylim()[1], 0.1))
    _ax.set_xlabel("utility of request 3, $u_3$ (money)")
    _ax.set_ylabel("lost by clipping (money)")
    _ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, frameon=False, fontsize=9)
    picture(_ax, "What clipping loses against the utility of request 3")
    return


if __name__ == "__main__":
    app.run()
