"""The results of a survey: every arm, and the comparison of the fleet."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pneunet_ros.calibration.fleet import Fleet
from pneunet_ros.model.arm import Arm


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SurveyedArm:
    """A finished or failed arm.

    failed: the reason in a sentence, empty if it did not fail. found: results of calibration and
    diagnosis, with the keys of `diagnosis.json`, `loaded`, `target_std`, `checks` and `notes`;
    arm: its model with the missing effects. Both are empty if it failed. folder: of its files,
    relative to the page; recordings: its files; arm_file: the file used for its calibration.
    """

    name: str
    folder: str
    failed: str
    found: Mapping[str, Any]
    arm: Arm | None
    recordings: tuple[str, ...]
    arm_file: str

    @property
    def answer(self) -> str:
        """The answer of the diagnosis."""
        return str(self.found.get('answer', 'failed'))

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the effects that were added."""
        return tuple(item['name'] for item in self.found.get('effects', ()))

    @property
    def alternatives(self) -> tuple[str, ...]:
        """Names of effects that cannot be distinguished from the added ones."""
        return tuple(self.found.get('alternatives', ()))

    @property
    def errors(self) -> tuple[float, float] | None:
        """Model error (m rms) before and after, on held-out recordings if any."""
        gap = self.found.get('gap') or {}
        errors = gap.get('heldout') or gap.get('training')
        return None if errors is None else (errors['before']['rms_m'], errors['after']['rms_m'])

    @property
    def held_out(self) -> bool:
        """Whether the model error is from held-out recordings."""
        return bool((self.found.get('gap') or {}).get('heldout'))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SurveyData:
    """All arms in order, and the fleet of the calibrated ones.

    left_out: folders of the source without an arm; output: the folder of the page.
    """

    source: str
    arms: tuple[SurveyedArm, ...]
    fleet: Fleet
    output: str
    left_out: tuple[str, ...] = ()

    @property
    def done(self) -> tuple[SurveyedArm, ...]:
        """The arms that did not fail."""
        return tuple(item for item in self.arms if not item.failed)

    @property
    def odd(self) -> frozenset[str]:
        """Names of the outliers."""
        return frozenset(self.fleet.names[place] for place in self.fleet.odd)

    @property
    def named(self) -> tuple[SurveyedArm, ...]:
        """The arms with a named effect, distinguished from all others."""
        return tuple(item for item in self.done if item.answer == 'named')

    def effect_counts(self) -> dict[str, int]:
        """Return the number of arms in which each effect was named, most frequent first."""
        return dict(Counter(name for item in self.named for name in item.effects).most_common())

    def answer_counts(self) -> dict[str, int]:
        """Return the number of arms per answer."""
        return dict(Counter(item.answer for item in self.done).most_common())

    def rare_effects(self) -> dict[str, list[str]]:
        """Return the effects named in fewer than half of the arms, with these arms."""
        counts = self.effect_counts()
        return {
            name: [item.name for item in self.named if name in item.effects]
            for name, count in counts.items()
            if 2 * count < len(self.done)
        }

    def could_show(self, effect: str) -> int:
        """Return the number of arms in which an effect was detectable but not detected."""
        return sum(
            bool(item.found['detectable'].get(effect, {}).get('observable'))
            for item in self.done
            if effect not in (*item.effects, *item.alternatives)
        )
