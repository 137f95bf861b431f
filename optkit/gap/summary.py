"""A gap report as text."""

from __future__ import annotations

from math import isfinite
from typing import Any

from optkit.gap.rows import CHARGED


def report_text(report: Any) -> str:
    """Return the ladder, gaps and claims of a :class:`optkit.gap.report.GapReport`, and what they rest on.

    Where charges take the luck out of the money, the plain mean of the rows stands beside it.
    """
    charged = any(kind in CHARGED for kind in report.bounds["kind"])
    wide = max(len(str(name)) for name in (*report.bounds["kind"], *report.policies["policy"], "policy"))
    money = "money an instance, less luck  raw mean of the rows" if charged else "money an instance"
    lines = [f"{'':{wide}s}   points of full information   {'' if charged else '   '}{money}"]
    for frame, name in ((report.bounds, "kind"), (report.policies, "policy")):
        for _, row in frame.iterrows():
            points = f"{_shown(row['points'], 8)} ± {_shown(row['half_width'])}"
            less = f"{_shown(row['money'], 9)} ± {_shown(row['money_half_width'])}"
            raw = f"  {_shown(row['raw_money'], 9)} ± {_shown(row['raw_half_width'])}" if charged else ""
            lines.append(f"{row[name]:{wide}s}   {points:26s}   {less:{28 if charged else 0}s}{raw}")
    lines.append("")
    for _, row in report.gaps[report.gaps["bound"] == report.best_bound].iterrows():
        interval = f"[{_shown(row['points_low'])}, {_shown(row['points_high'])}]"
        points = f"{_shown(row['points'])} points {interval}"
        lines.append(f"gap of {row['policy']} to {row['bound']}: {points}")
        lines.append(f"  {report.claim(row['policy'])}")
    worst = report.bounds["certificate_gap"].max(), report.bounds["residual"].max()
    lines.append(f"certificates: all checked, largest gap {worst[0]:.1e}, largest residual {worst[1]:.1e} (money)")
    lines += [f"penalised bound refused: {why}" for why in report.refused]
    lines += [f"assumed: {told}" for told in report.assumptions]
    lines += [f"instance {i} is left out: {why}" for i, why in report.failures.items()]
    return "\n".join(lines)


def _shown(x: float, width: int = 0) -> str:
    """Two digits; a dash where there is no number."""
    return f"{x:{width}.2f}" if isfinite(x) else f"{'-':>{width}s}"
