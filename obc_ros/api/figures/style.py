# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The style of all figures: sizes, fonts, colours with line styles, symbols and units.

A figure is 8.4 in wide and has text of 13 pt: printed at half size, as in a column of a journal,
the text has 6.5 pt. Lines differ by colour and by dashes, so that nothing depends on colour alone.
matplotlib is imported when a figure is drawn.
"""

from collections.abc import Callable
from contextvars import ContextVar
from functools import cache
import io
import re
from typing import Any

WIDTH = 8.4  # [in]
# Okabe and Ito's colours, distinct with any colour vision.
LINE_COLOURS = ('#0072B2', '#D55E00', '#009E73', '#CC79A7', '#E69F00', '#56B4E9', '#000000')
# Dashes in multiples of the line width: (offset, (on, off, ...)). One for each colour.
LINE_DASHES: tuple[Any, ...] = (
    '-', (0, (5.0, 1.6)), (0, (7.0, 1.5, 1.4, 1.5)), (0, (1.3, 1.2)), (0, (10.0, 2.0)),
    (0, (6.0, 1.4, 1.3, 1.4, 1.3, 1.4)), (0, (2.6, 1.4)))
FONT_SIZE = 13.0  # [pt]
STYLE: dict[str, Any] = {
    # Symbols are serif as in a book; signs that STIX lacks come from DejaVu.
    'font.family': ['STIXGeneral', 'DejaVu Sans'], 'mathtext.fontset': 'stix',
    'font.size': FONT_SIZE, 'axes.titlesize': FONT_SIZE, 'axes.labelsize': FONT_SIZE,
    'xtick.labelsize': FONT_SIZE, 'ytick.labelsize': FONT_SIZE, 'legend.fontsize': FONT_SIZE,
    'figure.titlesize': FONT_SIZE + 1.0,
    'axes.grid': True, 'grid.alpha': 0.3, 'axes.axisbelow': True, 'axes.spines.top': False,
    'axes.spines.right': False, 'lines.linewidth': 1.8, 'lines.markersize': 6.0,
    'legend.frameon': True, 'legend.framealpha': 0.85, 'legend.edgecolor': 'none',
    'legend.borderpad': 0.15, 'legend.labelspacing': 0.25, 'legend.handlelength': 2.0,
    'legend.handletextpad': 0.5, 'legend.columnspacing': 1.2,
    'figure.constrained_layout.w_pad': 0.08, 'figure.constrained_layout.h_pad': 0.06,
    'savefig.dpi': 200}
# For figures that leave colours and dashes to matplotlib, as those of the notebooks.
CYCLE = {'axes.prop_cycle': (f"cycler('color', {list(LINE_COLOURS)}) + "
                             f"cycler('linestyle', {list(LINE_DASHES)})")}
THIN: dict[str, Any] = {'color': 'grey', 'linewidth': 0.9, 'linestyle': (0, (4, 3)),
                        'zorder': 1.5}
# A reference that lies on a line is circles: colour and dashes of the line stay visible. A
# reference of marked values is a line beneath them.
EXACT: dict[str, Any] = {
    'color': 'black', 'linestyle': 'none', 'marker': 'o', 'markerfacecolor': 'none',
    'markersize': 5.5, 'markeredgewidth': 1.1, 'markevery': 0.09, 'zorder': 5}
EXACT_LINE: dict[str, Any] = {'color': 'black', 'linewidth': 1.0, 'zorder': 1.6}
GREEK = ('alpha', 'beta', 'gamma', 'delta', 'epsilon', 'zeta', 'eta', 'theta', 'kappa', 'lambda',
         'mu', 'nu', 'xi', 'rho', 'sigma', 'tau', 'phi', 'chi', 'psi', 'omega')


def get_line(index: int) -> dict[str, Any]:
    """
    Return colour and dashes of a line, as options for `Axes.plot`.

    :param index: number of the line in its panel, from 0. The first seven differ in colour and in
        dashes, the first 49 in one of them.
    """
    count = len(LINE_COLOURS)
    return {'color': LINE_COLOURS[index % count],
            'linestyle': LINE_DASHES[(index + index // count) % count]}


def typeset_symbol(name: str) -> str:
    r"""Return a name in the notation of mathtext: ``\theta``, ``x_{1}``, ``\mathrm{speed}``."""
    word, index = re.findall(r'^(.*?)_?(\d*)\Z', name)[0]
    letter = (f'\\{word}' if word in GREEK else word if len(word) == 1 else
              rf'\mathrm{{{word}}}'.replace('_', r'\_'))
    return f'{letter}_{{{index}}}' if index else letter


def label_unit(text: str, unit: str) -> str:
    """Return a label with its unit, if known, in brackets: ``speed [m/s$^{2}$]``."""
    if not unit:
        return text
    plain = unit.replace('\\', r'\\').replace('$', r'\$')
    typeset = re.sub(r'(?:[*]{2}|\^)(-?[0-9.]+)', r'$^{\1}$', plain)
    return f'{text} [{typeset}]'


# pyplot.figure while a figure is drawn for a user; None: figures that pyplot does not know.
FIGURES: ContextVar[Callable[..., Any] | None] = ContextVar('FIGURES', default=None)


def new_figure(height: float) -> Any:
    """Return an empty figure of `WIDTH` and a height [in]; a notebook shows it without pyplot."""
    make, size = FIGURES.get(), {'figsize': (WIDTH, height), 'layout': 'constrained'}
    kind = _figure_class()
    return make(FigureClass=kind, **size) if make else kind(**size)


def is_inline() -> bool:
    """Return whether a notebook shows the figures of pyplot at the end of each cell."""
    import matplotlib
    return matplotlib.get_backend().endswith('inline')


@cache
def _figure_class() -> type[Any]:
    """Return a class of figures that keep `STYLE` and need no pyplot to be shown."""
    import matplotlib
    from matplotlib.backend_bases import RendererBase
    from matplotlib.figure import Figure

    class StyledFigure(Figure):
        def draw(self, renderer: RendererBase) -> None:
            with matplotlib.rc_context(STYLE):   # ticks are made when they are drawn
                super().draw(renderer)

        def _repr_png_(self) -> bytes:
            stream = io.BytesIO()
            self.savefig(stream, format='png', dpi=100)
            return stream.getvalue()

        def _ipython_display_(self) -> None:
            if is_inline():
                from matplotlib import pyplot
                pyplot.close(self)   # the end of the cell would show it again
            raise NotImplementedError   # it is shown as any other object

    return StyledFigure
