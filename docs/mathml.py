# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Formulas as MathML, which browsers show by themselves: no script and no font is loaded."""

import logging
import re
from typing import Any

from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml


def setup(app: Any) -> None:
    """Register the renderer ``mathml``."""
    app.add_html_math_renderer('mathml', (_inline, None), (_block, None))


def _inline(translator: Any, node: nodes.math) -> None:
    translator.body.append(_markup(node, as_block=False))
    raise nodes.SkipNode


def _block(translator: Any, node: nodes.math_block) -> None:
    parts = split(node.astext())
    markup = ' '.join(_markup(node, as_block=True, text=part) for part in parts)
    if len(parts) > 1:  # each on the line of the one before, if there is room
        markup = markup.replace(' display="block"', ' displaystyle="true"')
    translator.body.append(f'<div class="math">{markup}</div>\n')
    raise nodes.SkipNode


def split(text: str) -> list[str]:
    r"""Return the formulas that ``\qquad`` separates, outside of braces and environments."""
    parts, depth = [''], 0
    for token in re.findall(r'\\(?:begin|end|left|right)\b|\\qquad\b|\\.|[^\\]', text, re.DOTALL):
        depth += token in ('{', r'\begin', r'\left')
        depth -= token in ('}', r'\end', r'\right')
        if token == r'\qquad' and not depth:
            parts.append('')
        else:
            parts[-1] += token
    return [part.strip() for part in parts]


def _markup(node: nodes.Element, as_block: bool, text: str = '') -> str:
    text = text or node.astext()
    if '\\\\' in text and '\\begin' not in text:
        text = f'\\begin{{aligned}}{text}\\end{{aligned}}'
    try:
        markup = str(tex2mathml(text, as_block=as_block))
    except MathError as error:
        logging.getLogger('sphinx.mathml').warning('formula %r: %s', text, error,
                                                   extra={'location': node})
        return ''
    # Bars are alike on both sides: a browser cannot tell which opens, and spaces them out.
    bar = r'<mo stretchy="false" lspace="0" rspace="0">\1</mo>'
    markup = re.sub(r'<mo[^>]*>([|∣‖])</mo>', bar, markup)
    # docutils puts the index of a letter with a dot under the letter, in place of beside it.
    return re.sub(r'<munderover>\s*(<mi>[^<]*</mi>)(.*?)(<mo[^>]*>[˙¨~^]</mo>)\s*</munderover>',
                  r'<msub><mover>\1\3</mover>\2</msub>', markup, flags=re.DOTALL)
