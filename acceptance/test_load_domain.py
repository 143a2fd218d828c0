"""The script about the domain: its samples are outside, its truth is that of the lab."""

from __future__ import annotations

import load_domain
import numpy as np
from pneunet_ros.lab.scenario import Detail
from pneunet_ros.model.domain import Domain
import pytest
from support.example_arms import rebuilt
from support.lab_run import true_model

NARROW = Domain(pressure=(0.0, 40e3), end_load=[[0.15, 0.0, 0.0, 0.0], [0.1, 0.12, 0.0, 40e3]])


def test_samples_are_as_far_outside_as_they_say():
    arm = rebuilt(true_model(load_domain.rig('plain')), domain=NARROW)
    samples = load_domain.draw_samples(arm, 60, np.random.default_rng(1))
    far = [sample.beyond for sample in samples]
    assert 0.0 < min(far) < 0.5 < 5.0 < max(far) <= load_domain.FURTHEST
    for sample in samples:
        at = np.array([*sample.force, 0.0, np.clip(sample.pressure, 0.0, 40e3)])
        by_load = arm.load_hull.share(arm.load_hull.distance(at, np.zeros(4)))
        outside = max(-sample.pressure, sample.pressure - 40e3, 0.0) / 40e3
        assert max(by_load, outside) == pytest.approx(sample.beyond, rel=1e-6)


def test_a_model_that_knows_the_truth_covers_it(monkeypatch):
    """Far out all is refused; near, the truth is within what is added for not knowing the law."""

    def knowing(scenario):
        return rebuilt(true_model(scenario), domain=NARROW)

    def coarse(name):
        return load_domain.replace(rig(name), detail=Detail(elements=64.0))

    rig = load_domain.rig
    monkeypatch.setattr(load_domain, 'calibrated', knowing)
    monkeypatch.setattr(load_domain, 'rig', coarse)
    found = load_domain.summary(load_domain.answers('plain', 40))
    assert (found['samples'], found['neither']) == (40, 0)
    assert min(found['refused'], found['flagged']) > 5
    assert found['covered'] >= 0.9
    assert found['median_error_mm'] < found['median_std_mm']
