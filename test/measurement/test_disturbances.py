"""Disturbances of the measurement and their prior, against direct constructions."""

from __future__ import annotations

from dataclasses import replace
import math

import numpy as np
from pneunet_ros.diagnosis.settings import LINEARIZATION
from pneunet_ros.measurement.disturbances import (
    camera_path,
    disturbance_jacobian,
    Disturbances,
    painted_points,
    PATH_NODES,
    RUN_UNKNOWNS,
    tilt_jacobian,
)
import pytest
from support.example_arms import paper_arm
from support.made_datasets import made, USUAL

RANDOM = np.random.default_rng(5)
AT = np.array([0.02, 0.05, 0.1])  # m


def test_the_prior_of_disturbances():
    noise = replace(USUAL, placement_std=2e-4, registration_std=3e-4, drift_std=1e-4)
    free = made(paper_arm(), np.linspace(0.0, 4e4, 17))
    weight = free.with_end_load(0.2, 0.0)
    prior = Disturbances(arclength=AT, runs=[free, weight], noise=noise).prior
    assert prior.shape == (6 + 2 * RUN_UNKNOWNS,) * 2
    row = np.outer([*AT, 0.0, 0.0, 0.0], [*AT, 0.0, 0.0, 0.0]) * noise.row_spacing_std**2
    row[3:, 3:] = (noise.row_offset_std * AT[-1]) ** 2
    assert prior[:6, :6] == pytest.approx(4e-8 * np.eye(6) + row, rel=1e-9)
    path = prior[6 : 6 + PATH_NODES, 6 : 6 + PATH_NODES]
    # a place, and a walk that has drift_std at the end and half its variance in the middle
    assert path[0] == pytest.approx(9e-8, rel=1e-3)
    assert path[-1, -1] == pytest.approx(9e-8 + 1e-8, rel=1e-3)
    assert path[PATH_NODES // 2, -1] == pytest.approx(9e-8 + 0.5e-8, rel=1e-3)
    # all recordings share where the base frame lies across the arm
    common = (noise.row_offset_std * AT[-1]) ** 2
    for start in (6, 6 + RUN_UNKNOWNS):
        part, across = slice(start, start + PATH_NODES), slice(start + PATH_NODES, start + 2 * 9)
        assert np.array_equal(prior[part, part], path)
        assert not prior[part, : part.start].any()
        assert prior[across, across] == pytest.approx(path + common, rel=1e-9)
        assert prior[across, 6 + PATH_NODES : 6 + 2 * PATH_NODES] == pytest.approx(
            path + common if start == 6 else common, rel=1e-9
        )
    # of a load that a weight makes, its forces; nothing else has a load that is wrong throughout
    stds = np.sqrt(np.diag(prior))
    assert stds[-3:] == pytest.approx([noise.force_std, noise.force_std, 1e-7])
    assert stds[6 + 2 * PATH_NODES : 6 + RUN_UNKNOWNS] == pytest.approx(1e-7)
    assert np.linalg.eigvalsh(prior).min() > 0.0
    assert np.linalg.eigvalsh(Disturbances(arclength=AT, runs=[free], noise=replace(
        noise, placement_std=0.0, registration_std=0.0, drift_std=0.0
    )).prior).min() > 0.0  # fmt: skip


@pytest.mark.parametrize('clamp_angle', [0.0, -1.2])
def test_the_origin_is_what_all_pictures_have_in_common(clamp_angle):
    run = made(paper_arm(), np.linspace(0.0, 4e4, 17))
    disturbances = Disturbances(
        arclength=AT, runs=[run, run, run], noise=USUAL, clamp_angle=clamp_angle
    )
    normal = np.array([-np.sin(clamp_angle), np.cos(clamp_angle)])
    unknowns = np.zeros(disturbances.prior.shape[0])
    for which in range(3):
        start = 6 + which * RUN_UNKNOWNS
        unknowns[start : start + 2 * PATH_NODES] = np.repeat(2e-3 * normal, PATH_NODES)
    assert disturbances.origin(unknowns) == pytest.approx(2e-3 * normal, rel=0.01)
    few = Disturbances(arclength=AT[:2], runs=[run], noise=USUAL)
    assert not few.origin(np.ones(few.prior.shape[0])).any()  # two targets are no row


def test_targets_answer_to_disturbances():
    arm = paper_arm()
    run = made(arm, np.linspace(0.0, 4e4, 17))
    targets = arm.target_arclength.size
    disturbances = Disturbances(arclength=arm.target_arclength, runs=[run, run], noise=USUAL)
    theta = RANDOM.standard_normal((17, targets))
    parameters = RANDOM.standard_normal(disturbances.prior.shape[0])
    own = disturbances.of_run(1)
    curvature = 20.0 * RANDOM.standard_normal((17, targets))
    nowhere = painted_points(theta, curvature, np.zeros(own.size))
    found = disturbance_jacobian(run, nowhere) @ parameters[own]
    camera_alone = camera_path(run, parameters[own])
    along, across = parameters[:targets], parameters[targets : 2 * targets]
    second = parameters[2 * targets + RUN_UNKNOWNS :]
    nodes = second[: 2 * PATH_NODES].reshape(2, PATH_NODES)  # x, y
    time = np.linspace(0.0, 1.0, 17)
    for frame in range(17):
        tangent = np.stack([np.cos(theta[frame]), np.sin(theta[frame])])
        normal = np.stack([-tangent[1], tangent[0]])
        camera = [np.interp(time[frame], np.linspace(0, 1, PATH_NODES), path) for path in nodes]
        wanted = along * tangent + across * normal + np.array(camera)[:, None]
        assert found[frame] == pytest.approx(wanted, abs=1e-12)
        assert camera_alone[frame, :, 0] == pytest.approx(camera, abs=1e-12)


def test_a_run_of_one_frame_has_a_place():
    arm = paper_arm()
    run = made(arm, np.array([2e4]))
    straight = np.zeros((1, arm.target_arclength.size))
    targets = painted_points(straight, straight, np.zeros(2 * straight.size + RUN_UNKNOWNS))
    answer = disturbance_jacobian(run, targets)
    assert answer[0, 0, 0, -RUN_UNKNOWNS:].sum() == 1.0


def test_a_tilted_picture_is_that_of_a_camera_that_looks_askew():
    arm = paper_arm()
    points = made(arm, np.linspace(2e3, 50e3, 9), np.full((9, 2), 0.05)).points
    distance, angle = 9.0 * arm.length, math.radians(2.5)
    # The plane turns about the line x = l / 2 and comes nearer beyond it.
    nearer = (points[:, 0] - 0.5 * arm.length) * math.sin(angle)
    seen = points * (distance / (distance - nearer))[:, None]
    moved = (seen - points).reshape(9, -1)
    size = math.sin(angle) * arm.length / distance
    assert size == pytest.approx(LINEARIZATION.tilt, rel=0.05)
    found = tilt_jacobian(points, arm.length)[:, :, 0] * size
    assert found == pytest.approx(moved, abs=0.01 * np.abs(moved).max())
