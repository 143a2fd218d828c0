"""A path that leads nowhere is a sentence, in every verb that follows it."""

from __future__ import annotations

from pathlib import Path

from pneunet_ros.cli.main import main
from pneunet_ros.core.errors import RecordingError, RequestError
from pneunet_ros.core.paths import resolve_links
import pytest
from support.refusals import refused

VERBS = {
    'check': ('loop',),
    'compare': ('loop', 'loop'),
    'calibrate': ('--unloaded', 'loop', '--output', 'o.yaml'),
    'diagnose': ('--model', 'loop', '--train', 'loop', '--heldout', 'loop', '--output', 'd'),
    'survey': ('loop', '--output', 's'),
    'replay': ('loop',),
    'track': ('loop',),
    'import': ('loop', '--output', 'o.mcap'),
    'effects': ('--effects-path', 'loop'),
}


@pytest.fixture(autouse=True)
def loop(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path('loop').symlink_to('loop')


def test_a_loop_of_links_raises_the_error_that_was_asked_for():
    Path('there').symlink_to('back')
    Path('back').symlink_to('there')
    for name in ('loop', 'there'):
        try:  # Python 3.13 follows a loop until it is back
            found = resolve_links(name, RecordingError)
        except RecordingError as error:
            assert name in str(error)
        else:
            assert found.is_absolute()
    with refused(RequestError, 'not_found'):
        resolve_links('a\0b')


@pytest.mark.parametrize('verb', VERBS)
def test_a_link_that_leads_to_itself_is_a_sentence(verb, capsys):
    assert main([verb, *VERBS[verb]]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1
