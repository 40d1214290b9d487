"""The page of a study: one file that needs no network, made from the files of a results folder."""

import base64
import hashlib
from functools import lru_cache
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape
from markupsafe import Markup

from paper_figs.formatting import title
from paper_figs.scores import environments
from study.common.files import write_text
from study.config.names import ENVIRONMENTS
from study.page import cells, effects, score_views, settings_view
from study.page.evidence import Evidence, read
from study.page.figures import KINDS, Drawing, draw, kind_and_subject, slug

NAME = "index.html"
STYLES = ("base.css", "tables.css", "figures.css", "print.css")


def write_page(out: Path) -> Path:
    """Write ``index.html`` of a results folder.

    Raises:
        BadInput: the folder has no results.
    """
    path = out / NAME
    write_text(path, render_folder(out))
    return path


def render_folder(out: Path) -> str:
    """The page of the study in a results folder.

    Raises:
        BadInput: the folder has no results.
    """
    return render(read(out))


def render(evidence: Evidence) -> str:
    """The page of a study."""
    drawings, problems = draw(evidence.out) if evidence.scores is not None else ({}, [])
    claims, checks = effects.views(evidence.claims)
    different, every = settings_view.settings(evidence)
    tables = score_views.aggregate(evidence)
    names = [] if evidence.scores is None else environments(evidence.scores)
    return (
        templates()
        .get_template("page.html")
        .render(
            evidence=evidence,
            problems=[*evidence.problems, *problems],
            is_of_paper=not names or any(name in ENVIRONMENTS for name in names),
            environments=[(name, title(name)) for name in names],
            claims=claims,
            checks=checks,
            tally=effects.tally,
            ticks=effects.ticks(),
            drawings=drawings,
            by_kind=_by_kind(drawings),
            brier=list(score_views.brier(evidence)),
            models=list(cells.side_by_side(evidence, tables)),
            cells=cells.cells(evidence),
            shared_recordings=cells.shared_recordings(evidence.recordings),
            scores=score_views.all_scores(tables),
            fits=cells.fits(evidence),
            settings_different=different,
            settings_all=every,
            versions=settings_view.versions(evidence),
            source=settings_view.source_digests(evidence),
            stages=settings_view.stages(evidence),
        )
    )


def _by_kind(drawings: dict[str, Drawing]) -> dict[str, list[Drawing]]:
    """The figures of each kind; empty for a kind without any."""
    groups: dict[str, list[Drawing]] = {kind: [] for kind in KINDS}
    for name, drawing in drawings.items():
        groups.setdefault(kind_and_subject(name)[0], []).append(drawing)
    return groups


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
