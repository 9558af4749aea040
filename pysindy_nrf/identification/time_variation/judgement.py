"""What changes, and what may only depend on the amplitude."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from .along_run import along_free_run
from .amplitude import with_amplitude_dependence
from .courses import STRONG, ShapedFit
from .evidence import Search
from .followed import Followed
from .penalised import PenalisedFit
from .values import (
    AlongMotion,
    CourseValues,
    Estimate,
    course_values,
    lasting_share,
)
from .variation import (
    AMPLITUDE,
    BOTH,
    CONSTANT,
    EITHER,
    GRADUAL,
    SUDDEN,
    UNCERTAIN,
)

# Share of what changes and laws of the amplitude explain together, that changes must
# explain beside these laws. From the upper one on nothing more is asked; between both
# a change must last: the mean of its course over the last fifth of the information
# differs from that over the first by at least this share of its range. What nine
# sliders leave of a smooth hysteresis follows the amplitude and returns: 0.02 at most
# of ten structures that do not change, 0.05 at least of eight whose hysteresis
# degrades (seed 7000 of ``benchmarks/time_varying.py``, which is not reported).
LEAST_SHARE = 0.15
ENOUGH_SHARE = 0.5
LEAST_LASTING = 0.05


@dataclass(frozen=True, eq=False)
class Judgement:
    """What changes, and what may only depend on the amplitude."""

    declared: Followed
    automatic: bool

    @cached_property
    def search(self) -> Search:
        """What changes if the declared laws hold."""
        return self.declared.search()

    @cached_property
    def amplitude(self) -> Followed:
        """The same next to laws of the amplitude, at the sites that seem to change."""
        followed = self.declared
        sites = {
            place[0]
            for number, place in zip(followed.tested, followed.places)
            if number in self.search.shaped.shapes
        }
        problem = with_amplitude_dependence(followed.problem, followed.data, sites)
        return replace(followed, problem=problem)

    @cached_property
    def beside_amplitude(self) -> Search:
        """What of it is still seen next to laws of the amplitude."""
        renamed = dict(zip(self.declared.tested, self.amplitude.tested))
        suspects = [renamed[number] for number in self.search.changing]
        return self.amplitude.search(suspects)

    @cached_property
    def kinds(self) -> dict[int, str]:
        """What each followed coefficient does."""
        kinds = dict.fromkeys(self.declared.tested, CONSTANT)
        suspects = self.search.changing
        if not suspects:
            return kinds
        for number in suspects:
            kinds[number] = self._without_change
        for number in self._certain:
            shape = self.shaped.shapes[number]
            kinds[number] = GRADUAL
            if shape.steps:
                kinds[number] = BOTH if shape.gradual else SUDDEN
            if self._is_doubtful(number) or self._lacks_something:
                kinds[number] = UNCERTAIN
        return kinds

    def _is_doubtful(self, number: int) -> bool:
        """Whether noise, or something that is missing, may look like the change."""
        if number not in self._seen.shaped.shapes:
            return True
        course = self.courses[number]
        return course.may_be_constant or course.is_negative

    @cached_property
    def _lacks_something(self) -> bool:
        """Whether a stiffness is negative: the model is not that of the data."""
        followed = self.declared
        stiffnesses = [
            number
            for number, (_, label) in zip(followed.tested, followed.places)
            if label == "s"
        ]
        return any(self.courses[number].is_negative for number in stiffnesses)

    @cached_property
    def courses(self) -> dict[int, CourseValues]:
        """Courses of all coefficients that are followed."""
        courses = {}
        for number, (_, label) in zip(self.declared.tested, self.declared.places):
            courses[number] = course_values(self.estimate, number, label)
        return courses

    @property
    def estimate(self) -> Estimate:
        """Courses of what is seen to change, and of what was named."""
        return self._seen if self.automatic else self._every_course

    @cached_property
    def _seen(self) -> Estimate:
        """Courses without those that noise in the motion feigns."""
        return self._every_course.of_what_is_seen(self.declared.tested)

    @cached_property
    def _every_course(self) -> Estimate:
        """The courses along a free run, or along the measured motion."""
        along = along_free_run(self.declared, self.shaped)
        if along is not None:
            return along
        fitter = self.declared.fitter
        return AlongMotion(fitter, self.shaped, self._otherwise_fused)

    @property
    def _certain(self) -> list[int]:
        """What changes beside laws of the amplitude, if it explains enough."""
        constant = self.declared.constant.deviance
        amplitude = self.amplitude.constant.deviance
        beside = self.beside_amplitude.shaped
        share = (amplitude - beside.deviance) / (constant - beside.deviance)
        renamed = dict(zip(self.amplitude.tested, self.declared.tested))
        certain = []
        for number in beside.shapes:
            enough = (
                share >= ENOUGH_SHARE or lasting_share(beside, number) >= LEAST_LASTING
            )
            if share >= LEAST_SHARE and enough:
                certain.append(renamed[number])
        return certain

    @cached_property
    def _without_change(self) -> str:
        """What is said where laws of the amplitude serve as well as a change."""
        in_time = self.search.shaped
        by_amplitude = self.amplitude.constant
        dispersion = min(in_time.dispersion, by_amplitude.dispersion)
        further = self.amplitude.unknowns.count - self.declared.unknowns.count
        n_pieces = len(self.declared.pieces)
        criterion = by_amplitude.criterion(dispersion) + np.log(n_pieces) * further
        is_better = criterion + STRONG < in_time.criterion(dispersion)
        return AMPLITUDE if is_better else EITHER

    @cached_property
    def shaped(self) -> ShapedFit:
        """Courses of what changes, and of what was named."""
        followed = self.declared
        shaped = self.search.shaped
        asked = list(shaped.shapes)
        if not self.automatic:
            asked = list(dict.fromkeys([*asked, *followed.tested]))
        if len(asked) > 1 or not shaped.shapes:
            # each once more beside the courses of the others
            for number in asked:
                shaped = followed.fitter.shaped(shaped, number)
        return shaped

    @cached_property
    def _otherwise_fused(self) -> PenalisedFit:
        """The same courses along the motion of each floor fused by itself.

        The difference is what noise may bias of what is linear in the motion.
        """
        followed = self.declared
        if followed.data.apart is followed.data:
            return self.shaped.fit
        apart = replace(followed, data=followed.data.apart)
        return apart.fitter.fit(self.shaped.shapes, apart.constant).fit
