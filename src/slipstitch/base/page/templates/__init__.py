"""The template environment of all pages: ``base.html.j2``, macros, the style sheet.

A package of its own: a picture, which some stage's result contains, does not depend on a sheet.
"""

import functools
from pathlib import Path
from typing import Any

import jinja2

from slipstitch import __version__
from slipstitch.base.page import palette
from slipstitch.base.page.wording import breaking, counted, duration, number, percent, size

FOLDER = Path(__file__).parent


@functools.cache
def environment(folder: Path) -> jinja2.Environment:
    """Templates of `folder` and those that all pages share; HTML is escaped, Markdown is not."""
    found = jinja2.Environment(
        loader=jinja2.FileSystemLoader([folder, FOLDER]),
        autoescape=lambda name: name is not None and ".html" in name,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    for function in (breaking, counted, duration, number, percent, size):
        found.filters[function.__name__] = function
    found.globals |= {"palette": palette, "version": __version__}
    return found


def render(template: Path, **context: Any) -> str:
    """A page from its template, which needs no other file.

    The template lies beside the code that fills it and may extend ``base.html.j2``; the context is
    what it shows.
    """
    return environment(template.parent).get_template(template.name).render(**context)
