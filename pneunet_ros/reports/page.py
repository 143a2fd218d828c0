"""A report as one HTML page that needs nothing else: from a template of this package."""

from __future__ import annotations

from typing import Any

import jinja2
from pneunet_ros.core.printable import printable


def render_page(template: str, **content: Any) -> str:
    """Return the page; what stands in the content is text, whatever it looks like."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader('pneunet_ros.reports'),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return printable(environment.get_template(template).render(**content))
