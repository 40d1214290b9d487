"""The templates of pages, their style sheet and their script."""

import base64
import hashlib
from functools import lru_cache
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape
from markupsafe import Markup

from study.page.figures import slug

STYLES = ("base.css", "tables.css", "figures.css", "print.css")


@lru_cache
def templates() -> Environment:
    """The templates. Every text is escaped."""
    loader = PackageLoader("study.page")
    environment = Environment(
        loader=loader,
        autoescape=select_autoescape(default=True),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    folder = Path(__file__).parent
    style = "\n".join((folder / "style" / name).read_text(encoding="utf-8") for name in STYLES)
    script = (folder / "style" / "page.js").read_text(encoding="utf-8")
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    environment.globals |= {
        "style": Markup(style),
        "script": Markup(script),
        # The page may load nothing at all; its script is allowed by its digest.
        "policy": (
            f"default-src 'none'; style-src 'unsafe-inline'; img-src data:; "
            f"script-src 'sha256-{digest}'; base-uri 'none'; form-action 'none'"
        ),
    }
    environment.filters["slug"] = slug
    return environment
