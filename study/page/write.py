"""The page of a study: one file that needs no network, made from the files of a results folder."""

from pathlib import Path

from paper_figs.formatting import title
from paper_figs.scores import environments
from study.common.files import write_text
from study.config.names import ENVIRONMENTS
from study.multiverse.folder import FACTS as MULTIVERSE
from study.page import (
    ablations,
    cell_settings,
    cells,
    effects,
    outcomes,
    scenarios,
    score_views,
    settings_view,
)
from study.page.environment import templates
from study.page.evidence import Evidence, read
from study.page.figures import KINDS, Drawing, draw, kind_and_subject

NAME = "index.html"


def write_page(out: Path) -> Path:
    """Write ``index.html`` of a results folder.

    Raises:
        BadInput: the folder has no results.
    """
    path = out / NAME
    write_text(path, render_folder(out) + "\n")
    return path


def render_folder(out: Path) -> str:
    """The page of the study in a results folder.

    Raises:
        BadInput: the folder has no results.
    """
    return render(read(out))


def render(evidence: Evidence) -> str:
    """The page of a study."""
    drawings, problems = draw(evidence.out) if _has_figures(evidence) else ({}, [])
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
            failed=evidence.failed,
            ablations=ablations.table(evidence),
            is_of_paper=not names or any(name in ENVIRONMENTS for name in names),
            environments=[(name, title(name)) for name in names],
            claims=claims,
            checks=checks,
            tally=effects.tally,
            ticks=effects.ticks(),
            drawings=drawings,
            by_kind=_by_kind(drawings),
            brier=list(score_views.brier(evidence)),
            outcomes=list(outcomes.tables(evidence)),
            models=list(cells.side_by_side(evidence, tables)),
            cells=cells.cells(evidence),
            scenarios=scenarios.table(evidence),
            shared_recordings=cells.shared_recordings(evidence.recordings),
            scores=score_views.all_scores(tables),
            fits=cells.fits(evidence),
            settings_of_cells=cell_settings.table(evidence),
            settings_different=different,
            settings_all=every,
            versions=settings_view.versions(evidence),
            source=settings_view.source_digests(evidence),
            stages=settings_view.stages(evidence),
        )
    )


def _has_figures(evidence: Evidence) -> bool:
    return evidence.scores is not None or (evidence.out / MULTIVERSE).is_file()


def _by_kind(drawings: dict[str, Drawing]) -> dict[str, list[Drawing]]:
    """The figures of each kind; empty for a kind without any."""
    groups: dict[str, list[Drawing]] = {kind: [] for kind in KINDS}
    for name, drawing in drawings.items():
        groups.setdefault(kind_and_subject(name)[0], []).append(drawing)
    return groups
