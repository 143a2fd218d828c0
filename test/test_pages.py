"""The reports in a real browser: nothing on the console, and no request leaves the page."""

from __future__ import annotations

from pneunet_ros.reports import figure as report_figure
from pneunet_ros.reports.calibration.report import write_report
from pneunet_ros.reports.diagnosis.files import PAGE, write_diagnosis
import pytest
from support.example_arms import paper_arm
from support.html_pages import browser, opened
from support.small_calibration import calibration
from support.small_diagnosis import diagnosis, PROVENANCE

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(browser() is None, reason='no Chromium here: apt-get install chromium'),
]
LEAVING = """<!DOCTYPE html><html><body><img src="http://127.0.0.1:9/a.png">
<script>console.error('wrong')</script></body></html>"""


@pytest.fixture
def coarse(monkeypatch):
    """Draw coarsely: what is looked at here is not how sharp it is."""
    monkeypatch.setattr(report_figure, 'DOTS_PER_INCH', 30)


def test_a_page_that_leaves_is_found(tmp_path):
    (tmp_path / 'page.html').write_text(LEAVING)
    console, asked = opened(tmp_path / 'page.html', tmp_path)
    assert asked == ['http://127.0.0.1:9/a.png']
    assert any('wrong' in line for line in console)


def test_the_report_of_a_calibration(coarse, tmp_path):
    page = write_report(calibration(), tmp_path / 'out', provenance={'seed': 1})
    assert opened(page, tmp_path) == ([], [])


def test_the_report_of_a_diagnosis(coarse, tmp_path):
    found, training, held_out = diagnosis()
    write_diagnosis(
        found,
        tmp_path / 'out',
        frame=paper_arm(),
        training=training,
        held_out=held_out,
        provenance=PROVENANCE,
    )
    assert opened(tmp_path / 'out' / PAGE, tmp_path) == ([], [])
