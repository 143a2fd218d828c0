"""A line load as a direction of gravity."""

from __future__ import annotations

from dataclasses import replace

from pneunet_ros.diagnosis.fit.augmented_model import direction_notes
from pneunet_ros.diagnosis.result import Estimated, NamedEffect
from pneunet_ros.model.gravity import gravity_of
import pytest
from support.example_arms import paper_arm

PER_LENGTH = 0.17 / 0.112


def named(x: float, y: float, std: float = 0.01, name: str = 'gravity') -> list[NamedEffect]:
    """Return an effect with a line load, in weights of the arm per length."""
    sizes = {'weight_x': x, 'weight_y': y}
    parameters = {
        key: Estimated(value=size * PER_LENGTH, std=std * PER_LENGTH, unit='N/m')
        for key, size in sizes.items()
    }
    return [NamedEffect(name=name, parameters=parameters, probability=0.98)]


@pytest.mark.parametrize(
    ('known', 'found', 'words'),
    [
        ('out_of_plane', (0.0, -0.5), '--gravity=0.000,-0.500'),
        ([0.0, -1.0], (0.3, 0.046), '--gravity=0.300,-0.954'),
        ([0.0, -1.0], (0.0, -0.015), '--gravity=0.000,-1.000'),
    ],
)
def test_a_load_that_the_arm_weighs_is_a_direction(known, found, words):
    arm = replace(paper_arm(), gravity=gravity_of(known))
    (note,) = direction_notes(arm, named(*found))
    assert words in note


def test_a_load_of_more_than_the_arm_weighs_is_none():
    assert direction_notes(paper_arm(), named(0.0, -1.5)) == ()
    assert direction_notes(paper_arm(), named(0.0, -0.5, name='contact')) == ()
