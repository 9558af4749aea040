"""Chain and sites: who pulls on whom, written once."""

import copy
import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pysindy_nrf import Chain, Site
from pysindy_nrf.exceptions import ChainError
from pysindy_nrf.records.dataset import Segment


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("storey 1", "ground 1"),
        ("storey 1", "link 1-0"),
        ("storey 1", "link 0-1"),
        ("story 3", "link 3-2"),
        ("ground 3", "link 3-0"),
        ("link 2-4", "link 4-2"),
        (3, "storey 3"),
        (np.int64(2), "storey 2"),
        (" storey  2 ", "storey 2"),
    ],
)
def test_equivalent_spellings_are_one_site(one, other):
    assert (
        Site(one) == Site(other)
        and hash(Site(one)) == hash(Site(other))
        and Site(str(Site(one))) == Site(one)
    )


@pytest.mark.parametrize(
    "text",
    [
        "storey",
        "storey 0",
        "storey -1",
        "link 2-2",
        "brace 4-2",
        "dof 0",
        "",
        "storey 1.5",
        None,
        2.0,
        True,
        ["storey 1"],
    ],
)
def test_what_is_no_site_is_refused_with_the_grammar(text):
    with pytest.raises(ChainError, match="storey 2|count from 1|different DOFs"):
        Site(text)


def test_sites_survive_copies():
    site = Site("link 4-2")
    for twin in (copy.deepcopy(site), pickle.loads(pickle.dumps(site))):
        assert twin == site and (twin.kind, twin.p, twin.q) == ("link", 4, 2)


@st.composite
def chains_with_links(draw):
    n = draw(st.integers(2, 8))
    ground = draw(st.sampled_from(["base", "free", "both"]))
    pairs = [
        (p, q)
        for p in range(1, n + 1)
        for q in range(p - 1)
        if not (ground == "both" and (p, q) == (n, 0))
    ]
    links = (
        draw(st.lists(st.sampled_from(pairs), unique=True, max_size=3)) if pairs else []
    )
    return Chain(n, [f"link {p}-{q}" for p, q in links], ground)


def motion_at(site, x):
    """What a law at a site sees of DOFs that are at x and move at x a second."""
    drifts = np.diff(x, prepend=0.0)[None]
    return Segment(
        "one", slice(0, 1), x[None], drifts, drifts, 0 * x[None], valid=slice(0, 1)
    ).motion(site, slice(0, 1))


@given(chains_with_links(), st.integers(0, 2**32 - 1))
def test_internal_forces_do_no_net_work_on_a_rigid_shift_and_power_balances(
    chain, seed
):
    """Newton's third law: the power of site forces on the DOFs is the power on their
    drifts.
    """
    rng = np.random.default_rng(seed)
    forces, velocities = rng.normal(size=len(chain.sites)), rng.normal(size=chain.n_dof)
    drift_rates = np.array([motion_at(site, velocities).v[0] for site in chain.sites])
    assert velocities @ (chain.incidence() @ forces) == pytest.approx(
        drift_rates @ forces, abs=1e-12
    )
    grounded = np.array([site.q == 0 for site in chain.sites])
    assert np.allclose(chain.incidence().sum(axis=0), grounded)


def test_incidence_is_the_papers_equation_of_motion():
    chain = Chain(4, ["link 4-2", "ground 3"])
    assert chain.incidence(
        ["storey 1", "storey 2", "link 4-2", "ground 3", "dof 2"]
    ).tolist() == [
        [1, -1, 0, 0, 0],
        [0, 1, -1, 0, 1],
        [0, 0, 0, 1, 0],
        [0, 0, 1, 0, 0],
    ]
    x = np.array([1.0, -2.0, 5.0, 11.0])
    assert [
        float(motion_at(s, x).s[0])
        for s in map(Site, ("link 4-2", "ground 3", "dof 2"))
    ] == [13.0, 5.0, -2.0]


def test_storey_above_the_top_of_a_chain_held_at_both_ends():
    chain = Chain(3, ground="both")
    assert chain.site(4) == "ground 3" and chain.sites[-1] == "ground 3"
    with pytest.raises(ChainError, match="storey 4"):
        Chain(3).site(4)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((0,), "n_dof=0"),
        ((2.0,), "n_dof=2.0"),
        ((True,), "n_dof=True"),
        ((3, ["storey 2"]), "in the chain already"),
        ((3, ["link 3-1", "link 1-3"]), "already"),
        ((3, ["link 5-1"]), "not a link of a chain with 3"),
        ((3, ["dof 1"]), "not a link"),
        ((3, (), "sky"), "ground='sky'"),
        ((1, (), "both"), "ground='base'"),
    ],
)
def test_chains_that_cannot_be(arguments, message):
    with pytest.raises(ChainError, match=message):
        Chain(*arguments)


def test_chains_compare_by_what_they_are():
    assert Chain(3, ["link 3-1"]) == Chain(3, "link 1-3") and Chain(3) != Chain(
        3, ground="free"
    )
    assert Chain(3).with_links(["storey 2", "link 3-1"]) == Chain(3, ["link 3-1"])
    assert pickle.loads(pickle.dumps(Chain(3, ["link 3-1"]))) == Chain(3, ["link 3-1"])
