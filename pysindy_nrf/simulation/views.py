"""The arrays of a system and its rooms without their owners. Compiled."""

from __future__ import annotations

from ..laws.compiled import borrow, inline
from .system import Stages, System, Work


@inline
def borrow_system(s):
    return System(
        borrow(s.masses), borrow(s.sites), borrow(s.laws), borrow(s.coefficients), borrow(s.theta), borrow(s.channels),
        s.link_inertia, s.t0,
    )  # fmt: skip


@inline
def borrow_work(w):
    return Work(
        borrow(w.out), borrow(w.u), borrow(w.mass), borrow(w.inertia), borrow(w.matrix), borrow(w.column),
        borrow(w.hold), borrow(w.load), borrow(w.jump), borrow(w.share), borrow(w.stuck),
    )  # fmt: skip


@inline
def borrow_stages(k):
    return Stages(
        borrow(k.v), borrow(k.a), borrow(k.power), borrow(k.row), borrow(k.middle), borrow(k.force), borrow(k.force0),
        borrow(k.x_half), borrow(k.v_half), borrow(k.z_once), borrow(k.z_top), borrow(k.top), borrow(k.work),
    )  # fmt: skip
