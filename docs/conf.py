# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Sphinx configuration; nothing of the site is fetched from elsewhere, nor is obc_ros imported."""

from importlib import util
import os
from pathlib import Path
import sys
from typing import Any
from xml.etree import ElementTree

# rosdoc2 runs a copy of this folder, and has the package on the path.
ROOT = next(folder for folder in map(Path, (os.path.abspath('..'), *sys.path))
            if (folder / 'package.xml').is_file())
sys.path.insert(0, os.path.abspath('.'))

import mathml  # noqa: E402 # beside this file
import reference  # noqa: E402 # beside this file

project = 'obc_ros'
author = 'The obc_ros developers'
copyright = f'2026, {author}'
release = version = ElementTree.parse(ROOT / 'package.xml').findtext('version') or ''

extensions = ['myst_parser', *(
    name for name in ('sphinx_copybutton',) if util.find_spec(name))]
exclude_patterns = ['_build']
suppress_warnings = ['toc.empty_glob']  # of pages that are not in every copy

myst_enable_extensions = ['deflist', 'dollarmath']
myst_heading_anchors = 3
smartquotes = False
html_math_renderer = 'mathml'

html_theme = 'furo' if util.find_spec('furo') else 'alabaster'
html_title = f'obc_ros {release}'
html_static_path = ['_static']
html_css_files = ['obc_ros.css']
html_show_sourcelink = False
html_copy_source = False
copybutton_prompt_text = '$ '
copybutton_only_copy_prompt_lines = True
# The console blocks show what is answered: highlighting would colour words of English.
highlight_language = 'text'

rosdoc2_settings = {'allow_other_extensions': True, 'enable_autodoc': False,
                    'enable_intersphinx': False}


def setup(app: Any) -> None:
    """Add the directives and the renderer of this folder."""
    mathml.setup(app)
    reference.setup(app, ROOT)
