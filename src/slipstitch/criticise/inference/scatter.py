"""The scatter of one protocol, estimated from residuals by (restricted) maximum likelihood."""

from __future__ import annotations

import numpy as np
from scipy.optimize import minimize

from slipstitch.criticise.inference.clusters import Clusters, log_likelihood
from slipstitch.criticise.inference.covariance import (
    KAPPA_LIMITS,
    KAPPA_LOG_LIMITS,
    KAPPA_STARTS,
    SIGMA_LIMITS,
    Group,
    Scatter,
    scatter_prior,
)

START_SCATTER = Scatter(0.05, 0.03, 1.2)


def estimate_scatter(
    group: Group,
    residual: np.ndarray,
    fixed: np.ndarray,
    random: np.ndarray,
    start: Scatter = START_SCATTER,
    restricted: bool = True,
) -> tuple[Scatter, float]:
    """Scatter with a weak prior, by a simplex search, and its penalised log-likelihood.

    Parameters
    ----------
    residual : (n,) of the group's features.
    fixed, random : (n, k) and (n, q) columns fitted freely and with unit prior sd.
    restricted : the fixed columns are integrated out (REML) or maximised over.
    """
    clusters = Clusters(group, np.column_stack([fixed, random]))
    response = clusters.responses(residual[:, None])

    def unpack(z):
        s, r = np.clip(np.exp(z[:2]), *SIGMA_LIMITS)
        return Scatter(float(s), float(r), float(np.clip(np.exp(z[2]), *KAPPA_LIMITS)))

    def cost(z):
        scatter = unpack(z)
        value = log_likelihood(clusters, scatter, response, fixed.shape[1], restricted)
        outside = np.sum(np.maximum(np.abs(z[:2] - np.log(0.03)) - 5.5, 0))
        outside += max(z[2] - KAPPA_LOG_LIMITS[1], KAPPA_LOG_LIMITS[0] - z[2], 0.0)
        return -value - scatter_prior(scatter) + 10 * outside

    # Not from a limit: beyond it the likelihood is flat, and the search would stay there.
    kappa = np.clip(start.kappa, *KAPPA_STARTS)
    first = np.log([max(start.specimen, 0.004), max(start.run, 0.004), kappa])
    simplex = np.vstack([first, first + np.diag([0.5, 0.5, 0.15])])
    found = minimize(
        cost,
        first,
        method="Nelder-Mead",
        options={"initial_simplex": simplex, "xatol": 0.03, "fatol": 0.01, "maxfev": 90},
    )
    return unpack(found.x), -float(found.fun)
