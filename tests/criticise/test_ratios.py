"""Likelihood ratios: the covariance's closed form, and that more data never lose evidence."""

from dataclasses import replace

import numpy as np
import pytest
from support.criticised import measured
from support.departures import planted

from slipstitch.criticise.inference import structure
from slipstitch.criticise.inference.faulty_data import robust_fit
from slipstitch.criticise.inference.mixed_model import Clusters, Group, Scatter, log_likelihood
from slipstitch.criticise.inference.ratio import Ratios


@pytest.fixture
def group():
    rng = np.random.default_rng(5)
    run = np.repeat(rng.permutation(12), 3)
    specimen = run // 4
    u = rng.uniform(0.1, 0.3, 36)
    astray = np.where(run == 3, 0.04, 0.0)
    return Group("drag", np.arange(36), u, rng.normal(2, 1, 36), specimen, run, astray)


def test_the_sums_over_clusters_give_what_the_matrix_gives(group):
    rng = np.random.default_rng(6)
    columns, data = rng.normal(size=(36, 4)), rng.normal(size=(36, 2))
    scatter = Scatter(0.07, 0.04, 1.3)
    inverse = np.linalg.inv(group.variance(scatter))
    clusters = Clusters(group, columns)
    score, squares = clusters.products(scatter, clusters.responses(data))
    assert np.allclose(clusters.gram(scatter), columns.T @ inverse @ columns, rtol=1e-10)
    assert np.allclose(score, columns.T @ inverse @ data, rtol=1e-9, atol=1e-9)
    assert np.allclose(squares, np.diag(data.T @ inverse @ data), rtol=1e-10)
    assert np.allclose(clusters.solved(scatter, data), inverse @ data, rtol=1e-9)
    determinant = np.linalg.slogdet(group.variance(scatter))[1]
    assert clusters.log_determinant(scatter) == pytest.approx(determinant, rel=1e-10)


def test_free_and_shrunken_columns_enter_the_likelihood_as_they_should(group):
    rng = np.random.default_rng(7)
    fixed, random, data = (rng.normal(size=(36, k)) for k in (1, 2, 1))
    scatter = Scatter(0.07, 0.04, 1.3)
    variance = group.variance(scatter) + random @ random.T
    inverse = np.linalg.inv(variance)
    information = fixed.T @ inverse @ fixed
    pulled = fixed.T @ inverse @ data
    squares = data.T @ inverse @ data - pulled.T @ np.linalg.solve(information, pulled)
    wanted = np.linalg.slogdet(variance)[1] + squares.item()
    clusters = Clusters(group, np.column_stack([fixed, random, data]))
    assert log_likelihood(clusters, scatter, 1, False) == pytest.approx(-0.5 * wanted)
    wanted += np.linalg.slogdet(information)[1]
    assert log_likelihood(clusters, scatter, 1, True) == pytest.approx(-0.5 * wanted)


@pytest.mark.slow
def test_another_protocol_takes_no_evidence_away(tmp_path):
    patch = {"patch": {"patch": -0.29, "centre_mm": 100.0, "width_mm": 45.0}}
    evidence = {}
    for protocols in (["strip"], ["strip", "drop_drag"]):
        folder = tmp_path / "-".join(protocols)
        planted(51, folder, patch, *protocols)
        measurements = measured(folder)
        state = robust_fit(measurements)
        outcome = state.outcome(np.random.default_rng(1), 100)
        evidence[len(protocols)] = outcome.global_p
        strongest = outcome.tests[outcome.strongest("generic")]
        assert strongest.covariate == "pos_x_mm"
    assert max(evidence.values()) < 0.01
    assert evidence[2] <= max(evidence[1], 1e-9)  # what is smaller is extrapolated


def test_a_mechanism_that_cannot_be_negative_is_no_evidence_the_other_way(group):
    rng = np.random.default_rng(8)
    other = replace(group, protocol="strip", index=36 + group.index)
    column = np.tile(rng.normal(size=(36, 1)), (2, 1))
    base = np.tile(group.sensitivity, 2)[:, None]
    scatters = dict.fromkeys(("drag", "strip"), Scatter(0.05, 0.03, 1.2))
    tests = [structure.Test(column, one_sided=added) for added in (False, True)]
    with_it, against_it = (
        Ratios(tests, base, sign * column[:, 0], [group, other], scatters).observed()
        for sign in (1.0, -1.0)
    )
    assert (with_it > 50).all()
    np.testing.assert_allclose(with_it[:, 1], with_it[:, 0], rtol=1e-9)
    np.testing.assert_allclose(against_it[:, 0], with_it[:, 0], rtol=1e-9)
    np.testing.assert_allclose(against_it[:, 1], 0.0, atol=1e-9)
