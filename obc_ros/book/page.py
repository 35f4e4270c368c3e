# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The page of the gallery: static HTML and CSS without external resources.

Markup of the texts: `$...$` is mathematics. In it letters are italic, `_` and `^` make the next
character or {group} an index or a power, and names of functions are upright. Backquotes enclose
code.
"""

from collections.abc import Mapping, Sequence
import html
import re
from typing import Any

Record = Mapping[str, Any]

_TERMINALS = ('<p>From the folder of this page, every <code>ros2 run</code> in a terminal of '
              'its own{}; without a ROS 2 installation with <code>obc</code> in place of '
              '<code>ros2</code>:</p>')
_SERVER = ', and <code>ros2 run obc_ros trajectory_server</code> in another'
ERRORS = ('The error is the difference divided by the reference, or by 1 if the reference is '
          'below 1 (unless it is marked as relative). Of several values the one with the largest '
          'error is shown.')
_PARTS = re.compile(r'(\$[^$]*\$|`[^`]*`)')
_TOKEN = re.compile(r'([_^])(\{[^}]*\}|.)|(&\w+;)|([A-Za-z]+)|([\u0370-\u03ff])|(.)', re.DOTALL)
_UPRIGHT = ('arg', 'asin', 'atan', 'cos', 'cosh', 'diag', 'exp', 'for', 'if', 'ln', 'max', 'min',
            'rank', 'sat', 'sgn', 'sin', 'sinh', 'tan')

_STYLE = """
:root { --ink: #1b1f24; --soft: #57606a; --line: #d0d7de; --back: #f6f8fa; --good: #1a7f37;
  --bad: #b42318; --book: #0b4f79; }
* { box-sizing: border-box; }
body { margin: 0; color: var(--ink); background: #fff;
  font: 17px/1.55 Georgia, 'Times New Roman', serif; }
header, nav, main, footer { max-width: 1080px; margin: 0 auto; padding: 0 24px; }
header { padding-top: 40px; }
h1 { font-size: 34px; line-height: 1.2; margin: 0 0 8px; }
h2 { font-size: 25px; line-height: 1.25; margin: 0; }
header p, .source { color: var(--soft); }
nav table { font-size: 15px; }
article { border-top: 2px solid var(--ink); margin-top: 44px; padding-top: 14px; }
.source { margin: 2px 0 10px; font-style: italic; }
sub, sup { line-height: 0; font-size: 75%; }
figure { margin: 18px 0; text-align: center; }
img { max-width: 100%; height: auto; }
table { border-collapse: collapse; width: 100%; margin: 12px 0; font-size: 15px; }
th { text-align: left; border-bottom: 1.5px solid var(--ink); font-weight: 600; }
td, th { padding: 4px 10px 4px 0; vertical-align: top; }
td { border-bottom: 1px solid var(--line); }
td.number { font-variant-numeric: tabular-nums; white-space: nowrap; }
.good { color: var(--good); font-weight: 600; } .bad { color: var(--bad); font-weight: 600; }
.erratum { border-left: 5px solid var(--book); background: var(--back); padding: 10px 16px;
  margin: 14px 0; }
.erratum p { margin: 4px 0; }
code, pre { font: 13.5px/1.45 'DejaVu Sans Mono', Menlo, Consolas, monospace; }
pre { background: var(--back); border: 1px solid var(--line); padding: 10px 12px; margin: 8px 0;
  white-space: pre-wrap; overflow-wrap: anywhere; }
details > summary { cursor: pointer; font-weight: 600; }
a { color: var(--book); text-decoration: none; } a:hover { text-decoration: underline; }
footer { color: var(--soft); font-size: 14px; margin-top: 50px; padding-bottom: 40px; }
@media print {
  body { font-size: 10.5pt; } header, nav, main, footer { max-width: none; padding: 0; }
  article { break-before: page; border-top: none; margin-top: 0; }
  figure, tr, .erratum { break-inside: avoid; } h2, .source { break-after: avoid; }
  img { max-height: 15cm; } table { font-size: 8.5pt; } pre { font-size: 7.5pt; }
  a { color: inherit; }
}
"""


def render_page(records: Sequence[Record]) -> str:
    """Return the page of entries, given as ``gallery.json`` holds them."""
    numbers = sum(row['values'] for record in records for row in record['rows'])
    held = sum(record['holds'] for record in records)
    head = (
        '<h1>Gallery of obc_ros</h1>\n<p>Examples, theorems and exercises of chapter 2 of R. M. '
        'Murray, <i>Optimization-Based Control</i> (draft v2.1a, 2010), and examples of '
        'estimation and of receding horizons. The ROS 2 nodes of obc_ros and their library '
        'compute each result. It is compared with a reference that is computed '
        f'without them. {numbers} numbers are compared. All of them are within their tolerances '
        f'in {held} of {len(records)} entries.</p>')
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f'<title>obc_ros: gallery</title>\n<style>{_STYLE}</style>\n</head>\n<body>\n'
        f'<header>\n{head}\n</header>\n<nav>\n{_contents(records)}\n</nav>\n<main>\n'
        + '\n'.join(map(_article, records)) + '\n</main>\n<footer>\n<p>'
        + format_markup(f'{ERRORS} `obc gallery` made this page. The numbers are in '
                        '`gallery.json`, recordings of the loops in `recordings`.')
        + '</p>\n</footer>\n</body>\n</html>\n')


def format_markup(text: str) -> str:
    """Return a text as HTML."""
    return ''.join(_part(part) for part in _PARTS.split(text))


def strip_markup(text: str) -> str:
    """Return a text without its markup, for a terminal."""
    return re.sub(r'[$`{}]', '', text)


def format_scientific(text: str) -> str:
    """Return a number such as ``1.2e-05`` in the markup of this page: ``$1.2·10^{-5}$``."""
    digits, _, exponent = text.partition('e')
    return f'${digits}·10^{{{int(exponent)}}}$' if exponent else f'${digits}$'


def show_number(value: float | None) -> str:
    """Return a number with ten significant digits."""
    return '-' if value is None else format_markup(format_scientific(f'{value:.10g}'))


def _contents(records: Sequence[Record]) -> str:
    rows = '\n'.join(
        f'<tr><td><a href="#{_anchor(each)}">{html.escape(each["label"])}</a></td>'
        f'<td><a href="#{_anchor(each)}">{format_markup(each["title"])}</a></td>'
        f'<td class="number">{sum(row["values"] for row in each["rows"])}</td>'
        f'<td class="number">{_error(each)}</td><td class="number">{each["seconds"]:.1f} s</td>'
        f'<td>{_verdict(each["holds"])}</td></tr>'
        for each in records)
    return ('<table>\n<tr><th>entry</th><th></th><th>numbers</th><th>largest error</th>'
            f'<th>time</th><th></th></tr>\n{rows}\n'
            '</table>')


def _article(record: Record) -> str:
    parts = [f'<article id="{_anchor(record)}">',
             f'<h2>{html.escape(record["label"])}: {format_markup(record["title"])}</h2>',
             f'<p class="source">{format_markup(record["source"])}</p>',
             *(f'<p>{format_markup(each)}</p>' for each in record['statement'])]
    if record['erratum']:
        finding = f'<p>{format_markup(record["finding"])}</p>' if record['finding'] else ''
        parts.append('<div class="erratum"><p><b>Erratum.</b> '
                     f'{format_markup(record["erratum"])}</p>{finding}</div>')
    if record['message']:
        parts.append(f'<p class="bad">{html.escape(record["message"])}</p>')
    shown = html.escape(f'{record["label"]}: {strip_markup(record["title"])}')
    parts += [f'<figure><img src="{name}" alt="Figure of {shown}"></figure>'
              for name in record['figures']]
    parts += [f'<p>{format_markup(each)}</p>' for each in record['notes']]
    if record['rows']:
        parts.append(_table(record['rows']))
    if record['commands']:
        server = _SERVER if any('/trajectory_server/' in each for each in record['commands']) \
            else ''
        commands = '\n'.join(f'<pre>{html.escape(each)}</pre>' for each in record['commands'])
        parts.append(f'<details open><summary>Run it</summary>\n{_TERMINALS.format(server)}\n'
                     f'{commands}\n</details>')
    return '\n'.join([*parts, '</article>'])


def _table(rows: Sequence[Record]) -> str:
    lines = '\n'.join(
        f'<tr><td>{format_markup(row["what"])}{_many(row)}</td>'
        f'<td class="number">{show_number(row["measured"])}</td>'
        f'<td class="number">{show_number(row["exact"])}</td>'
        f'<td class="number {"good" if row["holds"] else "bad"}">{format_error(row["error"])}'
        f'{" <small>(relative)</small>" if row["relative"] else ""}</td>'
        f'<td>{format_markup(row["by"])}</td></tr>' for row in rows)
    return ('<table>\n<tr><th>quantity</th><th>result</th><th>reference</th><th>error</th>'
            f'<th>source of the reference</th></tr>\n{lines}\n</table>')


def _many(row: Record) -> str:
    return f' <small>({row["values"]} values)</small>' if row['values'] > 1 else ''


def _error(record: Record) -> str:
    errors = [row['error'] for row in record['rows']]
    return '' if not errors else format_error(None if None in errors else max(errors))


def format_error(value: float | None) -> str:
    """Return an error with two significant digits."""
    return ('infinite' if value is None else format_markup(format_scientific(f'{value:.1e}'))
            if value
            else '0')


def _verdict(holds: bool) -> str:
    return '<span class="good">holds</span>' if holds else '<span class="bad">does not hold</span>'


def _anchor(record: Record) -> str:
    return f'entry-{record["name"]}'


def _part(part: str) -> str:
    if len(part) > 1 and part[0] == part[-1] == '`':
        return f'<code>{html.escape(part[1:-1])}</code>'
    if len(part) > 1 and part[0] == part[-1] == '$':
        return _mathematics(html.escape(part[1:-1], quote=False))
    return html.escape(part, quote=False)


def _mathematics(text: str) -> str:
    found = []
    for shift, group, entity, word, greek, other in _TOKEN.findall(text):
        if shift:
            tag = 'sub' if shift == '_' else 'sup'
            found.append(f'<{tag}>{_mathematics(group.strip("{}"))}</{tag}>')
        elif word:
            found.append(word if word in _UPRIGHT else f'<i>{word}</i>')
        elif greek:
            found.append(f'<i>{greek}</i>')
        else:
            found.append(entity or {'-': '\u2212', "'": '\u2032'}.get(other, other))
    return ''.join(found)
