"""Random chains, excitations and effects, simulated; the truth stays in the case, the
loop sees records.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.interpolate import CubicSpline

from .formulas import CODE, KINDS, N_PAR, along, integrate
from .sensors import imperfect

EXCITATIONS = ("random", "hammer", "sweep", "earthquake")
N_SAMPLES = 8192
# Effect over its storey's force (rms), smallest and largest.
SHARE = (0.03, 0.30)


@dataclass
class Effect:
    """An undeclared effect: kind, link (p, q) (q = 0 is the ground) or DOF p,
    parameters in SI units.
    """

    kind: str
    p: int
    q: int
    par: np.ndarray
    share: float = 0.0

    @property
    def on_dof(self) -> bool:
        """Whether it acts on one DOF from outside."""
        return self.kind in ("harmonic", "constant")

    @property
    def site(self) -> str:
        """Where, in the grammar of the package."""
        if self.on_dof:
            return f"dof {self.p}"
        return (
            f"storey {self.p}"
            if self.p == self.q + 1
            else f"ground {self.p}"
            if self.q == 0
            else f"link {self.p}-{self.q}"
        )

    def force(self, t, s, v, vg, sub: int = 16) -> np.ndarray:
        """Force along a motion of its two ends, N."""
        return along(
            CODE[self.kind],
            self.par,
            *(np.ascontiguousarray(y, dtype=float) for y in (s, v, t, vg)),
            sub,
        )


@dataclass
class Structure:
    """Masses (kg) and storey laws k s + c v + k3 s^3 (N/m, N s/m, N/m^3)."""

    m: np.ndarray
    k: np.ndarray
    c: np.ndarray
    k3: np.ndarray

    @property
    def n(self) -> int:
        """Number of masses."""
        return len(self.m)


@dataclass
class Run:
    """A simulated test without noise: time, forces, base motion, motion, forces of the
    effects.
    """

    fs: float
    F: np.ndarray
    ag: np.ndarray
    vg: np.ndarray
    xg: np.ndarray
    x: np.ndarray
    v: np.ndarray
    a: np.ndarray
    effects: np.ndarray

    @property
    def t(self) -> np.ndarray:
        """Seconds."""
        return np.arange(len(self.x)) / self.fs

    def ends(self, effect: Effect) -> tuple[np.ndarray, np.ndarray]:
        """Drift and rate between the ends of an effect."""
        p, q = effect.p - 1, effect.q - 1
        return (
            self.x[:, p] - (self.x[:, q] if q >= 0 else 0.0),
            self.v[:, p] - (self.v[:, q] if q >= 0 else 0.0),
        )


@dataclass
class Case:
    """One case of the battery. ``seen`` and ``unseen`` are what the loop gets (channels
    as dictionaries).
    """

    name: str
    group: str
    seed: int
    noise: float
    degree: int
    excitation: str
    forced: tuple[int, ...]
    structure: Structure
    effects: list[Effect]
    runs: list[Run] = field(default_factory=list)
    seen: list[dict] = field(default_factory=list)
    unseen: list[dict] = field(default_factory=list)
    sensors: str = ""

    @property
    def base(self) -> bool:
        """Whether the base moves and no force acts."""
        return not self.forced


# -- structures ----------------------------------------------------------------


def frequencies(m, k) -> np.ndarray:
    """Natural frequencies of the undamped chain, Hz."""
    n = len(m)
    K = (
        np.diag(k) + np.diag(np.r_[k[1:], 0.0]) - np.diag(k[1:], 1) - np.diag(k[1:], -1)
        if n > 1
        else np.array([[k[0]]])
    )
    return np.sqrt(np.linalg.eigvalsh(K / np.sqrt(np.outer(m, m)))) / (2 * np.pi)


def draw_structure(rng, n: int) -> tuple[Structure, np.ndarray]:
    """Masses of 5 to 5e4 kg, natural frequencies of 1 to 30 Hz, damping of 1 to 3 % in
    each storey.
    """
    m = np.clip(
        10 ** rng.uniform(np.log10(5), np.log10(5e4)) * rng.uniform(0.7, 1.4, n),
        5.0,
        5e4,
    )
    k = m.mean() * rng.uniform(0.6, 1.6, n)
    f = frequencies(m, k)
    top = np.exp(rng.uniform(np.log(min(1.05 * f[-1] / f[0], 29.0)), np.log(30.0)))
    k = k * (top / f[-1]) ** 2
    c = 2 * rng.uniform(0.01, 0.03, n) * np.sqrt(k * m)
    return Structure(m, k, c, np.zeros(n)), frequencies(m, k)


# -- excitations ---------------------------------------------------------------


def band_noise(rng, n: int, fs: float, lo: float, hi: float) -> np.ndarray:
    """Gaussian noise between two frequencies (Hz), rms 1."""
    spectrum = np.fft.rfft(rng.standard_normal(n))
    f = np.fft.rfftfreq(n, 1 / fs)
    spectrum[(f < lo) | (f > hi)] = 0.0
    y = np.fft.irfft(spectrum, n)
    return y / np.sqrt(np.mean(y**2))


def draw_loads(
    rng, kind: str, n_columns: int, n: int, fs: float, f: np.ndarray
) -> np.ndarray:
    """Columns of one kind of excitation over the chain's natural frequencies f (Hz);
    arbitrary scale.
    """
    t = np.arange(n) / fs
    lo, hi = 0.4 * f[0], min(1.4 * f[-1], 0.2 * fs)
    out = np.zeros((n, n_columns))
    if kind == "random":
        for j in range(n_columns):
            out[:, j] = band_noise(rng, n, fs, lo, hi)
    elif kind == "hammer":
        width = 0.7 / hi  # a half-sine whose spectrum reaches to the highest mode
        hits = max(6, 3 * n_columns) + int(rng.integers(0, 4))
        for h in range(hits):
            start = t[-1] * (h + rng.uniform(0.02, 0.4)) / hits
            inside = (t >= start) & (t <= start + width)
            out[inside, h % n_columns] += (
                rng.uniform(0.6, 1.4)
                * rng.choice([-1, 1])
                * np.sin(np.pi * (t[inside] - start) / width)
            )
    elif kind == "sweep":
        for j in range(n_columns):
            a, b = lo * rng.uniform(0.8, 1.2), hi * rng.uniform(0.8, 1.0)
            rate = np.log(b / a) / t[-1]
            phase = 2 * np.pi * a * (np.exp(rate * t) - 1) / rate
            y = np.sin(phase + rng.uniform(0, 2 * np.pi))
            out[:, j] = y if rng.random() < 0.5 or n_columns == 1 else y[::-1]
        ramp = np.clip(t / (0.03 * t[-1]), 0, 1)
        out *= (np.sin(0.5 * np.pi * ramp) ** 2)[:, None]
    else:  # earthquake-like: Kanai-Tajimi noise under an envelope
        for j in range(n_columns):
            white = np.fft.rfft(rng.standard_normal(n))
            w, wg, z = (
                np.fft.rfftfreq(n, 1 / fs),
                np.exp(rng.uniform(np.log(0.7 * f[0]), np.log(1.2 * f[-1]))),
                0.5,
            )
            with np.errstate(divide="ignore", invalid="ignore"):
                r = w / wg
                gain = (
                    np.sqrt(
                        (1 + (2 * z * r) ** 2) / ((1 - r**2) ** 2 + (2 * z * r) ** 2)
                    )
                    * r**2
                    / np.sqrt(1 + r**4)
                )
            gain[(w < 0.3 * lo) | (w > hi)] = 0.0
            y = np.fft.irfft(white * gain, n)
            u = t / t[-1]
            out[:, j] = (
                y
                * np.clip(u / 0.15, 0, 1) ** 2
                * np.exp(-2.5 * np.clip(u - 0.4, 0, None))
            )
    return out


def base_motion(
    ag: np.ndarray, fs: float, lo: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Acceleration, velocity and displacement of a base that has no content below lo/3
    (Hz).
    """
    spectrum = np.fft.rfft(ag)
    f = np.fft.rfftfreq(len(ag), 1 / fs)
    keep = f > lo / 3
    w = 2 * np.pi * np.where(keep, f, 1.0)
    spectrum = np.where(keep, spectrum, 0.0)
    return tuple(
        np.fft.irfft(y, len(ag))
        for y in (spectrum, spectrum / (1j * w), -spectrum / w**2)
    )


# -- simulation ----------------------------------------------------------------


def simulate(
    structure: Structure, effects: list[Effect], F, ag, vg, xg, fs: float, sub: int = 12
) -> Run:
    """One test from rest; loads are cubic splines between the samples."""
    n = structure.n
    load = np.ascontiguousarray(
        CubicSpline(np.arange(len(F)) / fs, np.column_stack([F, ag, vg])).c
    )
    kinds = np.array([CODE[e.kind] for e in effects], dtype=np.int64)
    ends = np.array([[e.p, e.q] for e in effects], dtype=np.int64).reshape(-1, 2)
    pars = np.array([e.par for e in effects], dtype=float).reshape(-1, N_PAR)
    x, v, a, eff = integrate(
        load,
        len(F),
        1 / fs,
        _substeps(structure, effects, fs, sub),
        structure.m,
        structure.k,
        structure.c,
        structure.k3,
        kinds,
        ends,
        pars,
    )
    return Run(fs, F, ag, vg, xg, x[:, :n], v, a, eff)


def _substeps(
    structure: Structure, effects: list[Effect], fs: float, least: int
) -> int:
    """Enough sub-steps for the steepest part of the effects."""
    lightest = structure.m.min()
    rate = 0.0
    for e in effects:
        if e.kind in ("coulomb", "stribeck", "asymmetric_friction", "ground_friction"):
            rate = max(rate, 2.0 * e.par[0] * (1 + abs(e.par[2])) / e.par[1] / lightest)
        elif e.kind == "power_damping":
            rate = max(rate, 2.0 * e.par[0] * e.par[1] ** (e.par[2] - 1) / lightest)
        elif e.kind in ("one_sided_gap", "two_sided_gap", "brace", "ground_link"):
            rate = max(rate, 4 * np.sqrt(2 * e.par[0] / lightest))
        elif e.kind == "dahl":
            rate = max(rate, 4 * np.sqrt(2 * e.par[0] * e.par[1] / lightest))
        elif e.kind in ("jenkins", "bouc_wen"):
            rate = max(rate, 4 * np.sqrt(2 * e.par[0] / e.par[1] / lightest))
    return int(
        np.clip(np.ceil(1.5 * rate / fs), least if rate == 0.0 else 4 * least, 400)
    )


# -- effects -------------------------------------------------------------------


def draw_shape(
    rng, kind: str, s: float, v: float, duration: float, f: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Parameters without amplitude for rms drift s and rate v, and their powers of (s,
    v) to rescale by.
    """
    p, power = np.zeros(N_PAR), np.zeros((N_PAR, 2))
    if kind in ("coulomb", "stribeck", "asymmetric_friction", "ground_friction"):
        p[1], power[1] = v * 10 ** rng.uniform(-3, -2), (0, 1)
        if kind == "stribeck":
            p[2], p[3], power[3] = (
                rng.uniform(0.5, 1.5),
                v * rng.uniform(0.2, 0.8),
                (0, 1),
            )
        if kind == "asymmetric_friction":
            p[2] = rng.choice([-1, 1]) * rng.uniform(0.25, 0.6)
    elif kind == "quadratic_damping":
        p[1], power[1] = 1e-3 * v, (0, 1)
    elif kind == "power_damping":
        p[1], power[1], p[2] = 1e-3 * v, (0, 1), rng.uniform(0.25, 0.55)
    elif kind in ("one_sided_gap", "two_sided_gap"):
        p[1], power[1] = s * rng.uniform(0.4, 1.4), (1, 0)
        p[2], power[2] = (
            (0.0 if rng.random() < 0.5 else s * rng.uniform(0.01, 0.05)),
            (
                1,
                0,
            ),
        )
        p[3] = rng.choice([-1.0, 1.0])
    elif kind == "bilinear":
        p[1], power[1] = (
            (0.0 if rng.random() < 0.5 else s * rng.uniform(0.01, 0.05)),
            (
                1,
                0,
            ),
        )
    elif kind == "dahl":
        p[1], power[1] = 10 ** rng.uniform(0.0, 1.5) / s, (-1, 0)
    elif kind == "bouc_wen":
        p[1], power[1] = s * rng.uniform(0.3, 1.0), (1, 0)
        p[2], p[3] = rng.uniform(0.35, 0.9), rng.choice([1.0, 1.5, 2.0])
    elif kind == "jenkins":
        p[1], power[1] = s * rng.uniform(0.2, 0.9), (1, 0)
    elif kind == "maxwell":
        p[1] = s / v * 10 ** rng.uniform(-0.4, 0.5)
    elif kind == "stiffness_step":
        p[1], p[2] = (
            duration * rng.uniform(0.3, 0.65),
            0.02 / f[-1] * rng.uniform(0.1, 1.0),
        )
    elif kind in ("stiffness_drift", "damping_drift"):
        p[1] = duration
    elif kind == "harmonic":
        p[1], p[2] = (
            f[0] * rng.uniform(0.6, 1.0) * (f[-1] / f[0]) ** rng.random(),
            rng.uniform(0, 2 * np.pi),
        )
    elif kind in ("brace", "ground_link"):
        p[1] = rng.uniform(0.0, 2.0) * 0.02 * s / v
    return p, power


def draw_place(rng, kind: str, n: int, base: bool) -> tuple[int, int]:
    """Ends (p, q) of an effect on a chain of n masses; q = 0 is the ground."""
    if kind in ("harmonic", "constant"):
        return int(rng.integers(1, n + 1)), 0
    if kind == "brace":
        p = int(rng.integers(3, n + 1))
        return p, int(rng.integers(1, p - 1))
    if kind in ("ground_link", "ground_friction"):
        return (
            int(rng.integers(1 if base and kind == "ground_friction" else 2, n + 1)),
            0,
        )
    p = int(rng.integers(1, n + 1))
    return p, p - 1


def possible(kind: str, n: int, base: bool) -> bool:
    """Whether a kind of effect exists on such a chain (and is not a storey law under
    another name).
    """
    if kind == "brace":
        return n >= 3
    if kind == "ground_link":
        return n >= 2
    if kind == "ground_friction":
        return n >= 2 or base
    return True


def sign_of(rng, kind: str) -> float:
    """Sign of the amplitude: some effects soften or weaken as often as they stiffen."""
    if kind in ("stiffness_step", "stiffness_drift", "bilinear"):
        return float(rng.choice([-1.0, -1.0, 1.0]))
    if kind in ("cubic", "quadratic", "constant", "odd_quadratic"):
        return float(rng.choice([-1.0, 1.0, 1.0]))
    return 1.0


def shares(structure: Structure, effects: list[Effect], run: Run) -> np.ndarray:
    """Rms of each effect over the rms of the force of the storey below its upper
    end.
    """
    out = []
    for i, e in enumerate(effects):
        s = run.x[:, e.p - 1] - (run.x[:, e.p - 2] if e.p > 1 else 0.0)
        v = run.v[:, e.p - 1] - (run.v[:, e.p - 2] if e.p > 1 else 0.0)
        j = e.p - 1
        storey = structure.k[j] * s + structure.c[j] * v + structure.k3[j] * s**3
        out.append(np.sqrt(np.mean(run.effects[:, i] ** 2) / np.mean(storey**2)))
    return np.array(out)


def calibrate(
    rng, structure, kinds, places, loads, fs, f, targets
) -> tuple[list[Effect], Run] | None:
    """Effects of the wanted size on this chain, and the run with them; None if there is
    no such size.
    """
    n_samples = len(loads[0])
    plain = simulate(structure, [], *loads, fs)
    effects, powers, base_sizes = [], [], []
    for kind, (p, q), target in zip(kinds, places, targets):
        e = Effect(kind, p, q, np.zeros(N_PAR), target)
        s, v = plain.ends(e)
        size = np.sqrt([np.mean(s**2), np.mean(v**2)])
        e.par, power = draw_shape(rng, kind, *size, n_samples / fs, f)
        e.par[0] = sign_of(rng, kind)
        one = e.force(plain.t, s, v, plain.vg)
        js, jv = (
            y[:, p - 1] - (y[:, p - 2] if p > 1 else 0.0) for y in (plain.x, plain.v)
        )
        storey = (
            structure.k[p - 1] * js
            + structure.c[p - 1] * jv
            + structure.k3[p - 1] * js**3
        )
        if not one.any():
            return None
        e.par[0] *= target * np.sqrt(np.mean(storey**2) / np.mean(one**2))
        effects.append(e)
        powers.append(power)
        base_sizes.append(size)
    for _ in range(12):
        run = simulate(structure, effects, *loads, fs)
        if (
            not np.isfinite(run.x).all()
            or np.abs(run.x).max() > 50 * np.abs(plain.x).max()
        ):
            return None
        found = shares(structure, effects, run)
        if all(0.85 * t <= r <= 1.15 * t for r, t in zip(found, targets)) and all(
            SHARE[0] <= r <= SHARE[1] for r in found
        ):
            for e, r in zip(effects, found):
                e.share = float(r)
            return effects, run
        for i, (e, r) in enumerate(zip(effects, found)):
            s, v = run.ends(e)
            size = np.sqrt([np.mean(s**2), np.mean(v**2)])
            e.par[1:] *= np.prod((size / base_sizes[i]) ** powers[i][1:], axis=1)
            base_sizes[i] = size
            e.par[0] *= np.clip(targets[i] / max(r, 1e-12), 0.4, 2.5) ** 0.9
    return None


# -- cases ---------------------------------------------------------------------


def make_case(
    name: str,
    group: str,
    seed: int,
    noise: float,
    kinds: tuple[str, ...] = (),
    *,
    base: bool | None = None,
    degree: int = 1,
    n_samples: int = N_SAMPLES,
    most: int = 6,
    excitation: str | None = None,
    accelerations_only: bool = False,
    sensors: str = "",
    every: bool = False,
) -> Case:
    """Draw one case; the same arguments always give the same case.

    Parameters
    ----------
    name, group : str
    seed : int
    noise : float
        White noise on every channel that is measured (F of the forced DOFs, a, v, x of
        all DOFs, and ag, vg, xg of a moving base), as a share of its rms.
    kinds : tuple of str
        Effects; on different sites if several.
    base : bool, optional
        Base excitation with known masses, instead of forces.
    degree : int
        Of the storeys: 1 linear, 3 with a cubic spring that is part of the declared
        model.
    n_samples : int
    most : int
        Masses at most.
    excitation : str, optional
    accelerations_only : bool
        One force and the accelerations of all DOFs are all that is measured.
    sensors : str
        One of ``sensors.FAULTS``: an imperfection that all sensors share.
    every : bool
        The effect is in every storey, of four at least.

    Returns
    -------
    Case
    """
    rng = np.random.default_rng([seed, 20240])
    base = bool(base)
    least = (
        3
        if "brace" in kinds
        else (
            2
            if not all(possible(kind, 1, base) for kind in kinds)
            else len(kinds)
            if len(kinds) > 1
            else 1
        )
    )
    one = kinds
    for _ in range(200):
        n = int(rng.integers(4 if every else least, most + 1))
        kinds = one * n if every else one
        structure, f = draw_structure(rng, n)
        fs = float(np.round(f[-1] * rng.uniform(16, 28), 1))
        how = excitation or str(
            rng.choice(
                EXCITATIONS if not base else ("random", "earthquake", "earthquake")
            )
        )
        whole = not accelerations_only and not base and rng.random() < 0.5
        forced = (
            ()
            if base
            else tuple(range(1, n + 1))
            if whole
            else (int(rng.integers(1, n + 1)),)
        )
        drift = 10 ** rng.uniform(-4.5, -2)
        loads = scaled_loads(rng, structure, f, fs, how, forced, n_samples, drift)
        if degree == 3:
            plain = simulate(structure, [], *loads, fs)
            s = np.diff(plain.x, axis=1, prepend=0.0)
            structure.k3 = (
                rng.uniform(0.03, 0.12, n) * structure.k / np.mean(s**2, axis=0)
            )
        places = [
            (i, i - 1) if every else draw_place(rng, kind, n, base)
            for i, kind in enumerate(kinds, 1)
        ]
        if len({(p, q) for p, q in places}) < len(places):
            continue
        targets = np.exp(
            rng.uniform(np.log(1.05 * SHARE[0]), np.log(0.9 * SHARE[1]), len(kinds))
        )
        done = calibrate(rng, structure, kinds, places, loads, fs, f, targets)
        if done is None:
            continue
        effects, run = done
        further = [
            scaled_loads(
                rng, structure, f, fs, how, forced, n_samples, None, like=loads
            )
            for _ in range(1)
        ]
        others = [simulate(structure, effects, *more, fs) for more in further]
        if not all(np.isfinite(r.x).all() for r in others):
            continue
        case = Case(
            name,
            group,
            seed,
            noise,
            degree,
            how,
            forced,
            structure,
            effects,
            [run, *others],
        )
        every = [channels(rng, r, noise, forced) for r in (run, *others)]
        if accelerations_only:
            every = [
                {k: y for k, y in one.items() if k in ("fs", "acceleration", "force")}
                for one in every
            ]
        case.sensors = sensors
        if sensors:  # one installation for all tests
            every = [
                imperfect(np.random.default_rng([seed, 7]), one, sensors)
                for one in every
            ]
        case.seen, case.unseen = every[:1], every[1:]
        return case
    raise RuntimeError(f"no chain was found for {name} (seed {seed}, {kinds})")


def scaled_loads(rng, structure, f, fs, how, forced, n, drift, like=None):
    """Forces, base acceleration, velocity, displacement; scaled to an rms drift (m), or
    like other loads.
    """
    F, ag, vg, xg = np.zeros((n, structure.n)), np.zeros(n), np.zeros(n), np.zeros(n)
    if forced:
        columns = [j - 1 for j in forced]
        F[:, columns] = (
            draw_loads(rng, how, len(columns), n, fs, f) * structure.m[columns]
        )
    else:
        ag, vg, xg = base_motion(
            draw_loads(rng, how, 1, n, fs, f)[:, 0], fs, 0.4 * f[0]
        )
    if like is None:
        run = simulate(structure, [], F, ag, vg, xg, fs, 4)
        scale = drift / np.sqrt(np.mean(np.diff(run.x, axis=1, prepend=0.0) ** 2))
    else:
        size = [
            np.sqrt(np.mean(y**2)) for y in ((F, like[0]) if forced else (ag, like[1]))
        ]
        scale = size[1] / size[0]
    return F * scale, ag * scale, vg * scale, xg * scale


def channels(rng, run: Run, noise: float, forced: tuple[int, ...]) -> dict:
    """Measured channels of a run: white noise of ``noise`` times its rms on each that
    moves.
    """

    def noisy(y):
        return y + noise * np.sqrt(np.mean(y**2, axis=0)) * rng.standard_normal(y.shape)

    out = {
        "fs": run.fs,
        "acceleration": noisy(run.a),
        "velocity": noisy(run.v),
        "displacement": noisy(run.x),
    }
    if forced:
        out["force"] = np.where(run.F.any(axis=0), noisy(run.F), 0.0)
    else:
        out |= {
            "base_acceleration": noisy(run.ag),
            "base_velocity": noisy(run.vg),
            "base_displacement": noisy(run.xg),
        }
    return out


def effect_cycle(n: int, base: bool) -> list[str]:
    """Kinds that exist on a chain of n masses."""
    return [kind for kind in KINDS if possible(kind, n, base)]
