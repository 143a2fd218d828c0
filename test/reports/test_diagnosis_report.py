"""The report and the files of a diagnosis: whole, by the contract, and closed in itself."""

from __future__ import annotations

from dataclasses import replace
import json
import math
import re

import numpy as np
from pneunet_ros import load_model, solve
from pneunet_ros.diagnosis.result import Estimated
from pneunet_ros.diagnosis.settings import LACK_OF_FIT
from pneunet_ros.discovery.result import NOTHING_SEARCHED
from pneunet_ros.reports import figure as report_figure
from pneunet_ros.reports.diagnosis.discovery_figures import amplitude
from pneunet_ros.reports.diagnosis.error_figures import errors_along_arm, model_error, worst_frames
from pneunet_ros.reports.diagnosis.figure_data import FigureData
from pneunet_ros.reports.diagnosis.figures import FIGURES
from pneunet_ros.reports.diagnosis.files import (
    diagnosis_content,
    MODEL,
    NUMBERS,
    PAGE,
    write_diagnosis,
)
from pneunet_ros.reports.diagnosis.first_screen import (
    error_sentence,
    evidence_bars,
    missing_sentence,
)
from pneunet_ros.reports.diagnosis.localization_figures import borders, misfit_maps, shares
from pneunet_ros.reports.diagnosis.loop_figures import directions_of, moment_loops
from pneunet_ros.reports.diagnosis.report import Given, report_page
from pneunet_ros.reports.diagnosis.tables import (
    adequacy_table,
    detectable_table,
    error_table,
    evidence_table,
    MOST_SHIFTS,
    p_value_text,
    shift_table,
    sigmas,
    with_error,
)
from pneunet_ros.reports.figure import draw_figures
import pytest
from support.example_arms import paper_arm
from support.html_pages import check_closed, Page
from support.small_diagnosis import diagnosis, discovery, EFFECT, PROVENANCE

CONTRACT = {
    'answer', 'effects', 'alternatives', 'where', 'gap', 'adequacy', 'detectable',
    'parameter_shift', 'inputs', 'seed', 'versions',
}  # fmt: skip


@pytest.fixture(scope='module')
def coarse():
    """Draw coarsely: what is looked at here is not how sharp it is."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(report_figure, 'DOTS_PER_INCH', 30)
        yield


@pytest.fixture(scope='module')
def written(coarse, tmp_path_factory):
    """Write all files of a diagnosis, and collect what is said meanwhile."""
    told = []
    folder = tmp_path_factory.mktemp('diagnosis') / 'out'
    found, training, held_out = diagnosis()
    write_diagnosis(
        found,
        folder,
        frame=paper_arm(),
        training=training,
        held_out=held_out,
        provenance=PROVENANCE,
        discovery=discovery(found),
        on_progress=lambda stage, done, total: told.append((stage, done, total)),
    )
    return folder, told


@pytest.fixture(scope='module')
def page(written):
    return (written[0] / PAGE).read_text(encoding='utf-8')


def test_nothing_leaves_the_page(page):
    check_closed(page)


def test_all_files_are_there(written, page):
    folder, told = written
    pictures = sorted(item.name for item in folder.glob('figure_*.png'))
    assert len(pictures) == sum(map(len, FIGURES.values()))
    assert sorted(item.name for item in folder.iterdir()) == sorted(
        [*pictures, MODEL, NUMBERS, PAGE, 'model_discovered.yaml', 'effects']
    )
    assert page.count('data:image/svg+xml;base64,') == len(pictures)
    assert told[-1] == ('pictures', len(pictures), len(pictures))


def test_the_answer_comes_first(page):
    sentence = page.index('The model lacks extensibility: &lt;it&gt;')
    assert sentence < page.index('<h2') < page.index('<img')
    parts = [f'id="{part}"' for part in (*FIGURES, 'detection', 'notes')]
    places = [page.index(part) for part in parts]
    assert places == sorted(places)


def test_the_first_screen_goes_from_missing_to_causes_to_the_gap(page):
    first = page[: page.index('<h2')]
    order = ['Is anything missing?', '900', 'Evidence for each cause', '1180']
    order += ['On held-out recordings', 'How sure']
    places = [first.index(text) for text in order]
    assert places == sorted(places)
    assert re.findall('class="bar" style="width: (\\d+)%"', first) == ['100', '10', '8']


def test_causes_with_evidence_are_bars_and_laws_are_among_them():
    found, *_ = diagnosis()
    bars = evidence_bars(found, discovery(found))
    assert [bar.name for bar in bars] == ['extensibility', 'a law: push', 'gravity']
    assert evidence_bars(replace(found, evidence=()), NOTHING_SEARCHED) == ()


def test_a_table_and_its_note_never_contradict_each_other():
    """What a law may miss is more than noise: no `yes` stands beside a p-value of zero."""
    found, *_ = diagnosis()
    level = LACK_OF_FIT.level
    for p_value in (0.0, 0.5 * level, 2.0 * level, 0.6):
        passes = p_value > level
        first = replace(found.evidence[0], adequate=True, p_value=p_value)
        test = replace(found.adequacy_after, statistic=41.0 if passes else 90.0, p_value=p_value)
        item = replace(found, evidence=(first,), adequacy_after=test)
        cells = evidence_table(item).rows[0][3], adequacy_table(item).rows[-1][-1]
        assert [cell.startswith('yes') for cell in cells] == [passes, passes], (p_value, cells)
    assert adequacy_table(replace(found, effects=())).rows[0][-1] == 'no'


def test_rms_does_not_lead_where_it_cannot_show_what_is_missing():
    found, *_ = diagnosis()
    assert 'held-out' in error_sentence(found)

    def with_rms(side, rms, chi_squared):
        return replace(side, held_out=replace(side.held_out, rms=rms, chi_squared=chi_squared))

    floor, scatter = found.noise_floor, found.noise_floor_std
    before = with_rms(found.before, floor + 0.3 * scatter, 1.046)
    after = with_rms(found.after, floor, 1.041)
    hardly = replace(found, before=before, after=after)
    said = error_sentence(hardly)
    assert said.index('1.046') < said.index('1.041') < said.index('mm rms')
    unknown = replace(found, answer='unknown', effects=(), before=before, after=before)
    assert error_sentence(unknown).index('1.046') < error_sentence(unknown).index('mm rms')
    assert '1.046' not in error_sentence(replace(unknown, answer='none'))


def test_whether_something_is_missing_is_said_against_noise_alone():
    found, *_ = diagnosis()
    assert missing_sentence(replace(found, answer='named')).startswith('Yes: ')
    assert missing_sentence(replace(found, answer='unknown')).startswith('Yes, unless the noise ')
    clean = replace(found, adequacy_before=found.adequacy_after)
    assert missing_sentence(clean).startswith('Yes, ')
    assert not missing_sentence(replace(clean, answer='none')).startswith('Yes')
    # What an uneven arm explains as well has evidence all the same.
    assert missing_sentence(replace(clean, answer='unobservable')).startswith('Yes, ')
    without = replace(clean, answer='unobservable', evidence=())
    assert not missing_sentence(without).startswith('Yes')


def test_before_and_after_are_the_same_test():
    found, *_ = diagnosis()
    other = replace(found.adequacy_after, test='held out: windows of time', p_value=0.01)
    rows = adequacy_table(replace(found, adequacy_after=other)).rows
    assert [row[:2] for row in rows] == [
        ('before', 'training: smooth fields'),
        ('after', 'training: smooth fields'),
        ('after, worst', 'held out: windows of time'),
    ]
    assert len(adequacy_table(found).rows) == 2


def test_every_fact_of_the_first_screen_stands_there_once(page):
    first = page[page.index('<table class="facts">') :]
    facts = re.findall('<th scope="row">(.*?)</th>', first[: first.index('</table>')])
    assert len(set(facts)) == len(facts) == 5


def test_what_is_known_stands_on_the_page(page):
    for text in (
        'removed 97 % of the reducible error',
        'Record force sweeps at two pressures.', 'that says &lt;what&gt;',
        'axial_stiffness', '15.00 ± 0.30 N', 'below 410 N', 'pressure_elongation', 'a' * 64,
        'not with &lt;pressure&gt;', 'Not detectable at any usual size: creep.',
        'alpha2 at', 'kappa_p0 at', 'not fitted', 'Where: The misfit grows',
    ):  # fmt: skip
        assert text in page, text


def test_the_numbers_are_those_of_the_contract(written):
    content = json.loads((written[0] / NUMBERS).read_text(encoding='utf-8'))
    found, *_ = diagnosis()
    assert set(content) >= CONTRACT
    assert content['answer'] == 'named'
    (effect,) = content['effects']
    assert set(effect) == {'name', 'parameters', 'probability'}
    assert effect['parameters']['axial_stiffness'] == {'value': 15.0, 'std': 0.3, 'unit': 'N'}
    assert set(content['where'][0]) >= {'axis', 'from', 'to', 'share', 'sentence'}
    gap = content['gap']
    assert set(gap) >= {'training', 'heldout', 'noise_floor_m', 'closed'}
    assert gap['closed_discovered'] == 0.97
    for group in ('training', 'heldout'):
        assert set(gap[group]) == {'before', 'after', 'discovered'}
        assert set(gap[group]['before']) == {'rms_m', 'p95_m', 'chi2_per_dof'}
    assert gap['heldout']['before']['rms_m'] == found.before.held_out.rms
    assert set(content['adequacy']['after']) == {'test', 'statistic', 'threshold', 'p_value'}
    assert set(content['detectable']['gravity']) >= {'observable', 'smallest', 'unit'}
    assert content['detectable']['creep']['smallest'] is None  # JSON has no infinity
    assert set(content['parameter_shift']['moment_law.rigidity.0.1']) >= {'before', 'after', 'std'}
    assert content['inputs'] == PROVENANCE['inputs']
    assert (content['seed'], content['versions']) == (7, PROVENANCE['versions'])
    assert content['settings']['used']['LackOfFitSettings.level'] == 0.002
    assert content['settings']['not_default'] == {}


def test_a_discovered_law_stands_in_all_files(written, page):
    folder, found = written[0], diagnosis()[0]
    (law,) = json.loads((folder / NUMBERS).read_text(encoding='utf-8'))['discovered']
    assert set(law) == {
        'kind', 'location', 'size', 'covariates', 'time_law', 'share', 'left_out_gain',
        'tied_with', 'sentence', 'effect_file',
    }  # fmt: skip
    assert law['location'] == {'value': 0.62, 'std': 0.01, 'unit': '-'}
    assert (folder / law['effect_file']).read_text(encoding='utf-8') == '# an effect\n'
    assert page.count('&lt;pushes&gt;') == 2
    assert '--effects-path DIR/effects' in page
    assert load_model(folder / 'model_discovered.yaml').effects == found.after.arm.effects
    nothing = diagnosis_content(found, PROVENANCE)
    assert nothing['discovered'] == []
    assert set(nothing['gap']['heldout']) == {'before', 'after'}
    assert nothing['gap']['closed_discovered'] is None


def test_settings_that_are_not_the_default_are_said():
    found, *_ = diagnosis()
    changed = replace(found.settings, withheld=('creep',))
    content = diagnosis_content(replace(found, settings=changed), PROVENANCE)
    assert content['settings']['not_default'] == {'DiagnosisSettings.withheld': ['creep']}


def test_the_model_has_what_was_missing(written):
    found, *_ = diagnosis()
    arm = load_model(written[0] / MODEL)
    assert arm.name == 'paper-arm+extensibility'
    (effect,) = arm.effects
    assert effect == EFFECT
    assert arm.sources['effects.extensibility.axial_stiffness'] == 'diagnosed'
    assert 'extensibility' in arm.sources['intrinsic_curvature']
    assert arm.covariance is not None
    assert [dict(item) for item in arm.provenance['inputs']] == PROVENANCE['inputs']
    low, high = arm.provenance['valid']['pressure']
    assert -500.0 < low < 1e3
    assert 57e3 < high < 60.5e3
    for name in ('rigidity', 'split'):
        fitted = getattr(found.after.arm.moment_law, name)
        assert np.array_equal(getattr(arm.moment_law, name), fitted)
    assert solve(arm, 30e3, (0.1, 0.05)).stable


def test_without_held_out_recordings_it_is_said(coarse):
    found, training, _ = diagnosis()
    before, after = (
        replace(side, held_out=None, held_out_scores=()) for side in (found.before, found.after)
    )
    found = replace(found, before=before, after=after, closed=None)
    assert diagnosis_content(found, PROVENANCE)['gap']['heldout'] is None
    data = FigureData(diagnosis=found, training=training, held_out=())
    drawn = [errors_along_arm(data), model_error(data)]
    assert None not in drawn
    pictures = dict.fromkeys(FIGURES, ()) | {'error': drawn}
    report_page(found, pictures, PROVENANCE)
    assert 'held-out' not in error_sentence(found)
    assert 'training' in error_sentence(found)


def test_when_nothing_is_missing_there_is_less_to_show(coarse, monkeypatch):
    found, training, held_out = diagnosis()
    monkeypatch.setitem(FIGURES, 'where', (misfit_maps, shares))
    nothing = replace(
        found, answer='none', effects=(), alternatives=(), after=found.before, evidence=(),
        heat_maps=(), cosines={}, shift={}, closed=None, proposal='', notes=(),
    )  # fmt: skip
    data = FigureData(diagnosis=nothing, training=training, held_out=held_out)
    pictures = draw_figures(FIGURES, data, lambda *_: None)
    names = [item.name for of_part in pictures.values() for item in of_part]
    assert names == ['01_errors', '02_model_error', '05_shares']
    text = report_page(nothing, pictures, PROVENANCE)
    assert 'model_discovered' not in text
    assert Page(text).tags.count('img') == 3


def test_commands_have_the_names_that_were_given():
    found, *_ = diagnosis()
    pictures: dict = dict.fromkeys(FIGURES, ())
    given = Given(model='my arm.yaml', folder='found', notes=('a.mcap: no load',))
    text = report_page(found, pictures, PROVENANCE, given=given)
    assert '--model &#39;my arm.yaml&#39;' in text
    assert f'<li>{given.notes[0]}</li>' in text
    certain = replace(found, answer='named', proposal='')
    text = report_page(certain, pictures, PROVENANCE, given=given)
    assert '--model found/model.yaml' in text
    law = report_page(found, pictures, PROVENANCE, discovery=discovery(found), given=given)
    assert law.count('--effects-path found/effects') == 2


def test_the_worst_frames_are_where_the_model_is_furthest_off():
    found, training, held_out = diagnosis()
    items = FigureData(diagnosis=found, training=training, held_out=held_out).errors()
    frames = worst_frames(items)
    assert len(frames) == 4
    worst = max(items, key=lambda item: item.misfit.max())
    assert frames[0] == (worst, int(np.argmax(worst.misfit)))
    assert {item.run.name for item, _ in frames} == {run.name for run in held_out}
    assert len({(item.run.name, frame) for item, frame in frames}) == 4


def test_a_single_target_and_frames_without_a_shape_are_drawn(coarse):
    """Tip only: maps of one column, a point for a shape; a model that solves nothing."""
    found, _, held_out = diagnosis()

    def tip(side):
        scores = tuple(replace(item, error=item.error[:, :, -1:]) for item in side.held_out_scores)
        last = side.arm.target_arclength[-1:]
        arm = replace(side.arm, target_arclength=last, covariance=None)
        return replace(side, arm=arm, held_out_scores=scores)

    runs = [replace(run, x=run.x[:, -1:], y=run.y[:, -1:]) for run in held_out]
    some = tuple(
        replace(item, arclength=item.arclength[-1:], before=item.before[:, -1:],
                after=item.after[:, -1:])
        for item in found.heat_maps
    )  # fmt: skip
    alone = replace(found, before=tip(found.before), after=tip(found.after), heat_maps=some)
    data = FigureData(diagnosis=alone, training=(), held_out=runs)
    assert errors_along_arm(data) is not None
    assert misfit_maps(data).png
    assert moment_loops(data) is None
    empty = tuple(
        replace(item, error=np.full_like(item.error, np.nan), rms=math.nan)
        for item in found.before.held_out_scores
    )
    lost = replace(found, before=replace(found.before, held_out_scores=empty))
    data = FigureData(diagnosis=lost, training=(), held_out=held_out)
    assert errors_along_arm(data) is None
    assert model_error(data).png


def test_errors_on_a_rigid_cap_are_in_the_picture(coarse):
    found, training, held_out = diagnosis()
    length = found.before.arm.length
    arm = replace(found.before.arm, length=0.9 * length, tip_cap=0.1 * length)
    found = replace(found, before=replace(found.before, arm=arm))
    picture = errors_along_arm(FigureData(diagnosis=found, training=training, held_out=held_out))
    assert picture.figure.axes[1].get_xlim()[1] > arm.target_arclength[-1] / arm.length > 1.05


def test_noise_alone_is_that_of_the_recordings_on_which_models_are_compared(coarse):
    found, training, held_out = diagnosis()
    (before, after) = (replace(side, held_out=None, held_out_scores=())
                       for side in (found.before, found.after))  # fmt: skip
    alone = replace(found, before=before, after=after, closed=None)
    for one, group, ends in ((found, 'held out', [0.5, 1.5]), (alone, 'training', [-0.5, 0.5])):
        assert error_table(one).rows[-1][:2] == (group, 'noise alone')
        overall = model_error(FigureData(diagnosis=one, training=training, held_out=held_out))
        axes = overall.figure.axes[0]
        (line,) = axes.lines
        assert line.get_xdata().tolist() == ends
        assert line.get_ydata().tolist() == [1e3 * one.noise_floor] * 2
        names = [text.get_text() for text in axes.get_xticklabels()]
        assert names[round(sum(ends) / 2)] == group


def test_a_picture_that_leaves_recordings_out_says_so(coarse):
    found, training, held_out = diagnosis()

    def with_many(side):
        many = 6 * side.held_out_scores
        scores = tuple(
            replace(score, name=f'recording_{place}', rms=score.rms + 1e-3 * (place > 7))
            for place, score in enumerate(many)
        )
        return replace(side, held_out_scores=scores)

    law = discovery(found)
    many = replace(found, before=with_many(found.before), after=with_many(found.after))
    data = FigureData(
        diagnosis=many,
        training=training,
        held_out=held_out,
        discovery=replace(law, evaluation=None, amplitudes=9 * law.amplitudes[:1]),
    )
    axes = model_error(data).figure.axes[1]
    assert axes.get_title().startswith('(b) the 8 worst of 12 ')
    names = [text.get_text() for text in axes.get_xticklabels()]
    assert {f'recording_{place}' for place in (8, 9, 10, 11)} < set(names)
    assert 'first 6 of 9 ' in amplitude(data).caption


def test_what_moved_most_stands_first():
    found, *_ = diagnosis()
    moved = [float(row[5]) for row in shift_table(found).rows]
    assert len(moved) == min(MOST_SHIFTS, len(found.shift))
    assert moved == sorted(moved, reverse=True)
    assert moved[0] == pytest.approx(max(map(sigmas, found.shift.values())), abs=0.1)


def test_a_stiffness_is_seen_below_and_a_load_from_a_size_on():
    rows = {row[0]: row for row in detectable_table(diagnosis()[0]).rows}
    assert rows['extensibility'][3] == 'below 410 N'
    assert rows['gravity'][3] == 'from 0.05 N/m'
    assert rows['creep'][3] == 'none'


@pytest.mark.parametrize(
    ('value', 'std', 'unit', 'text'),
    [
        (15.0, 0.3, 'N', '15.00 ± 0.30 N'),
        (6123.4, 120.0, 'Pa', '6120 ± 120 Pa'),
        (0.0512, 0.0013, '-', '0.0512 ± 0.0013'),
        (1.00964, 0.00073, '-', '1.00964 ± 0.00073'),
        (4.123e-6, 2.1e-8, '1/Pa', '(4.123 ± 0.021)e-6 1/Pa'),
        (3.0, math.nan, 'N', '3 N'),
        (math.inf, 1.0, 'N', 'inf N'),
    ],
)
def test_numbers_stand_with_their_errors(value, std, unit, text):
    assert with_error(Estimated(value=value, std=std, unit=unit)) == text


def test_a_direction_is_kept_through_holds_and_noise():
    pressure = np.array([0.0, 5.0, 10.0, 9.5, 10.5, 10.2, 6.0, 6.1, 2.0, 2.2])
    expected = [0, 1, 1, 1, 1, 1, -1, -1, -1, -1]
    assert directions_of(pressure, 1.0).tolist() == expected
    assert directions_of(np.array([3.0, 3.1, 2.9]), 1.0).tolist() == [0, 0, 0]


def test_a_p_value_near_zero_is_only_called_smaller():
    assert [p_value_text(value) for value in (0.034, 1e-6, 1e-9, 0.0)] == [
        '0.034', '1e-06', '< 1e-06', '< 1e-06',
    ]  # fmt: skip


def test_cells_around_targets_on_a_cap_have_rising_borders():
    assert np.all(np.diff(borders(np.array([0.0, 0.5, 1.0, 1.1, 1.2]))) > 0.0)
