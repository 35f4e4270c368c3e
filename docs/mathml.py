# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Formulas as MathML, which browsers show by themselves: no script and no font is loaded."""

import re
from typing import Any

from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.util import logging


def setup(app: Any) -> None:
    """Register the renderer ``mathml``."""
    app.add_html_math_renderer('mathml', (_inline, None), (_block, None))


def _inline(translator: Any, node: nodes.math) -> None:
    translator.body.append(_markup(node, as_block=False))
    raise nodes.SkipNode


def _block(translator: Any, node: nodes.math_block) -> None:
    translator.body.append(f'<div class="math">{_markup(node, as_block=True)}</div>\n')
    raise nodes.SkipNode


def _markup(node: nodes.Element, as_block: bool) -> str:
    text = node.astext()
    if '\\\\' in text and '\\begin' not in text:
        text = f'\\begin{{aligned}}{text}\\end{{aligned}}'
    try:
        markup = str(tex2mathml(text, as_block=as_block))
    except MathError as error:
        logging.getLogger(__name__).warning('formula %r: %s', text, error, location=node)
        return ''
    # Bars are alike on both sides: a browser cannot tell which opens, and spaces them out.
    bar = r'<mo stretchy="false" lspace="0" rspace="0">\1</mo>'
    markup = re.sub(r'<mo[^>]*>([|∣‖])</mo>', bar, markup)
    # docutils puts the index of a letter with a dot under the letter, in place of beside it.
    return re.sub(r'<munderover>\s*(<mi>[^<]*</mi>)(.*?)(<mo[^>]*>[˙¨~^]</mo>)\s*</munderover>',
                  r'<msub><mover>\1\3</mover>\2</msub>', markup, flags=re.DOTALL)
