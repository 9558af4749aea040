"""Equations and numbers of a model are its own, to the digits shown."""

import re
from dataclasses import replace
from xml.etree import ElementTree

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pysindy_nrf import ChainModel, laws
from pysindy_nrf.report import content_of, identification_of

LABELS = st.text(
    alphabet=st.characters(codec="ascii", categories=["L", "N", "P", "S", "Zs"]),
    min_size=1,
).filter(str.strip)
FORCES = st.floats(allow_nan=False, allow_infinity=False)


def storey(mass=1.0):
    series = laws.PowerSeries(2, [100.0, 2e5, -3.0, 4.0, 5e-6])
    return ChainModel([mass], {1: series})


def content_with(model, bounds):
    """The page of a model with 95 % intervals."""
    return content_of(replace(identification_of(model), bounds=bounds))


@pytest.mark.parametrize(
    ("mass", "interval", "words"),
    [
        (8.0, (7.966, 8.034), "m1 = 8.000 kg"),
        (3e4, (29880.0, 30120.0), "m1 = 3.000×10⁴ kg"),
        (35070.0, (35055.0, 35085.0), "m1 = 35070 kg"),
    ],
)
def test_digits_follow_the_interval_zeros_among_them(mass, interval, words):
    content = content_with(storey(mass), {"m1": interval})
    assert content.frame.floors[0].words == words


def test_a_number_without_an_interval_has_no_empty_digits():
    assert content_of(storey(8.0)).frame.floors[0].words == "m1 = 8 kg"


def test_a_term_whose_interval_holds_zero_is_grey():
    intervals = {"storey 1: v": (-2.0, 3.0), "storey 1: s": (1e5, 3e5)}
    pieces = content_with(storey(), intervals).model.sites[0].equation
    grey = [piece for piece in pieces if "gray" in piece]
    assert len(grey) == 1
    assert "v_{1}" in grey[0]


@given(LABELS, st.sampled_from(["storey 2", "ground 2"]))
def test_any_name_of_a_channel_gives_a_well_formed_view(name, site):
    friction = laws.CovariateFriction(name, 1.0, 2.0, 3.0)
    model = ChainModel([1.0, 2.0], {site: friction})
    ElementTree.fromstring(model._repr_html_())


@given(FORCES)
def test_any_number_has_its_value_in_latex(force):
    latex = ChainModel([1.0], {"dof 1": laws.ConstantForce(force)}).to_latex()
    shown = latex.splitlines()[-2].partition("&= ")[2]
    digits = shown.replace(" ", "").replace(r"\times10^{", "e").rstrip("}")
    assert float(digits) == float(f"{force:.4g}")


def test_equation_holds_every_coefficient():
    text = ""
    for piece in re.findall("<math.*?</math>", storey()._repr_html_()):
        text += "".join(ElementTree.fromstring(piece).itertext())
    assert "R1(s1,v1)=100v1+2×105s1" in text
    assert "−3v12" in text
    assert "5×10−6" in text


def test_latex_holds_every_coefficient():
    force = r"R_{1}(s_{1}, v_{1}) &= 100\, v_{1} + 2\times 10^{5}\, s_{1}"
    assert f"{force} - 3\\, v_{{1}}^{{2}}" in storey().to_latex()
