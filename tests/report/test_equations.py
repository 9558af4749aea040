"""Equations and numbers on the page are those of the model, to the digits shown."""

from xml.etree import ElementTree

from hypothesis import given
from hypothesis import strategies as st

from pysindy_nrf import ChainModel, laws
from pysindy_nrf.chain.latex import (
    Estimate,
    as_text,
    feature,
    law_equation,
    mathml,
    number,
)

LABELS = st.text(
    alphabet=st.characters(codec="ascii", categories=["L", "N", "P", "S", "Zs"]),
    min_size=1,
)


def test_digits_follow_the_interval_zeros_among_them():
    assert as_text(Estimate(8.0, 7.966, 8.034)) == "8.000"
    assert as_text(Estimate(3e4, 29880.0, 30120.0)) == "3.000×10⁴"
    assert as_text(Estimate(35070.0, 35055.0, 35085.0)) == "35070"
    assert as_text(8.0) == "8"


def test_an_estimate_whose_interval_holds_zero_is_faint():
    assert Estimate(1.0, -2.0, 3.0).faint
    assert not Estimate(1.0, 0.5, 1.5).faint


@given(LABELS, st.sampled_from(["", "2", "4,2"]))
def test_any_label_becomes_well_formed_mathml(label, index):
    ElementTree.fromstring(mathml([feature(label, index)]))


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_any_number_becomes_latex_of_the_same_value(x):
    latex = number(x, ".17g")
    plain = latex.replace(r"\times 10^{", "e").rstrip("}")
    assert float(plain) == x


def model():
    return ChainModel([1.0], {1: laws.PowerSeries(2, [100.0, 2e5, -3.0, 4.0, 5e-6])})


def test_equation_holds_every_coefficient():
    text = ""
    for piece in law_equation(model().restoring_forces["storey 1"]):
        text += "".join(ElementTree.fromstring(mathml([piece])).itertext())
    assert text.startswith("R1(s1,v1)=100v1+2×105s1")
    assert "−3v12" in text
    assert "5×10−6" in text


def test_latex_holds_every_coefficient():
    force = r"R_{1}(s_{1}, v_{1}) &= 100\, v_{1} + 2\times 10^{5}\, s_{1}"
    assert f"{force} - 3\\, v_{{1}}^{{2}}" in model().to_latex()
