"""Which laws are tried, and where."""

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from .. import laws
from ..chain.sites import Site
from ..chain.structure import Chain
from ..exceptions import LawError
from ..identification.problem import Problem, flexible_laws
from ..laws.base import ForceLaw


def default_catalogue(covariates: Sequence[str] = ()) -> list[ForceLaw]:
    """All laws of the package that can be an undeclared effect."""
    plain: list[ForceLaw] = [
        laws.CoulombFriction(),
        laws.RegularizedFriction(),
        laws.StribeckFriction(),
        laws.PositionDependentFriction(),
        laws.BreakAwayFriction(),
        laws.ShiftedFriction(),
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
        laws.Bilinear(),
        laws.Jenkins(),
        laws.BacklashFriction(),
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
        laws.ConstantForce(),
        laws.AddedMass(),
        laws.HiddenOscillator(covariate="ag" if "ag" in covariates else None),
        laws.LinkSpringDashpot(),
        laws.BendingCoupling(),
        laws.ChannelDelay(),
        laws.GainError(),
        laws.SensorOffset(),
    ]
    of_base: dict[str, list[type[Any]]] = {
        "ag": [laws.BaseMotion],
        "vg": [laws.GroundFriction],
    }
    usual = [laws.CovariateFriction, laws.LaggedCovariateFriction, laws.CovariateDahl]
    return plain + [
        law(covariate=name) for name in covariates for law in of_base.get(name, usual)
    ]


def as_laws(
    catalogue: Iterable[Any] | None, covariates: Sequence[str]
) -> list[ForceLaw]:
    """The catalogue a user passed, or the default one."""
    if catalogue is None:
        return default_catalogue(covariates)
    cure = "Use those of pysindy_nrf.laws, or your own."
    if not isinstance(catalogue, Iterable):
        raise LawError(f"catalogue={catalogue!r} is not a list of laws", cure)
    chosen = [
        item() if isinstance(item, type) and issubclass(item, ForceLaw) else item
        for item in catalogue
    ]
    if wrong := [item for item in chosen if not isinstance(item, ForceLaw)]:
        raise LawError(
            f"The catalogue holds {wrong[0]!r}, which is not a force law", cure
        )
    return chosen


def balances_of(site: Site) -> Site:
    """One site for all that stand in the same balance with the same motion: on a DOF is
    from it to the ground.
    """
    return Site(f"ground {site.p}") if site.kind == "dof" else site


def candidates(
    catalogue: Iterable[ForceLaw],
    chain: Chain,
    known_masses: Iterable[int],
    covariates: Sequence[str],
    forced: Iterable[int],
    n_records: int = 1,
) -> Iterator[tuple[ForceLaw, Site]]:
    """Every force law at every site where it makes sense."""
    n = chain.n_dof
    grounds = [
        Site(f"ground {j}") for j in range(1, n + 1)
    ]  # of DOF 1 it is storey 1, which a free chain has not
    skips = [Site(f"link {p}-{q}") for p in range(3, n + 1) for q in range(1, p - 1)]
    known, driven = set(known_masses), set(forced)
    new_links = [s for s in grounds + skips if s not in chain.sites]
    catalogue = list(catalogue)
    # beside the plain tie that a slack or yielding one must excel; without a force a
    # tie stands in for a storey
    ties = bool(driven) and any("new link" in law.acts_at for law in catalogue)
    for law in catalogue:
        if (
            any(name not in covariates for name in law.covariates)
            or "sensor" in law.acts_at
        ):
            continue
        if (law.permanent_change and n_records > 1) or (
            law.mimics_inertia and not driven
        ):
            continue
        places = []
        if "dof" in law.acts_at:
            places = [Site(f"dof {j}") for j in range(1, n + 1)]
            if (
                law.variable == "a"
            ):  # above the highest force every balance is homogeneous
                places = [
                    site
                    for site in places
                    if site.p in known and site.p <= max(driven, default=0)
                ]
        if "link" in law.acts_at:
            # on DOF 1 it is the same as in storey 1
            places += [s for s in chain.sites if s.q > 0 or not places]
        if "ground" in law.acts_at:
            places += [s for s in grounds if s not in chain.sites]
        link_only = "link" in law.acts_at and "dof" not in law.acts_at
        anywhere = link_only and not (
            law.permanent_change or law.mimics_inertia or law.covariates
        )
        if "new link" in law.acts_at or (ties and anywhere):
            places += [s for s in new_links if s not in places]
        if "two storeys" in law.acts_at:
            places += [s for s in new_links if s.p - s.q == 2]
        yield from ((law, site) for site in places)


def general_laws(work: Any, site: Site) -> tuple[ForceLaw, ForceLaw]:
    """The general law without memory and the general hysteresis, by the size of the
    motion at a site.
    """
    drift, rate, *_ = work.scales(site)
    return laws.SmoothSurface(S=drift, V=0.2 * rate), laws.PrandtlIshlinskii(
        uy=2.0 * drift
    )


def flexible(problem: Problem, work: Any) -> dict[Site, list[ForceLaw]]:
    """The laws of a problem with friction, damping, springs and sliders in every
    storey.
    """
    out = flexible_laws(
        problem, {site: work.scales(site)[0] for site in problem.chain.sites}
    )
    if all("vg" in segment.covariates for segment in work.data.segments):
        for j in range(1, problem.chain.n_dof + 1):
            out.setdefault(Site(f"dof {j}"), []).append(
                laws.GroundFriction(covariate="vg")
            )
    return out
