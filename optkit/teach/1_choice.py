# /// script
# [tool.marimo.display]
# theme = "system"
# ///
"""How a worker chooses by multinomial logit, by simulation and by formula, and what the outside option does."""

import marimo

app = marimo.App(width="compact", app_title="1 Choice · optkit")

with app.setup:
    from base64 import b64encode

    import marimo as mo
    import numpy as np
    from matplotlib.figure import Figure

    from optkit.models.choice import acceptance_probabilities
    from optkit.plotting.boxes import COLOURS
    from optkit.plotting.files import figure_bytes

    UTILITY = np.array([-6.0, -7.5, -5.0])

    def picture(axes, alt):
        """Show a figure at a size that can be read on a phone and does not shout on a screen."""
        # Within the page: a file of its own might be gone, once a slider moves on, before a browser has it.
        data = "data:image/png;base64," + b64encode(figure_bytes(axes, "png")).decode()
        return mo.image(data, alt=alt, style={"width": "100%", "max-width": "36rem"})


@app.cell
def _():
    mo.md(r"""
    # 1 · A worker chooses

    A gig worker sees three requests and a compensation for each. Request $i$ is worth $U_i = u_i + c_i + e_i$ to this
    worker: a mean utility $u_i$ (here $-6$, $-7.5$ and $-5$, as work is work), the compensation $c_i$, and a mood $e_i$
    that the platform does not know. To take none is worth $U_0 = u_0 + e_0$. The worker takes the best of the four.

    All quantities are money. Move a slider, with the mouse or the arrow keys: everything below is computed again.
    """)
    return


@app.cell
def _():
    pay = mo.ui.slider(0, 16, 0.5, value=7, label="Compensation of request 1 (money)", show_value=True, full_width=True)
    mu = mo.ui.slider(0.5, 5, 0.1, value=1.5, label=r"Noise scale $\mu$ (money)", show_value=True, full_width=True)
    u0 = mo.ui.slider(
        -4, 4, 0.5, value=0, label=r"Utility of taking none $u_0$ (money)", show_value=True, full_width=True
    )
    mo.vstack([pay, mu, u0])
    return mu, pay, u0


@app.cell
def _(pay):
    compensation = np.array([pay.value, 8.0, 4.0])
    return (compensation,)


@app.cell
def _():
    mo.md(r"""
    ## By simulation

    The moods are independent Gumbel variables of mean zero and scale $\mu$. We draw 50,000 workers, let each of them
    take what is best, and count.
    """)
    return


@app.cell
def _():
    # Drawn once at scale 1: the sliders move the same 50,000 workers.
    mood = np.random.default_rng(7).gumbel(-np.euler_gamma, 1.0, (50_000, 4))
    return (mood,)


@app.cell
def _(compensation, mood, mu, u0):
    mean = np.append(UTILITY + compensation, u0.value)
    choice = (mean + mu.value * mood).argmax(axis=1)
    share = np.bincount(choice, minlength=4) / len(mood)
    return (share,)


@app.cell
def _():
    mo.md(r"""
    ## By formula

    Gumbel moods have a gift: the probabilities come out in closed form, the *multinomial logit* model
    (paper, section 3.2).

    $$P_i = \frac{e^{(u_i + c_i)/\mu}}{e^{u_0/\mu} + \sum_l e^{(u_l + c_l)/\mu}}$$

    $$P_0 = \frac{e^{u_0/\mu}}{e^{u_0/\mu} + \sum_l e^{(u_l + c_l)/\mu}}$$
    """)
    return


@app.cell
def _(compensation, mood, mu, share, u0):
    acceptance, rejection = acceptance_probabilities(compensation, UTILITY, mu.value, outside_utility=u0.value)
    formula = np.append(acceptance, rejection)
    error = np.abs(share - formula)
    # Five standard errors of a share, and a few counts for shares that are almost 0.
    allowed = 5 * np.sqrt(formula * (1 - formula) / len(mood)) + 10 / len(mood)
    assert (error < allowed).all()
    mo.md(
        f"The worker takes none with probability <output data-number='rejection'>{rejection:.4f}</output>, and request "
        f"1 with probability <output data-number='acceptance'>{acceptance[0]:.4f}</output>. No simulated share is "
        f"further from its formula than {error.max():.4f}, within five standard errors."
    )
    return acceptance, formula, rejection


@app.cell
def _(formula, share):
    _ax = Figure(figsize=(4.4, 3.1), layout="constrained").subplots()
    _x = np.arange(4)
    _ax.bar(_x - 0.2, share, 0.4, color=COLOURS[5], label="simulated share")
    _ax.bar(_x + 0.2, formula, 0.4, color=COLOURS[0], label="formula")
    for _i in range(4):
        _ax.annotate(f"{formula[_i]:.2f}", (_i + 0.2, formula[_i]), ha="center", va="bottom", fontsize=10)
    _ax.set_xticks(_x, ["request 1", "request 2", "request 3", "none"])
    _ax.set_ylim(0, 1.08)
    _ax.set_ylabel("probability")
    _ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, frameon=False, fontsize=9)
    picture(_ax, "Simulated shares and probabilities by formula of the four choices")
    return


@app.cell
def _():
    mo.md(r"""
    ## What more money buys

    A higher compensation for request 1 takes workers from the other requests as well as from *none*. The curve is an
    S: money buys little at first, then much, then little again. Keep that S in mind, it returns in notebook 2.
    """)
    return


@app.cell
def _(acceptance, mu, pay, rejection, u0):
    _grid = np.linspace(0, 16, 161)
    _offers = np.column_stack([_grid, np.full(161, 8.0), np.full(161, 4.0)])
    _p, _none = acceptance_probabilities(_offers, UTILITY, mu.value, outside_utility=u0.value)
    assert (np.diff(_p[:, 0]) > 0).all()
    assert (np.diff(_none) < 0).all()
    _ax = Figure(figsize=(4.4, 3.1), layout="constrained").subplots()
    for _i in range(3):
        _ax.plot(_grid, _p[:, _i], color=COLOURS[_i], label=f"request {_i + 1}")
    _ax.plot(_grid, _none, color="black", linestyle="--", label="none")
    _ax.axvline(pay.value, color="0.6", linewidth=1)
    _ax.plot([pay.value] * 4, [*acceptance, rejection], "o", color="black", markersize=4)
    _ax.set_xlabel("compensation of request 1 (money)")
    _ax.set_ylabel("probability")
    _ax.set_ylim(-0.03, 1.03)
    _ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=4, frameon=False, fontsize=9, columnspacing=1.0)
    picture(_ax, "Choice probabilities against the compensation of request 1")
    return


@app.cell
def _():
    mo.md(r"""
    ## Odds do not look aside

    The odds of request 1 against request 2 are $P_1 / P_2 = e^{(u_1 + c_1 - u_2 - c_2)/\mu}$, whatever else is on
    offer. This *independence of irrelevant alternatives* is the model's strength and its weakness: it makes the
    formulas short, and it ignores that two requests may be alike.
    """)
    return


@app.cell
def _(acceptance, compensation, mu, u0):
    fewer, _ = acceptance_probabilities(
        compensation, UTILITY, mu.value, outside_utility=u0.value, offered=[True, True, False]
    )
    odds = acceptance[0] / acceptance[1]
    assert np.isclose(odds, fewer[0] / fewer[1], rtol=1e-12)
    assert fewer[2] == 0
    mo.md(f"With request 3 the odds are {odds:.4g} to 1; without it they are {fewer[0] / fewer[1]:.4g} to 1.")
    return


@app.cell
def _():
    mo.md(r"""
    ## From probabilities back to money

    Divide $P_i$ by $P_0$ and take logarithms: $c_i = u_0 - u_i + \mu \ln P_i - \mu \ln P_0$. To each choice of
    probabilities belongs exactly one vector of compensations. Notebook 2 decides on probabilities instead of prices.
    """)
    return


@app.cell
def _(acceptance, compensation, mu, rejection, u0):
    back = u0.value - UTILITY + mu.value * (np.log(acceptance) - np.log(rejection))
    assert np.allclose(back, compensation, atol=1e-9)
    mo.md(f"From the probabilities above we get back ({back[0]:.2f}, {back[1]:.2f}, {back[2]:.2f}).")
    return


@app.cell
def _():
    mo.md(r"""
    ## A slip in the paper's print

    The paper prints the outside option *inside* the sum over requests, so that the denominator holds
    $3\, e^{u_0/\mu}$ instead of one. Then the four numbers do not add up to 1: they are no probabilities.
    """)
    return


@app.cell
def _(compensation, formula, mu, u0):
    _weight = np.exp((np.append(UTILITY + compensation, u0.value) - u0.value) / mu.value)
    as_printed = _weight / (_weight[:3].sum() + 3 * _weight[3])
    assert as_printed.sum() < 1
    assert np.isclose(formula.sum(), 1.0, rtol=1e-12)
    mo.md(f"As printed they fall short of 1 by {1 - as_printed.sum():.3g}; with the outside option once, they do not.")
    return


if __name__ == "__main__":
    app.run()
