"""The reports in a real browser: nothing on the console, no request, nothing beyond the page."""

from __future__ import annotations

from pneunet_ros.reports.calibration.report import write_report
from pneunet_ros.reports.diagnosis.files import PAGE, write_diagnosis
import pytest
from support.example_arms import paper_arm
from support.html_pages import browser, opened, widest
from support.small_calibration import calibration
from support.small_diagnosis import diagnosis, PROVENANCE

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(browser() is None, reason='no Chromium here: apt-get install chromium'),
]
LEAVING = """<!DOCTYPE html><html><body><img src="http://127.0.0.1:9/a.png">
<script>console.error('wrong')</script></body></html>"""


def test_a_page_that_leaves_is_found(tmp_path):
    (tmp_path / 'page.html').write_text(LEAVING)
    console, asked = opened(tmp_path / 'page.html', tmp_path)
    assert asked == ['http://127.0.0.1:9/a.png']
    assert any('wrong' in line for line in console)


@pytest.fixture(scope='module')
def calibration_page(tmp_path_factory):
    folder = tmp_path_factory.mktemp('calibration')
    return write_report(calibration(), folder / 'out', provenance={'seed': 1})


@pytest.fixture(scope='module')
def diagnosis_page(tmp_path_factory):
    folder = tmp_path_factory.mktemp('diagnosis') / 'out'
    found, training, held_out = diagnosis()
    write_diagnosis(
        found,
        folder,
        frame=paper_arm(),
        training=training,
        held_out=held_out,
        provenance=PROVENANCE,
    )
    return folder / PAGE


@pytest.fixture(params=['calibration_page', 'diagnosis_page'])
def page(request):
    return request.getfixturevalue(request.param)


def test_a_report_asks_for_nothing_and_says_nothing_on_the_console(page, tmp_path):
    assert opened(page, tmp_path) == ([], [])


@pytest.mark.parametrize(('width', 'dark'), [(390, False), (390, True), (1280, False)])
def test_a_report_fits_a_phone_and_a_screen(page, tmp_path, width, dark):
    assert widest(page, tmp_path, width, dark=dark) == (width, [])


def test_what_sticks_out_is_found(tmp_path):
    file = tmp_path / 'page.html'
    file.write_text('<html><head></head><body><p style="width: 700px">wide</p></body></html>')
    width, beyond = widest(file, tmp_path, 390)
    assert width > 700
    assert any(item.startswith('P') for item in beyond)
