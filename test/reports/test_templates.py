"""The templates of the reports: what all of them have."""

from __future__ import annotations

from importlib.resources import files
import re

import pytest

TEMPLATES = [
    item
    for item in files('pneunet_ros.reports.templates').iterdir()
    if item.name.endswith('.jinja')
]


@pytest.mark.parametrize('template', TEMPLATES, ids=lambda item: item.name)
def test_every_table_has_a_caption(template):
    text = template.read_text(encoding='utf-8')
    assert len(re.findall(r'<table[^>]*>\n<caption>', text)) == text.count('<table')
