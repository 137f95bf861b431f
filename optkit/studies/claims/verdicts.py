"""The paper's Results 1 to 7 beside ours: each pattern reproduced or contradicted, with numbers, and why."""

from __future__ import annotations

from optkit.studies.claims.beliefs import sensitivity_claims
from optkit.studies.claims.new_york import nyc_claims
from optkit.studies.claims.parts import Claim, Tables
from optkit.studies.claims.synthetic import heterogeneous_claims, homogeneous_claims


def claims(study: str, tables: Tables) -> list[Claim]:
    """Compare a study's tables with the paper's results.

    Parameters
    ----------
    study : str
        Name of the study.
    tables : mapping from str to DataFrame
        From :func:`optkit.studies.tables.study_tables`.

    Returns
    -------
    list of dict
        ``result`` (the paper's number), ``pattern``, ``paper`` and ``here`` (numbers), ``verdict`` ("reproduced",
        "contradicted", or "not settled" where the draws leave the sign open) and ``why``, where they differ. Empty
        where the tables do not suffice.

    Examples
    --------
    >>> import pandas as pd
    >>> told = {"scenario": "I.1", "world": 0, "group": "all", "epsilon": [0.0, 2.0, 2.0], "draw": [0, 0, 1]}
    >>> table = pd.DataFrame({**told, "mbe": 0.0, "ratio": [92.0, 89.0, 88.9]})
    >>> [(one["result"], one["verdict"]) for one in claims("sensitivity", {"sensitivity": table})]
    [(2, 'reproduced')]
    """
    makers = {
        "homogeneous": homogeneous_claims,
        "heterogeneous": heterogeneous_claims,
        "sensitivity": sensitivity_claims,
        "nyc": nyc_claims,
    }
    return list(makers[study](tables))
