"""Numbers with a unit on the command line."""

import json
import math

from pneunet_ros.cli.main import main
from pneunet_ros.cli.quantity_option import parse_quantity
from pneunet_ros.core.errors import RequestError
from pneunet_ros.core.units import SI_PER_UNIT
import pytest
from support.refusals import refused


@pytest.mark.parametrize(
    ('text', 'kind', 'expected'),
    [
        ('31e3', 'pressure', 31e3),
        ('31kPa', 'pressure', 31e3),
        ('31000 Pa', 'pressure', 31e3),
        ('0.31 bar', 'pressure', 31e3),
        ('310mbar', 'pressure', 31e3),
        ('-0.5psi', 'pressure', -0.5 * 0.45359237 * 9.80665 / 0.0254**2),
        ('150 mN', 'force', 0.15),
        ('20inHg', 'pressure', 20 * 3386.388640341),
        ('10 cmH2O', 'pressure', 980.665),
        ('20g', 'force', 0.02 * 9.80665),
        ('1kg', 'force', 9.80665),
        ('0.2mNm', 'moment', 2e-4),
        ('0.2 N mm', 'moment', 2e-4),
        ('0.2 mN m', 'moment', 2e-4),
        ('2e-4 N*m', 'moment', 2e-4),
        ('112mm', 'length', 0.112),
        ('11.2 cm', 'length', 0.112),
        ('1e2mm', 'length', 0.1),
        ('300ms', 'time', 0.3),
        ('180deg', 'angle', math.pi),
    ],
)
def test_a_number_may_carry_its_unit(text, kind, expected):
    """Each is the same in SI, whatever unit it is written in."""
    assert parse_quantity(text, kind) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(
    'text', ['31mm', '31N', 'kPa', '', '31kPa5', '1,5bar', 'inf', 'nan', '1e999']
)
def test_what_is_no_pressure_is_refused_with_what_is_allowed(text):
    """A unit of something else is no pressure."""
    with refused(RequestError, 'not_a_number'):
        parse_quantity(text, 'pressure')


@pytest.mark.parametrize('kind', SI_PER_UNIT)
def test_the_example_of_a_refusal_is_allowed(kind):
    """What a refusal shows as right is right."""
    with pytest.raises(RequestError) as refusal:
        parse_quantity('1 parsec', kind)
    assert parse_quantity(str(refusal.value).rpartition('e.g. ')[2], kind) > 0.0


def predicted(capsys, *words):
    """Return what `predict` prints as JSON for these options."""
    assert main(['predict', *words, '--json']) == 0
    return json.loads(capsys.readouterr().out)


def test_predict_is_the_same_in_every_unit(capsys):
    """The options take units: the same shape."""
    plain = predicted(capsys, '--pressure', '31000', '--force', '0.175', '-0.07')
    with_units = predicted(capsys, '--pressure', '31kPa', '--force', '175mN', '-70mN')
    for name in ('x', 'y', 'moment'):
        assert with_units[name] == pytest.approx(plain[name], rel=1e-12, abs=1e-15)


def test_a_unit_that_stands_apart_is_explained(capsys):
    """`--pressure 31 kPa` is one word too many, and the message says so."""
    with pytest.raises(SystemExit) as stop:
        main(['predict', '--pressure', '31', 'kPa'])
    assert stop.value.code == 2
    assert 'one word, as in 31kPa' in capsys.readouterr().err
