"""Sphinx builds these pages as a site: `make docs`, or rosdoc2 (rosdoc2.yaml).

The pages are plain Markdown that a forge shows as well. What only the site has is written into
`docs/generated/` and `docs/index.md` before Sphinx reads (see site_pages.py); git ignores both.
"""

from importlib.util import find_spec
import os
from pathlib import Path
import sys

# The pages describe the code: nothing is to be solved, so nothing to be compiled.
os.environ['PNEUNET_NO_NUMBA'] = '1'

from pneunet_ros import __version__
from sphinx.ext.autodoc.mock import mock

project = 'pneunet_ros'
author = 'the contributors of pneunet_ros'
release = version = __version__

OF_RECORDINGS = 'rosbags', 'mcap', 'mcap_ros2'

extensions = ['myst_parser', 'sphinx.ext.autodoc', 'sphinx.ext.napoleon']
exclude_patterns = ['README.md', 'build']
source_suffix = {'.md': 'markdown', '.rst': 'restructuredtext'}
html_theme = 'furo'  # rosdoc2 puts its own here
html_title = f'pneunet_ros {release}'
html_copy_source = html_show_copyright = False

myst_heading_anchors = 4  # links such as model.md#domain, as a forge has them
autodoc_member_order = 'bysource'
autodoc_preserve_defaults = True  # as written: settings hold hundreds of numbers
autodoc_typehints = 'none'  # the text of Args says what an argument is, with unit and shape
napoleon_numpy_docstring = False


def setup(app):
    """Write the pages that only the site has, and turn links that lead out of this folder."""
    # Under rosdoc2 this file is run from another folder: `__file__` would lead astray.
    sys.path.insert(0, str(app.srcdir))
    from site_pages import with_links_of_the_site, write_site_pages

    def turn_links(app, name, source):
        if name != 'index' and not name.startswith('generated/'):
            source[0] = with_links_of_the_site(source[0], f'docs/{name}.md', 'docs')

    def write_pages(app):
        # Where a site is built without the libraries that read recordings, as on a build farm.
        with mock([name for name in OF_RECORDINGS if find_spec(name) is None]):
            write_site_pages(Path(app.srcdir))

    def add_style(app, config):
        config.html_static_path.append(str(Path(app.srcdir) / '_static'))

    app.connect('config-inited', add_style)
    app.add_css_file('site.css')
    app.connect('builder-inited', write_pages)
    app.connect('source-read', turn_links)
