# Copyright 2026 The obc_ros developers
# SPDX-License-Identifier: Apache-2.0
"""
Slides of a gallery, statement and figure side by side: one HTML file without external resources.

Right, Down, Space, Page Down and a click go on; Left, Up and Page Up go back. Printed, each slide
is a page.
"""

from base64 import b64encode
from collections.abc import Sequence
import html
import json
from pathlib import Path

from obc_ros.book.kept import find_kept
from obc_ros.book.page import format_markup, Record, strip_markup
from obc_ros.core.text.errors import ObcError

LONG = 1000   # characters of the words of a slide: more are set in small type
_STYLE = """
* { box-sizing: border-box; margin: 0; }
body { font: 20px/1.4 Georgia, 'Times New Roman', serif; color: #1b1f24; background: #fff; }
section { display: none; height: 100vh; padding: 3vh 4vw 2vh; column-gap: 3vw;
  grid-template: auto auto 1fr auto / minmax(0, 34fr) minmax(0, 66fr); }
section.shown { display: grid; }
h2, .source, footer { grid-column: 1 / -1; }
h2 { font-size: min(4.2vh, 2.6vw); line-height: 1.2; }
.source { grid-row: 2; color: #57606a; font-style: italic; }
.words { grid-area: 3 / 1; overflow-y: auto; align-self: center; padding: 1vh 0;
  font-size: min(2.7vh, 1.6vw); }
.long { font-size: min(2.15vh, 1.3vw); }
.words p { margin-bottom: 0.7em; }
.erratum { border-left: 4px solid #0b4f79; padding-left: 0.6em; }
.caption { color: #57606a; font-size: 0.9em; }
img { grid-area: 3 / 2; min-height: 0; width: 100%; height: 100%; object-fit: contain; }
footer { grid-row: 4; text-align: right; color: #57606a; font-size: 15px; }
sub, sup { line-height: 0; font-size: 75%; }
@media screen and (max-width: 800px) {
  section { height: auto; min-height: 100vh; grid-template: none / minmax(0, 1fr); }
  h2 { font-size: 24px; } .words { font-size: 16px; }
  .source, .words, img, footer { grid-area: auto; }
}
@media print {
  @page { size: landscape; margin: 1cm; }
  section { display: grid; height: 98vh; padding: 0; break-after: page; }
}
"""
_SCRIPT = """
const slides = [...document.querySelectorAll('section')];
let now = Math.min(Math.max(parseInt(location.hash.slice(1)) || 1, 1), slides.length) - 1;
function go(to) {
  now = Math.min(Math.max(to, 0), slides.length - 1);
  slides.forEach((slide, index) => slide.classList.toggle('shown', index === now));
  history.replaceState(null, '', '#' + (now + 1));
}
const steps = { ArrowRight: 1, ArrowDown: 1, PageDown: 1, ' ': 1, ArrowLeft: -1, ArrowUp: -1,
  PageUp: -1, Home: -slides.length, End: slides.length };
addEventListener('keydown', event => {
  if (event.key in steps) { event.preventDefault(); go(now + steps[event.key]); }
});
addEventListener('click', () => go(now + 1));
go(now);
"""


def write_slides(folder: Path, names: Sequence[str]) -> Path:
    """
    Write ``slides.html`` of some entries of a gallery, or all, and return the file.

    If the folder has no results, they are those that the package has with it.
    """
    path = folder / 'slides.html'
    results = folder if (folder / 'gallery.json').exists() else find_kept()
    try:
        slides = _read_slides(results, names)
        if slides:
            folder.mkdir(parents=True, exist_ok=True)
            path.write_text(_write_page(slides), encoding='utf-8')
    except OSError as error:
        raise ObcError(f'{error.filename}: {error.strerror}; obc gallery --out DIR writes the '
                       'results that slides are made of') from error
    except (ValueError, KeyError, TypeError) as error:
        raise ObcError(f'{folder / "gallery.json"} is not of obc gallery') from error
    if not slides:
        raise ObcError(f'{results} has no figures of these entries; obc gallery writes them')
    return path


def _read_slides(folder: Path, names: Sequence[str]) -> list[str]:
    """Return the slides of all figures of some entries, or of all."""
    entries = json.loads((folder / 'gallery.json').read_text(encoding='utf-8'))['entries']
    # For one version, examples are known by their number alone.
    wanted = {name.removeprefix('example-') for name in names}
    shown = [(each, figure) for each in entries
             if not names or each['name'].removeprefix('example-') in wanted
             for figure in each['figures']]
    return [_write_slide(*each, folder, f'{number} of {len(shown)}')
            for number, each in enumerate(shown, 1)]


def _write_slide(record: Record, figure: str, folder: Path, count: str) -> str:
    path = folder / Path(figure).name
    data = b64encode(path.read_bytes()).decode()
    shown = html.escape(f'{record["label"]}: {strip_markup(record["title"])}')
    source = '' if record['source'] == record['label'] else (
        f'<p class="source">{format_markup(record["source"])}</p>\n')
    return (f'<section>\n<h2>{html.escape(record["label"])}: {format_markup(record["title"])}</h2>'
            f'\n{source}{_write_words(record)}\n'
            f'<img src="data:image/png;base64,{data}" alt="Figure of {shown}">\n'
            f'<footer>{count}</footer>\n</section>')


def _write_words(record: Record) -> str:
    """Return the statement, the erratum if there is one, and the caption of the figures."""
    statement, notes, erratum = record['statement'], record['notes'], record['erratum']
    size = ' long' if sum(map(len, (*statement, erratum, *notes))) > LONG else ''
    parts = [f'<p>{format_markup(each)}</p>' for each in statement]
    if erratum:
        parts.append(f'<p class="erratum"><b>Erratum.</b> {format_markup(erratum)}</p>')
    parts += [f'<p class="caption">{format_markup(each)}</p>' for each in notes]
    return f'<div class="words{size}">\n' + '\n'.join(parts) + '\n</div>'


def _write_page(slides: Sequence[str]) -> str:
    return ('<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
            f'<title>obc_ros: slides of the gallery</title>\n<style>{_STYLE}</style>\n</head>\n'
            '<body>\n' + '\n'.join(slides) + f'\n<script>{_SCRIPT}</script>\n</body>\n</html>\n')
