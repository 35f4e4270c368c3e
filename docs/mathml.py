# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""Formulas as MathML, which browsers show by themselves: no script and no font is loaded."""

from collections.abc import Iterator
import logging
import re
from typing import Any

from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml

TOKEN = re.compile(r'\\[A-Za-z]+|\\.| - |[^\\]', re.DOTALL)
OPENING = {'{', '(', '[', r'\begin', r'\left', r'\lvert'}
CLOSING = {'}', ')', ']', r'\end', r'\right', r'\rvert'}
OPERATORS = {'=', '<', '>', '+', ' - ', r'\le', r'\ge', r'\to'}
SHORT = 30  # characters of a formula that fits a line


def setup(app: Any) -> None:
    """Register the renderer ``mathml``."""
    app.add_html_math_renderer('mathml', (_inline, None), (_block, None))


def _inline(translator: Any, node: nodes.math) -> None:
    parts = break_after_operators(node.astext())
    translator.body.append('<wbr>'.join(_markup(node, as_block=False, text=part)
                                        for part in parts))
    raise nodes.SkipNode


def _block(translator: Any, node: nodes.math_block) -> None:
    parts = split(node.astext())
    markup = ' '.join(_markup(node, as_block=True, text=part) for part in parts)
    if len(parts) > 1:  # each on the line of the one before, if there is room
        markup = markup.replace(' display="block"', ' displaystyle="true"')
    translator.body.append(f'<div class="math">{markup}</div>\n')
    raise nodes.SkipNode


def split(text: str) -> list[str]:
    r"""Return the formulas that ``\qquad`` separates, outside of brackets and environments."""
    parts = ['']
    for token, is_outside in _walk(text):
        if token == r'\qquad' and is_outside:
            parts.append('')
        else:
            parts[-1] += token
    return [part.strip() for part in parts]


def break_after_operators(text: str) -> list[str]:
    """Return the parts of a long formula in a line of text, which a browser does not break."""
    parts = ['']
    for token, is_outside in _walk(text):
        is_operator = token in OPERATORS and not parts[-1].endswith(('^', '_'))
        parts[-1] += token
        if is_operator and is_outside and len(text) > SHORT:
            parts.append('')
    return [part for part in parts if part.strip()]


def _walk(text: str) -> Iterator[tuple[str, bool]]:
    """Yield the tokens of a formula, and whether they are outside of all brackets."""
    depth = 0
    for token in TOKEN.findall(text):
        depth -= token in CLOSING
        yield token, not depth
        depth += token in OPENING


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
