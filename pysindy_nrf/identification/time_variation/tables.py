"""A judgement as tables."""

from __future__ import annotations

import numpy as np
import pandas as pd
from scipy import stats

from .evidence import FALSE_ALARM_RATE
from .followed import Followed
from .judgement import Judgement
from .request import Place
from .values import LEVEL, CourseValues
from .variation import CHANGING, TimeVariation

_INSTANTS = ["site", "term", "t", "t_lower", "t_upper", "change"]


def variation_of(judgement: Judgement) -> TimeVariation:
    """Everything that is known of changes, as tables."""
    followed = judgement.declared
    tables = []
    rows = []
    instants: list[dict[str, object]] = []
    for number, place in zip(followed.tested, followed.places):
        course = judgement.courses[number]
        kind = judgement.kinds[number]
        tables.append(_table(followed, place, course))
        rows.append(_row(judgement, number, place))
        if kind in CHANGING:
            instants.extend(_instants(followed, place, course))
    errors = {
        "constant": followed.error(followed.constant),
        "varying": followed.error(judgement.shaped),
    }
    return TimeVariation(
        pd.concat(tables, ignore_index=True),
        pd.DataFrame(rows),
        pd.DataFrame(instants, columns=_INSTANTS),
        followed.masses(judgement.estimate.shaped.fit.over_time[0]),
        pd.Series(errors),
        FALSE_ALARM_RATE,
        followed.pieces.period,
    )


def _table(followed: Followed, place: Place, course: CourseValues) -> pd.DataFrame:
    """A course with its band."""
    site, label = place
    return pd.DataFrame(
        {
            "site": str(site),
            "term": label,
            "unit": _unit(followed, place),
            "t": followed.pieces.middles,
            "value": course.values,
            "lower": course.lower if course.is_bounded else np.nan,
            "upper": course.upper if course.is_bounded else np.nan,
        }
    )


def _unit(followed: Followed, place: Place) -> str:
    """SI unit of a coefficient."""
    site, label = place
    problem = followed.problem
    units = [term.unit for law in problem.laws[site] for term in law.terms()]
    return units[problem.layout.labels(site).index(label)]


def _row(judgement: Judgement, number: int, place: Place) -> dict[str, object]:
    """What is known of the change of one coefficient."""
    course = judgement.courses[number]
    values = course.values
    first, last = float(values[0]), float(values[-1])
    change = 100 * (last - first) / abs(first)
    reach = np.nan
    if course.is_bounded:
        quantile = float(stats.norm.ppf((1 + LEVEL) / 2))
        reach = quantile * 100 * course.error_of_change / abs(first)
    log_probability = judgement.search.evidence[number]
    n_tests = len(judgement.declared.tested)
    return {
        "site": str(place[0]),
        "term": place[1],
        "kind": judgement.kinds[number],
        "first": first,
        "last": last,
        "lowest": float(values.min()),
        "change": change,
        "lower": change - reach,
        "upper": change + reach,
        "p": min(1.0, n_tests * float(np.exp(log_probability))),
    }


def _instants(
    followed: Followed, place: Place, course: CourseValues
) -> list[dict[str, object]]:
    """Sudden changes of one coefficient."""
    times = followed.pieces.times
    last = len(times) - 1
    tails = [(1 - LEVEL) / 2, (1 + LEVEL) / 2]
    rows = []
    for step in course.steps:
        before = float(course.values[step.piece - 1])
        low, high = np.searchsorted(step.passed, tails)
        values = (
            str(place[0]),
            place[1],
            float(times[step.piece]),
            float(times[min(low, last)]),
            float(times[min(high + 1, last)]),
            100 * step.height / abs(before),
        )
        rows.append(dict(zip(_INSTANTS, values)))
    return rows
