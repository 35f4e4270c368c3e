# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""The formulas of the site fit a telephone: none is cut, and short ones share a line."""

from importlib import util
import json
from pathlib import Path
import re
import shutil

import pytest

pytest.importorskip('docutils', reason='docutils is not installed')
from docutils import nodes  # after the check

DOCS = Path(__file__).resolve().parents[2] / 'docs'
WIDTH = 350   # [px] of the text on a screen of 390 px
CHROMIUM = shutil.which('chromium') or shutil.which('chromium-browser')
CUT = """() => [...document.querySelectorAll('div.math, p > math')].map(each => [
    (each.matches('p > math') ? each.getBoundingClientRect().width : each.scrollWidth) >
    document.body.clientWidth, each.textContent.replace(/\\s+/g, '')])"""


@pytest.fixture(scope='module')
def mathml():
    """Return the module docs/mathml.py, which draws formulas when the site is built."""
    spec = util.spec_from_file_location('mathml', DOCS / 'mathml.py')
    module = util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class Translator:
    """What Sphinx writes a page with."""

    def __init__(self) -> None:
        self.body: list[str] = []


def list_formulas(mark: str = r'\$\$') -> list[str]:
    """Return the formulas between marks, of all pages and notebooks."""
    texts = [re.sub('^```.*?^```', '', page.read_text(encoding='utf-8'), flags=re.DOTALL | re.M)
             for page in sorted(DOCS.rglob('*.md'))]
    books = (json.loads(page.read_text(encoding='utf-8'))
             for page in sorted((DOCS.parent / 'notebooks').glob('*.ipynb')))
    texts += [''.join(cell['source']) for book in books for cell in book['cells']
              if cell['cell_type'] == 'markdown']
    if mark == r'\$':
        texts = [re.sub(r'\$\$.*?\$\$|`[^`]*`', '', text, flags=re.DOTALL) for text in texts]
    return [found.strip() for text in texts
            for found in re.findall(f'{mark}(.*?){mark}', text, re.DOTALL)]


def test_formulas_are_split_outside_of_braces_only(mathml):
    assert mathml.split(r'a = 1, \qquad b = 2') == ['a = 1,', 'b = 2']
    assert mathml.split(r'\text{a \qquad b} \qquad c') == [r'\text{a \qquad b}', 'c']
    for inside in (r'\left( a \qquad b \right)', r'\begin{aligned} a \qquad \\ b \end{aligned}'):
        assert mathml.split(inside) == [inside]
    for formula in list_formulas():
        assert r' \qquad '.join(mathml.split(formula)).split() == formula.split()


def test_long_formulas_of_a_paragraph_are_broken_after_operators(mathml):
    broken = ['g =', r' |\nu|^T |\psi(x(T) = 0)| +', r' p^+ - ', r'q \le', r' \frac{a = b}{c + d}']
    assert mathml.break_after_operators(''.join(broken)) == broken
    assert mathml.break_after_operators('a = b + c') == ['a = b + c']
    for formula in list_formulas(r'\$'):
        assert ''.join(mathml.break_after_operators(formula)) == formula


@pytest.mark.slow
@pytest.mark.skipif(not CHROMIUM, reason='no Chromium: apt-get install chromium')
def test_no_formula_is_cut_on_a_telephone(mathml, tmp_path):
    sync = pytest.importorskip('playwright.sync_api', reason='playwright is not installed')
    page, formulas = Translator(), list_formulas()
    for formula in formulas:
        with pytest.raises(nodes.SkipNode):
            mathml._block(page, nodes.math_block(formula, formula))
    for formula in list_formulas(r'\$'):
        page.body.append('<p>')
        with pytest.raises(nodes.SkipNode):
            mathml._inline(page, nodes.math(formula, formula))
    style = (DOCS / '_static' / 'obc_ros.css').read_text(encoding='utf-8')
    file = tmp_path / 'formulas.html'
    file.write_text(
        f'<!doctype html><meta charset="utf-8"><style>{style} body {{ width: {WIDTH}px }}</style>'
        + ''.join(page.body), encoding='utf-8')
    with sync.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=['--no-sandbox'])
        shown = browser.new_page(viewport={'width': 390, 'height': 844})
        shown.goto(file.as_uri())
        found = shown.evaluate(CUT)
        browser.close()
    assert len(found) > 10 * len(formulas) > 500
    assert [text for is_cut, text in found if is_cut] == []
