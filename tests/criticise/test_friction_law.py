"""The friction law says what docs/criticise-your-data.md says, mechanism by mechanism."""

import math

import numpy as np
import pytest

from slipstitch.base.errors import BadInput
from slipstitch.physics.friction_law import CONTACT_MECHANISMS, Contact, Curve, FrictionLaw

CONTACT = Contact(
    normal_force_N=0.2,
    area_m2=0.008,
    direction_rad=0.7,
    dwell_s=30.0,
    speed_m_s=0.03,
    repeats=4.0,
    relative_humidity_pct=58.0,
)
MU = 0.4
COULOMB_N = 0.2 * MU
# mechanism: (parameters, static force in units of Coulomb's, kinetic force likewise)
EXPECTED = {
    "load_power": ({"load_power": -0.1}, 0.5**-0.1, 0.5**-0.1),
    "adhesion": ({"adhesion": 3.0}, 1 + 3.0 * 0.008 / COULOMB_N, 1 + 3.0 * 0.008 / COULOMB_N),
    "static_kinetic": ({"static_kinetic": 0.2}, 1.2, 1.0),
    "ageing": ({"ageing": 0.05}, 1 + 0.05 * math.log10(31), 1.0),
    "rate": ({"rate": 0.1}, 1.0, 1 + 0.1 * math.log10(3)),
    "anisotropy": ({"anisotropy": 0.1}, *[1 + 0.1 * math.cos(1.4)] * 2),
    "nap": ({"nap": -0.1}, *[1 - 0.1 * math.cos(0.7)] * 2),
    "wear": ({"wear": 0.3, "wear_r0": 2.0}, *[1 + 0.3 * (1 - math.exp(-2))] * 2),
    "humidity": ({"humidity": 0.05}, 1.04, 1.04),
}


@pytest.mark.parametrize("name", CONTACT_MECHANISMS)
def test_a_mechanism_acts_as_documented_and_not_at_its_null(name):
    values, *factors = EXPECTED[name]
    null = CONTACT_MECHANISMS[name].null_values()
    for mechanisms, expected in (({name: values}, factors), ({name: null}, [1, 1]), ({}, [1, 1])):
        law = FrictionLaw(MU, mechanisms)
        limits = [law.force_limit(CONTACT, static) for static in (True, False)]
        assert limits == pytest.approx([COULOMB_N * factor for factor in expected])


def test_mechanisms_compose():
    law = FrictionLaw(MU, {"humidity": {"humidity": 0.05}, "adhesion": {"adhesion": 3.0}})
    assert law.force_limit(CONTACT, True) == pytest.approx(COULOMB_N * 1.04 + 3.0 * 0.008)


def test_an_edge_is_measured_against_two_millinewtons():
    law = FrictionLaw(MU, {"load_power": {"load_power": 0.5}})
    edge = Contact(normal_force_N=8e-3, area_m2=1e-6, edge=True)
    assert law.force_limit(edge, True) == pytest.approx(8e-3 * MU * 2.0)


def test_what_was_not_recorded_changes_nothing():
    blind = Contact(
        normal_force_N=0.2, direction_rad=np.nan, repeats=np.nan, relative_humidity_pct=np.nan
    )
    names = ("ageing", "rate", "anisotropy", "nap", "wear", "humidity")
    law = FrictionLaw(MU, {name: EXPECTED[name][0] for name in names})
    for static in (True, False):
        assert law.force_limit(blind, static) == pytest.approx(COULOMB_N)


def test_a_law_survives_being_written_down():
    law = FrictionLaw(MU, {"wear": EXPECTED["wear"][0]})
    again = FrictionLaw.from_dict(law.to_dict())
    assert again.force_limit(CONTACT, True) == law.force_limit(CONTACT, True)


@pytest.mark.parametrize(
    "mechanisms, word", [({"stickiness": {}}, "stickiness"), ({"wear": {"wear": 0.1}}, "wear_r0")]
)
def test_unknown_mechanisms_and_parameters_are_refused(mechanisms, word):
    with pytest.raises(BadInput, match=word):
        FrictionLaw(MU, mechanisms)


def test_a_curve_is_linear_in_logarithms_between_its_knots_and_constant_beyond():
    law = FrictionLaw(MU, {}, Curve("speed_m_s", (0.001, 0.01, 0.1), (0.8, 1.2, 1.0)))
    speeds = np.array([1e-4, 1e-3, math.sqrt(1e-5), 0.03, 1.0, np.nan])
    contact = Contact(normal_force_N=0.2, speed_m_s=speeds)
    middle = 1.2 ** (1 - math.log10(3)) * 1.0 ** math.log10(3)
    expected = [0.8, 0.8, math.sqrt(0.8 * 1.2), middle, 1.0, 1.0]
    assert law.force_limit(contact, False) == pytest.approx(COULOMB_N * np.array(expected))
    assert law.force_limit(contact, True) == pytest.approx(COULOMB_N)  # in motion only
    assert law.differs_at_rest


def test_a_curve_acts_beside_mechanisms_and_by_place_at_rest_as_well():
    law = FrictionLaw(
        MU, {"adhesion": {"adhesion": 3.0}}, Curve("place_m", (-0.1, 0.1), (1.0, 4.0))
    )
    contact = Contact(normal_force_N=0.2, area_m2=0.008, place_m=0.0)
    for static in (True, False):
        assert law.force_limit(contact, static) == pytest.approx(COULOMB_N * 2.0 + 3.0 * 0.008)
    assert not law.differs_at_rest


@pytest.mark.parametrize(
    "arguments, words",
    [
        (("colour", (1, 2), (1, 1)), "unknown quantity 'colour'"),
        (("place_m", (1,), (1,)), "1 knots; must be 2 to 16"),
        (("place_m", (1, 2), (1,)), "2 knots and 1 factors"),
        (("place_m", (2, 1), (1, 1)), "knots must increase"),
        (("place_m", (1, 2), (1, 0.0)), "above 0"),
        (("place_m", (1, math.nan), (1, 1)), "finite"),
        (("speed_m_s", (0, 1), (1, 1)), "knots of speed_m_s must be above 0"),
    ],
)
def test_a_curve_that_is_none_is_refused(arguments, words):
    with pytest.raises(BadInput, match=words):
        Curve(*arguments)
