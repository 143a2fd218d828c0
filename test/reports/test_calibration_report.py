"""The report: whole, in the paper's order, and nothing on the page leaves the page."""

from __future__ import annotations

from dataclasses import replace
import re

import numpy as np
from pneunet_ros.calibration.checks.held_out import Score
from pneunet_ros.calibration.experiments import LawScore
from pneunet_ros.calibration.tip_force import EndForces
from pneunet_ros.core.errors import RecordingError
from pneunet_ros.reports import figure as report_figure
from pneunet_ros.reports.calibration import report as calibration_report
from pneunet_ros.reports.calibration.figure_data import figure_data
from pneunet_ros.reports.calibration.figures import calibration_figures
from pneunet_ros.reports.calibration.force_figures import EstimatedForces, sentences
from pneunet_ros.reports.calibration.moment_figures import one_moment
from pneunet_ros.reports.calibration.report import write_report
from pneunet_ros.reports.calibration.residual_figures import (
    best_sentence,
    draw_residuals_by_target,
)
from pneunet_ros.reports.calibration.tables import flat, law_rows, number_rows
from pneunet_ros.reports.calibration.trend_figures import sensitivity
import pytest
from support.html_pages import check_closed, Page
from support.refusals import refused
from support.small_calibration import calibration

PROVENANCE = {
    'seed': 4,
    'recordings': [{'file': 'bags/<ramp>.mcap', 'sha256': 'a' * 64, 'role': 'unloaded'}],
    'versions': {'numpy': np.__version__},
}
NUMBERS = ['5', '6 and 9 (a), (b)', '7', '8 (a)', '8 (b)', '9 (c)', '10', '11']


def no_news(stage: str, done: int, total: int) -> None:
    """Take no notice of progress."""


@pytest.fixture(scope='module')
def coarse():
    """Draw coarsely: what is looked at here is not how sharp it is."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(report_figure, 'DOTS_PER_INCH', 30)
        yield


@pytest.fixture(scope='module')
def report(coarse, tmp_path_factory):
    """Write a whole report, and collect what is said meanwhile."""
    told = []
    path = write_report(
        calibration(),
        tmp_path_factory.mktemp('report') / 'out',
        provenance=PROVENANCE,
        on_progress=lambda stage, done, total: told.append((stage, done, total)),
    )
    return path, path.read_text(encoding='utf-8'), told


def test_nothing_leaves_the_page(report):
    check_closed(report[1])


def test_a_reference_that_leaves_would_be_found():
    assert Page('<img src="https://x.invalid/a.png">').references == ['https://x.invalid/a.png']


def test_pictures_are_in_the_page_and_beside_it(report):
    path, text, _ = report
    files = sorted(path.parent.glob('figure_*.png'))
    assert len(files) == 11
    assert text.count('data:image/svg+xml;base64,') == len(files)
    assert sorted(item.name for item in path.parent.iterdir()) == sorted(
        [item.name for item in files] + ['index.html']
    )
    assert all(item.read_bytes().startswith(b'\x89PNG') for item in files)


def test_figures_come_in_the_paper_s_order(report):
    _, text, _ = report
    places = [text.index(f'Figure {number}. ') for number in NUMBERS]
    assert places == sorted(places)
    assert text.index('Residuals over frames') > places[-1]


def test_notes_provenance_and_names_are_text(report):
    _, text, _ = report
    assert '&lt;what&gt;' in text
    assert 'bags/&lt;ramp&gt;.mcap' in text
    assert 'a' * 64 in text
    assert 'drift_std' in text


def test_numbers_stand_with_their_errors(report):
    _, text, _ = report
    rows = number_rows(calibration())
    parameters = calibration().joint.parameters
    assert len(rows) == parameters.cells + len(law_rows(rows))
    assert len(law_rows(rows)) == 3 * calibration().arm.moment_law.pressure.size
    for row in law_rows(rows):
        assert row.name in text
        assert f'{row.value:.4g}' in text
        assert 0.0 < row.std < row.prior_std
    assert 'alpha1 at' in text
    (first, *_) = law_rows(rows)
    arm = calibration().arm
    stiffness = first.value * arm.weight * arm.length**2
    assert first.bending_stiffness.startswith(f'{stiffness:.4g} ± ')
    assert first.bending_stiffness in text


def test_a_number_that_stays_open_is_marked():
    row = number_rows(calibration())[0]
    assert row.determined
    assert not replace(row, std=0.6 * row.prior_std).determined


def test_progress_is_told_to_the_end(report):
    _, _, told = report
    assert told[-1] == ('pictures', 11, 11)
    assert len({stage for stage, _, _ in told}) == 3
    assert all(done <= total for _, done, total in told)


def test_without_load_only_what_needs_none_is_drawn(coarse):
    drawn = calibration_figures(calibration(with_load=False), no_news)
    assert [item.name for item in drawn['paper']] == ['05_unloaded', '11_linearity']
    assert [item.name[3:] for item in drawn['residuals']] == [
        'residuals_over_frames', 'residuals_over_targets',
    ]  # fmt: skip


def test_a_section_in_which_no_target_was_seen_is_not_drawn(coarse):
    data = figure_data(calibration(), no_news)
    beyond = data.main_views[0].arclength > 0.2 * data.calibration.arm.length
    cut = {name: getattr(data.main_views[0], name)[beyond]
           for name in ('arclength', 'moment', 'curvature', 'intrinsic', 'std')}  # fmt: skip
    view = replace(data.main_views[0], lines=(None, data.main_views[0].lines[1]), **cut)
    picture = one_moment(replace(data, main_views=(view,)))
    labels = [text.get_text() for text in picture.figure.axes[0].get_legend().get_texts()]
    assert labels and all(label.endswith('s > l1') for label in labels)


def test_targets_on_a_rigid_cap_are_in_the_pictures(coarse):
    found = calibration()
    arm = replace(found.arm, length=0.9 * found.arm.length, tip_cap=0.1 * found.arm.length)
    data = replace(figure_data(found, no_news), calibration=replace(found, arm=arm))
    share = arm.target_arclength[-1] / arm.length
    assert share > 1.05
    left = draw_residuals_by_target(data).figure.axes[0]
    right = sensitivity(data).figure.axes[-1]
    assert left.get_xlim()[1] > share
    assert right.lines[0].get_xdata()[-1] == pytest.approx(arm.reach / arm.length)
    assert right.get_xlim()[1] == pytest.approx(arm.reach / arm.length)


@pytest.mark.slow
def test_without_load_there_is_no_moment_law(coarse, tmp_path):
    path = write_report(calibration(with_load=False), tmp_path / 'free', provenance={})
    text = path.read_text(encoding='utf-8')
    assert 'Figure 5. ' in text
    assert 'Figure 7. ' not in text
    assert 'moment_law' not in text


def test_an_earlier_report_is_replaced_only_when_asked(monkeypatch, tmp_path):
    monkeypatch.setattr(
        calibration_report, 'calibration_figures', lambda *_: {'paper': (), 'residuals': ()}
    )
    write_report(calibration(), tmp_path / 'out', provenance={'seed': 1})
    with refused(RecordingError, 'exists'):
        write_report(calibration(), tmp_path / 'out', provenance={'seed': 2})
    path = write_report(calibration(), tmp_path / 'out', provenance={'seed': 3}, overwrite=True)
    assert '>seed</th><td><code>3</code>' in path.read_text(encoding='utf-8')
    (tmp_path / 'out' / 'notes.txt').write_text('mine')
    with refused(RecordingError, 'holds_other_files'):
        write_report(calibration(), tmp_path / 'out', provenance={}, overwrite=True)


def test_nothing_is_left_of_a_report_that_fails(monkeypatch, tmp_path):
    def failing(found, on_progress):
        raise RecordingError('no picture', reason='failed')

    monkeypatch.setattr(calibration_report, 'calibration_figures', failing)
    with refused(RecordingError, 'failed'):
        write_report(calibration(), tmp_path / 'out', provenance={})
    assert list(tmp_path.iterdir()) == []


def test_nested_provenance_is_flattened():
    assert flat(PROVENANCE)[1] == ('recordings.1.file', 'bags/<ramp>.mcap')
    assert flat({}) == []


def test_intervals_that_miss_the_force_are_counted():
    read = np.zeros((4, 2))
    force = np.array([[0.0, 0.0], [0.1, 0.0], [0.0, 0.0], [np.nan, np.nan]])
    way = EndForces(force=force, covariance=np.broadcast_to(1e-6 * np.eye(2), (4, 2, 2)))
    none = EndForces(force=np.full((4, 2), np.nan), covariance=way.covariance)
    found = EstimatedForces(pressure=np.zeros(4), read=read, read_std=1e-3, ways=(way, none))
    first, second = sentences(found)
    assert '3 of 4 ' in first
    assert '67 % and 100 %' in first
    assert ' 4 ' in second


def test_tables_have_captions_and_heads_and_long_ones_are_folded(report):
    text = report[1]
    long = re.findall(r'<table>.*?</table>', text, re.DOTALL)
    assert len(long) >= 3
    assert all('<caption>' in table and '<thead>' in table for table in long)
    assert '<summary>' in text
    assert text.count('<main>') == 1
    assert 'class="skip" href="#answer"' in text
    assert 'id="answer"' in text


def test_the_best_law_is_none_that_leaves_frames_out():
    def law(kind, *runs):
        scores = [
            Score(name='run', rms=rms, p95=rms, missing=missing, error=np.zeros((10, 2, 1)))
            for rms, missing in runs
        ]
        return LawScore(kind=kind, scores=tuple(scores))

    laws = (
        law('linear', (2e-3, 0.0), (2e-3, 0.0)),
        law('majidi', (1e-3, 0.0), (np.nan, 1.0)),
        law('piecewise', (1e-3, 0.0), (1e-3, 0.2)),
    )
    assert [item.kind for item in sorted(laws, key=lambda item: item.rank)] == [
        'linear',
        'piecewise',
        'majidi',
    ]
    said = 'linear is best, the next one (piecewise) has no equilibrium in 2 frames more.'
    assert best_sentence(laws) == said
    assert '1.50 times' in best_sentence((laws[0], law('cubic', (3e-3, 0.0))))
