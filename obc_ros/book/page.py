# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
The page of the gallery: static HTML and CSS without external resources.

Markup of the texts: `$...$` is mathematics. In it letters are italic, `_` and `^` make the next
character or {group} an index or a power, and names of functions are upright. Backquotes enclose
code.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
import html
import re
from typing import Any

Record = Mapping[str, Any]

_TERMINALS = ('<p>After <code>obc gallery</code> with ROS 2, from the folder of this page, every '
              '<code>ros2 run</code> in a terminal of its own{}; without a ROS 2 installation '
              'with <code>obc</code> in place of <code>ros2</code>:</p>')
_SERVER = ', and <code>ros2 run obc_ros trajectory_server</code> in another'
ERRORS = ('An error is the difference divided by the reference, or by 1 if the reference is '
          'below 1 (unless it is marked as relative).')
ASKED = ('asked', 'result', 'reference')
VERIFIED = ('quantity', 'numbers', 'largest error', 'source of the reference')
_PARTS = re.compile(r'(\$[^$]*\$|`[^`]*`)')
_TOKEN = re.compile(r'([_^])(\{[^}]*\}|.)|(&\w+;)|([A-Za-z]+)|([\u0370-\u03ff])|(.)', re.DOTALL)
_UPRIGHT = ('arg', 'asin', 'atan', 'cos', 'cosh', 'diag', 'exp', 'for', 'if', 'ln', 'max', 'min',
            'rank', 'sat', 'sgn', 'sin', 'sinh', 'tan')

_STYLE = """
:root { --ink: #1b1f24; --soft: #57606a; --line: #d0d7de; --back: #f6f8fa;
  --bad: #b42318; --book: #0b4f79; }
* { box-sizing: border-box; }
body { margin: 0; color: var(--ink); background: #fff;
  font: 17px/1.55 Georgia, 'Times New Roman', serif; }
header, nav, main, footer { max-width: 1080px; margin: 0 auto; padding: 0 24px; }
header { padding-top: 40px; }
h1 { font-size: 34px; line-height: 1.2; margin: 0 0 8px; }
h2 { font-size: 25px; line-height: 1.25; margin: 0; }
header p, .source { color: var(--soft); }
nav { display: grid; grid-template-columns: repeat(auto-fill, minmax(158px, 1fr)); gap: 22px 18px;
  margin-top: 24px; font-size: 15px; line-height: 1.35; }
nav img { display: block; width: 100%; height: 118px; object-fit: cover; object-position: 0 0;
  border: 1px solid var(--line); margin-bottom: 6px; }
article { border-top: 2px solid var(--ink); margin-top: 44px; padding-top: 14px; }
.source { margin: 2px 0 10px; font-style: italic; }
sub, sup { line-height: 0; font-size: 75%; }
figure { margin: 18px 0; text-align: center; }
img { max-width: 100%; height: auto; }
table { border-collapse: collapse; width: 100%; margin: 12px 0; font-size: 15px; }
th { text-align: left; border-bottom: 1.5px solid var(--ink); font-weight: 600; }
td, th { padding: 4px 10px 4px 0; vertical-align: top; }
td { border-bottom: 1px solid var(--line); }
.bad { color: var(--bad); font-weight: 600; }
.erratum { border-left: 5px solid var(--book); background: var(--back); padding: 10px 16px;
  margin: 14px 0; }
.erratum p { margin: 4px 0; }
code, pre { font: 13.5px/1.45 'DejaVu Sans Mono', Menlo, Consolas, monospace; }
pre { background: var(--back); border: 1px solid var(--line); padding: 10px 12px; margin: 8px 0;
  white-space: pre-wrap; overflow-wrap: anywhere; }
details { margin: 8px 0; overflow-x: auto; }
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
        + format_markup('`obc gallery` made this page. The numbers are in `gallery.json`.')
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


def show_values(values: Any) -> str:
    """Return a number or lists of numbers as markup: six digits each, a rounding error as 0."""
    if isinstance(values, list):
        return f'[{", ".join(map(show_values, values))}]'
    return format_scientific(f'{round(values, 12) + 0:.6g}')


def _contents(records: Sequence[Record]) -> str:
    return '\n'.join(
        f'<a href="#{_anchor(each)}">'
        + ''.join(f'<img src="{name}" alt="" loading="lazy">' for name in each['figures'][:1])
        + f'<b>{html.escape(each["label"])}</b> {format_markup(each["title"])}'
        + ('' if each['holds'] else ' <span class="bad">does not hold</span>') + '</a>'
        for each in records)


def _article(record: Record) -> str:
    parts = [f'<article id="{_anchor(record)}">',
             f'<h2>{html.escape(record["label"])}: {format_markup(record["title"])}</h2>',
             f'<p class="source">{format_markup(record["source"])}</p>',
             *(f'<p>{format_markup(each)}</p>' for each in record['statement'])]
    if record['program']:
        name = record['name']
        parts.append(f'<pre>{html.escape(record["program"])}</pre>\n<p>It prints:</p>\n'
                     f'<pre>{html.escape(record["output"])}</pre>\n<p>Download: '
                     f'<a href="{name}.py">Python</a>, <a href="{name}.ipynb">notebook</a></p>')
        parts.append(_table(ASKED, map(list_asked, record['asked'])))
    if record['message']:
        parts.append(f'<p class="bad">{html.escape(record["message"])}</p>')
    shown = html.escape(f'{record["label"]}: {strip_markup(record["title"])}')
    parts += [f'<figure><img src="{name}" alt="Figure of {shown}"></figure>'
              for name in record['figures']]
    parts += [f'<p>{format_markup(each)}</p>' for each in record['notes']]
    if record['erratum']:
        finding = f'<p>{format_markup(record["finding"])}</p>' if record['finding'] else ''
        parts.append('<div class="erratum"><p><b>Erratum.</b> '
                     f'{format_markup(record["erratum"])}</p>{finding}</div>')
    return '\n'.join([*parts, *_folded(record), '</article>'])


def _folded(record: Record) -> Iterator[str]:
    if record['rows']:
        yield (f'<details><summary>Verification: {summarize(record)}</summary>\n'
               f'<p>{ERRORS}</p>\n' + _table(VERIFIED, map(list_verified, record['rows']))
               + '\n</details>')
    if record['commands']:
        server = _SERVER if any('/trajectory_server/' in each for each in record['commands']) \
            else ''
        commands = '\n'.join(f'<pre>{html.escape(each)}</pre>' for each in record['commands'])
        yield (f'<details><summary>Commands of ROS 2</summary>\n{_TERMINALS.format(server)}\n'
               f'{commands}\n</details>')


def summarize(record: Record) -> str:
    """Return how many numbers of an entry are compared, and their largest error, as HTML."""
    rows = record['rows']
    errors = [row['error'] for row in rows]
    worst = format_markup(format_error(None if None in errors else max(errors)))
    return f'{sum(row["values"] for row in rows)} numbers, largest error {worst}'


def list_asked(asked: Record) -> tuple[str, ...]:
    """Return the cells of what an entry asks for, in the markup of this page."""
    return (asked['what'], show_values(asked['value']),
            f'{asked["by"]}: {show_values(asked["exact"])}')


def list_verified(row: Record) -> tuple[str, ...]:
    """Return the cells of a compared quantity, in the markup of this page."""
    relative = ' (relative)' if row['relative'] else ''
    wrong = '' if row['holds'] else ' does not hold'
    return (row['what'], str(row['values']), format_error(row['error']) + relative + wrong,
            row['by'])


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = '\n'.join('<tr>' + ''.join(f'<td>{format_markup(each)}</td>' for each in row) + '</tr>'
                      for row in rows)
    return (f'<table>\n<tr>{"".join(f"<th>{each}</th>" for each in head)}</tr>\n{lines}\n'
            '</table>')


def format_error(value: float | None) -> str:
    """Return an error with two significant digits, in the markup of this page."""
    return ('infinite' if value is None else format_scientific(f'{value:.1e}') if value
            else '0')


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
