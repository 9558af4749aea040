"""Chain and sites: who pulls on whom, written once."""

import copy
import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pysindy_nrf import Chain, Site
from pysindy_nrf.exceptions import ChainError
from pysindy_nrf.records import Segment


@pytest.mark.parametrize(
    ("first", "other"),
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
def test_equivalent_spellings_are_one_site(first, other):
    assert Site(first) == Site(other)
    assert hash(Site(first)) == hash(Site(other))
    assert Site(str(Site(first))) == Site(first)


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


@pytest.mark.parametrize(
    "copied", [copy.deepcopy, lambda s: pickle.loads(pickle.dumps(s))]
)
def test_sites_survive_copies(copied):
    site = copied(Site("link 4-2"))
    assert site == "link 4-2"
    assert (site.kind, site.p, site.q) == ("link", 4, 2)


@st.composite
def chains_with_links(draw):
    """Any chain with up to three links beside its storeys."""
    n_dof = draw(st.integers(2, 8))
    ground = draw(st.sampled_from(["base", "free", "both"]))
    pairs = []
    for p in range(2, n_dof + 1):
        for q in range(p - 1):
            is_tie_at_top = ground == "both" and (p, q) == (n_dof, 0)
            if not is_tie_at_top:
                pairs.append(f"link {p}-{q}")
    if not pairs:
        return Chain(n_dof, ground=ground)
    links = draw(st.lists(st.sampled_from(pairs), unique=True, max_size=3))
    return Chain(n_dof, links, ground)


def motion_at(site, x):
    """What a law at a site sees of DOFs that are at x and move at x a second."""
    drifts = np.diff(x, prepend=0.0)[None]
    row = slice(0, 1)
    segment = Segment("one", row, x[None], drifts, drifts, 0 * x[None], valid=row)
    return segment.motion(site, row)


@given(chains_with_links(), st.integers(0, 2**32 - 1))
def test_the_power_of_site_forces_is_that_on_their_drifts(chain, seed):
    """Newton's third law."""
    rng = np.random.default_rng(seed)
    forces = rng.normal(size=len(chain.sites))
    velocities = rng.normal(size=chain.n_dof)
    rates = [motion_at(site, velocities).v[0] for site in chain.sites]
    on_dofs = velocities @ (chain.incidence() @ forces)
    assert on_dofs == pytest.approx(np.dot(rates, forces), abs=1e-12)


@given(chains_with_links())
def test_inner_forces_do_no_work_on_a_rigid_shift(chain):
    grounded = [site.q == 0 for site in chain.sites]
    assert np.allclose(chain.incidence().sum(axis=0), grounded)


def test_incidence_is_the_papers_equation_of_motion():
    chain = Chain(4, ["link 4-2", "ground 3"])
    sites = ["storey 1", "storey 2", "link 4-2", "ground 3", "dof 2"]
    assert chain.incidence(sites).tolist() == [
        [1, -1, 0, 0, 0],
        [0, 1, -1, 0, 1],
        [0, 0, 0, 1, 0],
        [0, 0, 1, 0, 0],
    ]


@pytest.mark.parametrize(
    ("site", "drift"), [("link 4-2", 13.0), ("ground 3", 5.0), ("dof 2", -2.0)]
)
def test_the_drift_of_a_site_is_between_its_ends(site, drift):
    x = np.array([1.0, -2.0, 5.0, 11.0])
    assert motion_at(Site(site), x).s[0] == drift


def test_storey_above_the_top_of_a_chain_held_at_both_ends():
    chain = Chain(3, ground="both")
    assert chain.site(4) == "ground 3"
    assert chain.sites[-1] == "ground 3"
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
        ((3, ["link 5-1"]), "not a link of a chain"),
        ((3, ["dof 1"]), "not a link"),
        ((3, (), "sky"), "ground='sky'"),
        ((1, (), "both"), "ground='base'"),
    ],
)
def test_chains_that_cannot_be(arguments, message):
    with pytest.raises(ChainError, match=message):
        Chain(*arguments)


def test_chains_compare_by_what_they_are():
    braced = Chain(3, ["link 3-1"])
    assert braced == Chain(3, "link 1-3")
    assert braced == Chain(3).with_links(["storey 2", "link 3-1"])
    assert braced == pickle.loads(pickle.dumps(braced))
    assert Chain(3) != Chain(3, ground="free")
