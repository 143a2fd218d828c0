"""The figures and sentences of a survey."""

from __future__ import annotations

from pneunet_ros.calibration.fleet import ArmNumber
from pneunet_ros.reports.survey.figures import title_of
from pneunet_ros.reports.survey.report import rare_sentences
from pneunet_ros.reports.survey.survey_data import SurveyData, SurveyedArm
import pytest


@pytest.mark.parametrize(
    ('name', 'meaning', 'unit', 'title'),
    [
        ('turning', 'turning angle at 30.03 kPa', 'rad', 'turning angle at 30.03 kPa\n(rad)'),
        ('a_lag.time', 'a_lag.time', 's', 'a lag time (s)'),
        ('gain.share', 'gain.share', '-', 'gain share'),
    ],
)
def test_a_panel_says_its_number(name, meaning, unit, title):
    assert title_of(ArmNumber(name=name, meaning=meaning, unit=unit)) == title


def test_an_arm_has_an_effect_only_if_it_was_named():
    def arm(name, answer, *effects):
        found = {
            'answer': answer,
            'effects': [{'name': effect} for effect in effects[:1]],
            'alternatives': effects[1:],
            'detectable': {'creep': {'observable': True}},
        }
        return SurveyedArm(
            name=name, folder='', failed='', found=found, arm=None, recordings=(), arm_file=''
        )

    arms = (
        arm('one', 'named', 'creep'),
        arm('two', 'inseparable', 'creep', 'hysteresis'),
        arm('three', 'inseparable', 'hysteresis', 'creep'),
        arm('four', 'none'),
    )
    data = SurveyData(source='', arms=arms, fleet=None, output='')
    assert rare_sentences(data) == [
        'creep is named in one only; 1 of the other 3 could have shown it.'
    ]
