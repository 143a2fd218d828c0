"""A report as one self-contained HTML page, from a template of this package."""

from __future__ import annotations

from typing import Any

import jinja2
from pneunet_ros.core.printable import printable


def render_page(template: str, **content: Any) -> str:
    """Return the page; its content is escaped as text."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader('pneunet_ros.reports'),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return printable(environment.get_template(template).render(**content))
