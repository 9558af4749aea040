"""Which laws are tried, and where."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

from .. import laws
from ..chain.sites import Site
from ..chain.structure import Chain
from ..exceptions import LawError
from ..identification.problem import Problem, flexible_laws
from ..laws.base import ForceLaw
from .effects import Candidate
from .search_data import SearchData

LawOrClass = ForceLaw | type[ForceLaw]
# Laws that read a channel of the base, and those that read any other covariate.
_LAWS_OF_BASE: dict[str, list[Callable[..., ForceLaw]]] = {
    "ag": [laws.BaseMotion],
    "vg": [laws.GroundFriction],
}
_LAWS_OF_COVARIATES: list[Callable[..., ForceLaw]] = [
    laws.CovariateFriction,
    laws.LaggedCovariateFriction,
    laws.CovariateDahl,
]


def default_catalogue(covariates: Sequence[str] = ()) -> list[ForceLaw]:
    """All laws of the package that can be an undeclared effect.

    A constant force is none: it is the unknown zero of a sensor, or a dead load, and a
    search takes it out. Add :class:`~pysindy_nrf.laws.ConstantForce` to look for one.

    Parameters
    ----------
    covariates : sequence of str
        Measured channels that a law may read; ``ag`` and ``vg`` are the motion of the
        base.

    Returns
    -------
    list of ForceLaw

    Examples
    --------
    >>> from pysindy_nrf.discrepancy import default_catalogue
    >>> [law.name for law in default_catalogue()][:2]
    ['coulomb_friction', 'regularized_friction']
    """
    catalogue: list[ForceLaw] = [
        laws.CoulombFriction(),
        laws.RegularizedFriction(),
        laws.StribeckFriction(),
        laws.PositionDependentFriction(),
        laws.BreakAwayFriction(),
        laws.ShiftedFriction(),
        laws.asymmetric(laws.CoulombFriction)(),
        laws.QuadraticDamping(),
        laws.PowerLawDamping(),
        laws.DisplacementDependentDamping(),
        laws.QuadraticStiffness(),
        laws.AbsoluteQuadraticStiffness(),
        laws.CubicStiffness(),
        laws.QuinticStiffness(),
        laws.OneSidedGap(),
        laws.OneSidedGap(side=-1),
        laws.PreloadedContact(),
        laws.PreloadedContact(side=-1),
        laws.TwoSidedGap(),
        laws.DeadZone(),
        laws.SofteningKnee(),
        laws.Bilinear(),
        laws.Jenkins(),
        laws.BacklashFriction(),
        laws.asymmetric(laws.BacklashFriction)(),
        laws.Iwan(),
        laws.Dahl(),
        laws.LuGre(),
        laws.BoucWen(),
        laws.DegradingBoucWen(),
        laws.PinchedBoucWen(),
        laws.MaxwellBranch(),
        laws.StiffnessStep(),
        laws.StiffnessDrift(),
        laws.DampingDrift(),
        laws.Inerter(),
        laws.HarmonicForce(),
        laws.AddedMass(),
        laws.HiddenOscillator(covariate="ag" if "ag" in covariates else None),
        laws.LinkSpringDashpot(),
        laws.GroundDashpot(),
        laws.BendingCoupling(),
        laws.ChannelDelay(),
        laws.GainError(),
        laws.SensorOffset(),
    ]
    for name in covariates:
        for law in _LAWS_OF_BASE.get(name, _LAWS_OF_COVARIATES):
            catalogue.append(law(covariate=name))
    return catalogue


def short_catalogue() -> list[ForceLaw]:
    """Laws that are tried where floors have no sensor: one or two of each kind.

    A fit of the free run takes as many runs as there are parameters in every step.
    """
    return [
        laws.CoulombFriction(),
        laws.QuadraticDamping(),
        laws.DisplacementDependentDamping(),
        laws.QuadraticStiffness(),
        laws.CubicStiffness(),
        laws.OneSidedGap(),
        laws.OneSidedGap(side=-1),
        laws.TwoSidedGap(),
        laws.Jenkins(),
        laws.MaxwellBranch(),
        laws.LinkSpringDashpot(),
        laws.GroundDashpot(),
    ]


def as_laws(catalogue: Iterable[LawOrClass]) -> list[ForceLaw]:
    """The laws of a catalogue that a user passed; classes become laws."""
    cure = "Use those of pysindy_nrf.laws, or your own."
    if not isinstance(catalogue, Iterable):
        raise LawError(f"catalogue={catalogue!r} is not a list of laws", cure)

    chosen = []
    for item in catalogue:
        law = item
        if isinstance(item, type) and issubclass(item, ForceLaw):
            law = item()
        if not isinstance(law, ForceLaw):
            raise LawError(
                f"The catalogue holds {law!r}, which is not a force law", cure
            )
        chosen.append(law)
    return chosen


def same_balance(site: Site) -> Site:
    """One site for all that stand in the same balance with the same motion.

    A DOF stands for its link to the ground.
    """
    return Site(f"ground {site.p}") if site.kind == "dof" else site


# -- where ---------------------------------------------------------------------


@dataclass(frozen=True)
class Experiment:
    """What a test offers to a search.

    Attributes
    ----------
    catalogue : sequence of ForceLaw
        Laws that are tried.
    chain : Chain
    known_masses, forced : collection of int
        DOFs with a known mass, and with a measured force.
    covariates : sequence of str
        Names of the channels that all records hold.
    n_records : int
    """

    catalogue: Sequence[ForceLaw]
    chain: Chain
    known_masses: Collection[int] = ()
    forced: Collection[int] = ()
    covariates: Sequence[str] = ()
    n_records: int = 1

    @cached_property
    def dofs(self) -> list[Site]:
        """All DOFs."""
        return [Site(f"dof {j}") for j in range(1, self.chain.n_dof + 1)]

    @cached_property
    def grounds(self) -> list[Site]:
        """Links to the ground that the chain lacks.

        That of DOF 1 is storey 1, which a free chain has not.
        """
        every = [Site(f"ground {j}") for j in range(1, self.chain.n_dof + 1)]
        return [site for site in every if site not in self.chain.sites]

    @cached_property
    def new_links(self) -> list[Site]:
        """All links that the chain lacks: to the ground, and those that skip floors."""
        links = list(self.grounds)
        for p in range(3, self.chain.n_dof + 1):
            for q in range(1, p - 1):
                site = Site(f"link {p}-{q}")
                if site not in self.chain.sites:
                    links.append(site)
        return links

    @cached_property
    def tries_ties(self) -> bool:
        """Whether a plain tie is tried at new links.

        Laws of a link are then tried there, too: one that slackens or yields must be
        better than it. Without a force a tie stands in for a storey.
        """
        ties = any("new link" in law.acts_at for law in self.catalogue)
        return ties and bool(self.forced)


def candidates(experiment: Experiment) -> Iterator[Candidate]:
    """Every law of the catalogue at every site where it makes sense."""
    for law in experiment.catalogue:
        if _can_be_distinguished(law, experiment):
            for site in sites_of(law, experiment):
                yield Candidate(law, (site,))


def _can_be_distinguished(law: ForceLaw, experiment: Experiment) -> bool:
    """Whether the test can show a law at all."""
    if "sensor" in law.acts_at:
        return False
    if any(name not in experiment.covariates for name in law.covariates):
        return False
    if law.permanent_change and experiment.n_records > 1:
        return False
    return bool(experiment.forced) or not law.mimics_inertia


def sites_of(law: ForceLaw, experiment: Experiment) -> list[Site]:
    """Sites at which a search tries a law."""
    sites: list[Site] = []
    for kind, sites_of_kind in _SITES_OF_KIND.items():
        ties = kind == "new link" and _may_tie(law, experiment)
        if kind in law.acts_at or ties:
            possible = sites_of_kind(law, experiment)
            sites += [site for site in possible if site not in sites]
    return sites


def _dofs(law: ForceLaw, experiment: Experiment) -> list[Site]:
    """All DOFs; for a law of the acceleration those of known mass, up to the force.

    Above the highest force every balance is homogeneous.
    """
    if law.variable != "a":
        return experiment.dofs
    highest = max(experiment.forced, default=0)
    known = set(experiment.known_masses)
    return [s for s in experiment.dofs if s.p in known and s.p <= highest]


def _links(law: ForceLaw, experiment: Experiment) -> list[Site]:
    """The links of the chain.

    On DOF 1 a law of the DOFs is the same as in storey 1.
    """
    links = list(experiment.chain.sites)
    if "dof" in law.acts_at and _dofs(law, experiment):
        return [site for site in links if site.q > 0]
    return links


def _grounds(law: ForceLaw, experiment: Experiment) -> list[Site]:
    """Links to the ground that the chain lacks."""
    return experiment.grounds


def _new_links(law: ForceLaw, experiment: Experiment) -> list[Site]:
    """All links that the chain lacks."""
    return experiment.new_links


def _over_two_storeys(law: ForceLaw, experiment: Experiment) -> list[Site]:
    """Links over two storeys that the chain lacks."""
    return [site for site in experiment.new_links if site.p - site.q == 2]


_SITES_OF_KIND: dict[str, Callable[[ForceLaw, Experiment], list[Site]]] = {
    "dof": _dofs,
    "link": _links,
    "ground": _grounds,
    "new link": _new_links,
    "two storeys": _over_two_storeys,
}


def _may_tie(law: ForceLaw, experiment: Experiment) -> bool:
    """Whether a law of a link is tried at links that the chain lacks."""
    only_links = "link" in law.acts_at and "dof" not in law.acts_at
    special = law.permanent_change or law.mimics_inertia or bool(law.covariates)
    return experiment.tries_ties and only_links and not special


def without_tied_laws(candidates: Iterable[Candidate], chain: Chain) -> list[Candidate]:
    """Candidates without the laws of storeys at links that the chain lacks.

    A tie is a spring and a dashpot, or friction, first of all.
    """
    chosen = []
    for candidate in candidates:
        (site,) = candidate.sites
        is_new = site.kind != "dof" and site not in chain.sites
        is_a_tie = {"ground", "new link", "two storeys"} & set(candidate.law.acts_at)
        if is_a_tie or not is_new:
            chosen.append(candidate)
    return chosen


def with_all_storeys(
    candidates: Iterable[Candidate], storeys: Sequence[Site]
) -> list[Candidate]:
    """Candidates, and every law of the storeys at all of them at once.

    A law of the ground alone is tried at all floors at once.
    """
    alone = list(candidates)
    sites: dict[ForceLaw, list[Site]] = {}
    for candidate in alone:
        sites.setdefault(candidate.law, []).extend(candidate.sites)

    together = []
    for law, tried in sites.items():
        everywhere: Sequence[Site] = ()
        if law.acts_at == ("ground",):
            everywhere = tried
        elif (
            "link" in law.acts_at and law.variable != "1" and set(tried) >= set(storeys)
        ):
            everywhere = storeys
        if len(everywhere) > 1:
            together.append(Candidate(law, tuple(everywhere)))
    return alone + together


def flexible(problem: Problem, data: SearchData) -> dict[Site, list[ForceLaw]]:
    """The laws of a problem with friction, damping, springs and sliders everywhere."""
    drifts = {site: data.scales(site)[0] for site in problem.chain.sites}
    out = flexible_laws(problem, drifts)
    if all("vg" in segment.covariates for segment in data.data.segments):
        for j in range(1, problem.chain.n_dof + 1):
            friction = laws.GroundFriction(covariate="vg")
            out.setdefault(Site(f"dof {j}"), []).append(friction)
    return out
