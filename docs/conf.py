# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Sphinx configuration; nothing of the site is fetched from elsewhere, nor is obc_ros imported."""

from importlib import util
import os
from pathlib import Path
import re
import sys
from typing import Any
from xml.etree import ElementTree

# rosdoc2 runs a copy of this folder, and has the package on the path.
ROOT = next(folder for folder in map(Path, (os.path.abspath('..'), *sys.path))
            if (folder / 'package.xml').is_file())
sys.path[:0] = [os.path.abspath('.'), str(ROOT)]

import mathml  # noqa: E402 # beside this file
import reference  # noqa: E402 # beside this file
import rooms  # noqa: E402 # beside this file

project = 'obc_ros'
author = 'The obc_ros developers'
copyright = f'2026, {author}'
release = version = ElementTree.parse(ROOT / 'package.xml').findtext('version') or ''

# `make docs` has run the notebooks; myst_nb, where it is installed, shows their results.
extensions = ['myst_nb' if util.find_spec('myst_nb') else 'myst_parser', *(
    name for name in ('sphinx_copybutton',) if util.find_spec(name))]
nb_execution_mode = 'off'
# What rosdoc2 adds of its own says nothing that is not here.
# The notebooks of the gallery are downloads: its pages have the same programs.
exclude_patterns = ['_*', '[A-Z]*', 'action', 'msg', 'srv', 'gallery/*.ipynb']

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
                    'enable_intersphinx': False,
                    'automatically_extend_intersphinx_mapping': False}


def list_others(app: Any, page: str, source: list[str]) -> None:
    """Add to some pages the contents of their folder; let those of the gallery offer notebooks."""
    if page.startswith('gallery/'):
        source[0] = source[0].replace(f']({page.partition("/")[2]}.ipynb)',
                                      f'](path:{page.partition("/")[2]}.ipynb)')
    if page in ('gallery', 'derivations', 'development/index'):
        folder = page.split('/')[0]
        named = re.findall(rf'\]\((?:{folder}/)?([^/]*)\.md\)', source[0])  # in their order
        there = sorted(each.partition('/')[2] for each in app.env.found_docs - {page}
                       if each.startswith(f'{folder}/'))
        pages = [each for each in dict.fromkeys([*named, *there]) if each in there]
        source[0] += '\n```{toctree}\n:hidden:\n\n' + ''.join(
            f'/{folder}/{each}\n' for each in pages) + '```\n'
    if page == 'notebooks' and any(each.startswith('notebooks/') for each in app.env.found_docs):
        source[0] += '\n```{toctree}\n:maxdepth: 1\n:glob:\n\nnotebooks/*\n```\n'


def setup(app: Any) -> None:
    """Add the directives and the renderer of this folder."""
    app.connect('source-read', list_others)
    mathml.setup(app)
    reference.setup(app, ROOT)
    rooms.setup(app, ROOT)
