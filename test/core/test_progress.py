"""How far long work is: a total that was announced is reached and never passed."""

from __future__ import annotations

from pneunet_ros import calibrate, load_model
from pneunet_ros.core.progress import part_of, reporting_to, STEP
from pneunet_ros.core.share import share_path
from pneunet_ros.estimation.settings import EstimatorSettings
from pneunet_ros.recordings.dataset_reader import read_run
from pneunet_ros.recordings.recording import open_recording
import pytest

DAY = share_path('bags/lab_day')


class Heard:
    """All that was said."""

    def __init__(self) -> None:
        self.said: list[tuple[str, int, int]] = []

    def __call__(self, stage: str, done: int, total: int) -> None:
        self.said.append((stage, done, total))


def test_reading_says_how_far_it_is():
    on_progress = Heard()
    recording = open_recording(share_path('bags/table1'))
    names = [topic.name for topic in recording.topics]
    with reporting_to(on_progress):
        count = sum(1 for _ in recording.raw_messages(names))
    assert [done for _, done, _ in on_progress.said] == list(range(STEP, count + 1, STEP))
    assert {total for *_, total in on_progress.said} == {count}
    said = len(on_progress.said)
    list(recording.raw_messages(names))  # nobody listens any more
    assert len(on_progress.said) == said


@pytest.mark.parametrize('loaded', [False, True])
def test_a_calibration_has_its_end_in_sight(loaded):
    arm, on_progress = load_model(share_path('config/paper_arm.yaml')), Heard()
    names = ('unloaded', 'loaded') if loaded else ('unloaded',)
    runs = [
        read_run(DAY / f'{name}.mcap', arm.target_arclength.size, {}, EstimatorSettings())[0].thin(
            40
        )
        for name in names
    ]
    calibrate(runs[:1], runs[1:], arm, on_progress=part_of(on_progress, 1, 2))
    done = [(done, total) for stage, done, total in on_progress.said]
    assert all(stage.startswith('1/2 ') for stage, *_ in on_progress.said)
    assert {total for _, total in done} == {5 if loaded else 2}
    assert done == sorted(done)
    assert all(count <= total for count, total in done)
