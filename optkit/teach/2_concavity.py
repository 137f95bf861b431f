# /// script
# [tool.marimo.display]
# theme = "system"
# ///
"""Why profit is not concave in prices but is in probabilities: Lemma 2, with the corrected Hessian."""

import marimo

app = marimo.App(width="compact", app_title="2 Concavity · optkit")

with app.setup:
    from base64 import b64encode

    import marimo as mo
    import numpy as np
    from matplotlib.figure import Figure

    from optkit.models.choice import acceptance_probabilities
    from optkit.models.pricing import optimal_prices
    from optkit.models.pricing_program import PricingProgram
    from optkit.plotting.boxes import COLOURS
    from optkit.plotting.files import figure_bytes

    VALUE = np.array([16.0, 14.0])
    UTILITY = np.array([-8.0, -7.0])

    def picture(axes, alt):
        """Show a figure at a size that can be read on a phone and does not shout on a screen."""
        # Within the page: a file of its own might be gone, once a slider moves on, before a browser has it.
        data = "data:image/png;base64," + b64encode(figure_bytes(axes, "png")).decode()
        return mo.image(data, alt=alt, style={"width": "100%", "max-width": "36rem"})


@app.cell
def _():
    mo.md(r"""
    # 2 · Two views of one profit

    Two requests are on offer. Serving them is worth $v = (16, 14)$ to the platform before it pays, and they have
    utility $u = (-8, -7)$ to the worker; taking none has utility 0. The expected profit is
    $\sum_i P_i\,(v_i - c_i)$. We look at it twice: over the prices $c$, and over the probabilities $P$.
    """)
    return


@app.cell
def _():
    mu = mo.ui.slider(0.6, 2, 0.1, value=1.2, label=r"Noise scale $\mu$ (money)", show_value=True, full_width=True)
    turn = mo.ui.slider(-90, 0, 5, value=-60, label="Turn the surfaces (degrees)", show_value=True, full_width=True)
    mo.vstack([mu, turn])
    return mu, turn


@app.cell
def _(mu):
    def profit_of_prices(compensation):
        """Expected profit of prices (..., 2), in money."""
        acceptance, _ = acceptance_probabilities(compensation, UTILITY, mu.value)
        return (acceptance * (VALUE - compensation)).sum(axis=-1)

    def prices_of(acceptance, rejection):
        """Prices that lead to these probabilities: notebook 1."""
        return -UTILITY + mu.value * (np.log(acceptance) - np.log(rejection)[..., None])

    best = optimal_prices(VALUE, UTILITY, mu.value, nonnegative=False)
    assert np.isclose(profit_of_prices(best.compensation), best.profit)
    return best, prices_of, profit_of_prices


@app.cell
def _():
    mo.md(r"""
    ## Over prices

    Pay nothing and nobody comes: the surface is flat and 0. Pay much and everybody comes, for little profit or none. In
    between rises a hill with a flat plain before it, and a surface that is flat, then steep, then flat is not concave.
    """)
    return


@app.cell
def _(best, profit_of_prices, turn):
    _c = np.stack(np.meshgrid(np.linspace(0, 14, 41), np.linspace(0, 14, 41), indexing="ij"), axis=-1)
    _ax = Figure(figsize=(4.4, 3.7)).add_subplot(projection="3d")
    _ax.plot_surface(_c[..., 0], _c[..., 1], profit_of_prices(_c), cmap="viridis", rcount=41, ccount=41, linewidth=0)
    _ax.plot(*[[x] for x in best.compensation], [best.profit], "o", color=COLOURS[1], markersize=7, zorder=10)
    _ax.view_init(elev=28, azim=turn.value)
    _ax.set_xlabel("price of request 1 (money)")
    _ax.set_ylabel("price of request 2 (money)")
    _ax.set_zlabel("profit (money)")
    _ax.set_box_aspect(None, zoom=0.92)
    _ax.get_figure().subplots_adjust(-0.06, 0.06, 0.94, 1.08)
    _ax.tick_params(labelsize=8, pad=1)
    picture(_ax, "Surface of the expected profit over the two prices")
    return


@app.cell
def _():
    mo.md(r"""
    ## Over probabilities

    Now decide on $P_1$ and $P_2$, and let $c_i = u_0 - u_i + \mu \ln P_i - \mu \ln P_0$ be the price that buys them.
    It is the same profit with the map redrawn: $\phi(P) = \sum_i P_i\,(v_i + u_i - u_0 - \mu \ln P_i + \mu \ln P_0)$.
    This surface is a dome, and a dome has one top and no plain to get lost on. The point is the same optimum.
    """)
    return


@app.cell
def _(best, prices_of, profit_of_prices, turn):
    # A fine grid of the triangle P1 + P2 < 1, by the share of those who accept and how they split.
    _all, _split = np.meshgrid(np.linspace(0.004, 0.995, 41), np.linspace(0.004, 0.996, 41), indexing="ij")
    _p = np.stack([_all * _split, _all * (1 - _split)], axis=-1)
    _ax = Figure(figsize=(4.4, 3.7)).add_subplot(projection="3d")
    _z = profit_of_prices(prices_of(_p, 1 - _all))
    _ax.plot_surface(_p[..., 0], _p[..., 1], _z, cmap="viridis", rcount=41, ccount=41, linewidth=0)
    _ax.plot(*[[x] for x in best.acceptance], [best.profit], "o", color=COLOURS[1], markersize=7, zorder=10)
    _ax.view_init(elev=28, azim=turn.value)
    _ax.set_xlabel("probability of request 1")
    _ax.set_ylabel("probability of request 2")
    _ax.set_zlabel("profit (money)")
    _ax.set_box_aspect(None, zoom=0.92)
    _ax.get_figure().subplots_adjust(-0.06, 0.06, 0.94, 1.08)
    _ax.tick_params(labelsize=8, pad=1)
    picture(_ax, "Surface of the expected profit over the two acceptance probabilities")
    return


@app.cell
def _():
    mo.md(r"""
    ## The test: a straight line between two decisions

    A function is concave if, between any two points, it is nowhere below the straight line that joins their values.
    Go from prices of 0 to the optimum: first in a straight line of prices, then in a straight line of
    the probabilities that these two decisions have.
    """)
    return


@app.cell
def _():
    way = mo.ui.slider(0, 100, 5, value=50, label="How far along the way (per cent)", show_value=True, full_width=True)
    way
    return (way,)


@app.cell
def _(best, mu, prices_of, profit_of_prices, way):
    low = np.zeros(2)
    p_low, none_low = acceptance_probabilities(low, UTILITY, mu.value)

    def both_ways(t):
        """Profit at the fraction t of the way, by prices and by probabilities, less that of the straight line."""
        t = np.asarray(t, dtype=float)[..., None]
        by_price = profit_of_prices((1 - t) * low + t * best.compensation)
        p, none = (1 - t) * p_low + t * best.acceptance, (1 - t[..., 0]) * none_low + t[..., 0] * best.rejection
        by_probability = profit_of_prices(prices_of(p, none))
        chord = (1 - t[..., 0]) * profit_of_prices(low) + t[..., 0] * best.profit
        return by_price, by_probability, chord

    here = both_ways(way.value / 100)
    grid = np.linspace(0, 1, 101)
    along_price, along_probability, along_chord = both_ways(grid)
    # Below the chord by far in prices, and nowhere in probabilities.
    assert (along_price - along_chord).min() < -0.25
    assert (along_probability - along_chord).min() > -1e-9
    mo.md(
        f"At {way.value} % of the way: by prices <output data-number='by-price'>{here[0]:.4f}</output>, on the "
        f"straight line {here[2]:.4f}, by probabilities <output data-number='by-probability'>{here[1]:.4f}</output> "
        f"(money)."
    )
    return along_chord, along_price, along_probability, grid, here


@app.cell
def _(along_chord, along_price, along_probability, grid, here, way):
    _ax = Figure(figsize=(4.4, 3.1), layout="constrained").subplots()
    _ax.plot(100 * grid, along_probability, color=COLOURS[0], label="straight in probabilities")
    _ax.plot(100 * grid, along_chord, color="0.45", linestyle="--", label="straight line of values")
    _ax.plot(100 * grid, along_price, color=COLOURS[1], label="straight in prices")
    _ax.plot([way.value] * 3, here, "o", color="black", markersize=4)
    _ax.set_xlabel("way from prices of 0 to the optimum (%)")
    _ax.set_ylabel("expected profit (money)")
    _ax.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, frameon=False, fontsize=9)
    picture(_ax, "Profit along the two ways, and the straight line between their ends")
    return


@app.cell
def _():
    mo.md(r"""
    ## Lemma 2, symbolically

    Treat $P_0$ as a variable of its own, as the paper's appendix A.2 does, and let SymPy take the second derivatives
    of $-\phi$ for two requests.
    """)
    return


@app.cell
def _():
    import sympy as sp

    P1, P2, P0, scale = sp.symbols("P_1 P_2 P_0 mu", positive=True)
    a1, a2, y1, y2, y0 = sp.symbols("a_1 a_2 y_1 y_2 y_0", real=True)
    phi = sum(p * (a - scale * sp.log(p) + scale * sp.log(P0)) for p, a in ((P1, a1), (P2, a2)))
    hessian = sp.hessian(-phi, (P1, P2, P0))
    _shown = sp.latex(hessian.applyfunc(sp.factor)).replace(r"\\", r"\\[6pt]")
    mo.md(f"$$H = {_shown}$$")
    return P0, P1, P2, hessian, scale, sp, y0, y1, y2


@app.cell
def _():
    mo.md(r"""
    Its quadratic form is a sum of squares, so $H$ is positive semidefinite and $\phi$ is concave:

    $$y^\top H y = \mu \sum_i \Big( \frac{y_i}{\sqrt{P_i}} - y_0 \frac{\sqrt{P_i}}{P_0} \Big)^{\!2} \ge 0.$$
    """)
    return


@app.cell
def _(P0, P1, P2, hessian, scale, sp, y0, y1, y2):
    y = sp.Matrix([y1, y2, y0])
    form = (y.T * hessian * y)[0]
    squares = scale * sum((yi / sp.sqrt(p) - y0 * sp.sqrt(p) / P0) ** 2 for yi, p in ((y1, P1), (y2, P2)))
    assert sp.expand(form - squares) == 0
    mo.md("SymPy: the difference of the two sides is 0, for all $P$, $y$ and $\\mu$.")
    return form, y


@app.cell
def _():
    mo.md(r"""
    ## What was corrected

    The paper's proof prints the form without its cross terms, and $y_0$ where $y_0^2$ belongs. The result stands, the
    proof needed mending: an indefinite matrix may have a positive diagonal, so the cross terms decide.
    The true form is 0 in the one direction $y = P$, where the printed one is not.
    """)
    return


@app.cell
def _(P0, P1, P2, form, scale, sp, y0, y1, y2):
    printed = scale * (y1**2 / P1 + y2**2 / P2 + y0 / P0**2 * (P1 + P2))
    diagonal = scale * (y1**2 / P1 + y2**2 / P2 + y0**2 / P0**2 * (P1 + P2))
    dropped = sp.expand(form - diagonal)
    along_p = {y1: P1, y2: P2, y0: P0}
    assert sp.expand(dropped + 2 * scale * y0 * (y1 + y2) / P0) == 0
    assert sp.simplify(form.subs(along_p)) == 0
    assert sp.simplify(printed.subs(along_p)) != 0
    mo.md(f"The dropped cross terms:\n\n$${sp.latex(sp.factor(dropped))}$$")
    return


@app.cell
def _():
    mo.md(r"""
    That direction is no harm. It scales all probabilities at once, and the simplex
    $\Psi = \{P > 0 : \sum_i P_i + P_0 = 1\}$ forbids it. (The paper's $\Psi$ leaves $P_0$ out of the sum; all
    probabilities together make 1.) So on $\Psi$ the profit is *strictly* concave, and its optimum unique.
    """)
    return


@app.cell
def _():
    mo.md(r"""
    ## Lemma 2, numerically

    Five hundred random points of the simplex: the smallest eigenvalue of $H$, and the smallest curvature in the
    directions that the simplex allows, $\sum_i y_i + y_0 = 0$. Then CVXPY's rules, which know nothing of our algebra.
    """)
    return


@app.cell
def _(mu):
    points = np.random.default_rng(3).dirichlet([1.0, 1.0, 1.0], 500).clip(1e-6)
    H = np.zeros((500, 3, 3))
    H[:, [0, 1], [0, 1]] = mu.value / points[:, :2]
    H[:, :2, 2] = H[:, 2, :2] = -mu.value / points[:, 2:]
    H[:, 2, 2] = mu.value * points[:, :2].sum(axis=1) / points[:, 2] ** 2
    within = np.linalg.svd(np.ones((1, 3)))[2][1:].T  # an orthonormal basis of sum(y) = 0
    smallest = (np.linalg.eigvalsh(H)[:, 0] / np.linalg.eigvalsh(H)[:, -1]).min()
    curvature = np.linalg.eigvalsh(within.T @ H @ within)[:, 0].min()
    assert smallest > -1e-12
    assert curvature > mu.value
    return H, curvature, points, smallest, within


@app.cell
def _(curvature, smallest):
    program = PricingProgram(2, nonnegative=False)
    assert program.problem.is_dcp()
    mo.md(
        f"Smallest eigenvalue, relative to the largest: {smallest:.1e}, zero up to rounding. Smallest curvature on the "
        f"simplex: {curvature:.3f} > 0. CVXPY: the pricing program is a concave one by its rules."
    )
    return


@app.cell
def _(H, points, prices_of, profit_of_prices, within):
    # Second differences of the profit itself, away from the edges: the formula for H is that of this profit.
    inner = points.min(axis=1) > 0.05
    _p, _h = points[inner], 1e-4
    for _d in (*within.T, within.sum(axis=1) / np.sqrt(2)):
        _f = [profit_of_prices(prices_of(q[:, :2], q[:, 2])) for q in (_p - _h * _d, _p, _p + _h * _d)]
        _second = (_f[0] - 2 * _f[1] + _f[2]) / _h**2
        assert np.allclose(_second, -np.einsum("i,nij,j->n", _d, H[inner], _d), rtol=1e-3)
    mo.md(f"Second differences of the computed profit agree with $-H$ at {inner.sum()} of these points.")
    return


if __name__ == "__main__":
    app.run()
