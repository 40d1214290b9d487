"""The figures of a study as SVG in the page: selectable text, alt texts, and values on hover.

The scripts of `paper_figs` draw the figures from the files of the folder. The same study gives the
same bytes.
"""

import io
import re
import shutil
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import matplotlib as mpl
from markupsafe import Markup, escape
from matplotlib.figure import Figure

from paper_figs import (
    outcome_tables,
    posteriors,
    score_tables,
    specification_curve,
    tables_1_2_brier,
)
from paper_figs.all import SCRIPTS as ALL_SCRIPTS
from paper_figs.scores import read_scores
from study.common.errors import StudyError
from study.common.plugins import reason
from study.config.names import label
from study.multiverse import folder as multiverse
from study.page.colours import themed
from study.page.hover import Hover, hovers
from study.plotting import style
from study.results.folder import STUDY
from study.results.summary import FITS, SCORES, TRIALS

_COLOUR = re.compile(r"(fill|stroke): (#[0-9a-fA-F]{6})\b")
TABLES = (tables_1_2_brier, outcome_tables, score_tables, posteriors)
SCRIPTS = [script for script in ALL_SCRIPTS if script not in TABLES]
"""The scripts that draw figures."""
POINTS_PER_INCH = 72
FILES = (SCORES, TRIALS, FITS, STUDY, *multiverse.FILES)
"""The files of a results folder that the scripts read."""

KINDS = {
    "mmd": (
        "MMD² over the forecast horizon",
        "Mean MMD² over scenarios, state dimensions and seeds at each forecast step, with 95 % "
        "bands; one curve for each model, solid with much training data and dashed with little. "
        "Lower is better.",
    ),
    "overview": (
        "Forecast trajectories",
        "Observed and forecast trajectories of one test scenario, and their separation into "
        "aleatoric and epistemic uncertainty, at each level of epistemic uncertainty.",
    ),
    "base_rates": (
        "True probability of success",
        "Histogram of the true probability of success of the test scenarios, for each environment, "
        "with the base rate as a dashed line.",
    ),
    "reliability": (
        "Reliability of the forecast probability of success",
        "Observed frequency of success over the forecast probability, for each model and level. A "
        "reliable forecaster is on the diagonal.",
    ),
    "calibration": (
        "Calibration of the forecast states",
        "Coverage of the central 50, 80 and 90 % intervals over the horizon, and PIT histograms of "
        "each model. A flat histogram is calibrated.",
    ),
    "variance": (
        "Forecast variance / true variance",
        "Ratio of forecast variance to true variance over the horizon, one panel for each model. "
        "The ideal ratio is 1.",
    ),
    "mmd_by_dimension": (
        "MMD² by dimension of the state",
        "MMD² over the forecast horizon, one panel for each dimension of the state.",
    ),
    "beta": (
        "The search for β",
        "Validation score of each trial over β, for each model, environment and level. A ring "
        "marks the chosen β.",
    ),
    "specification": (
        "Specification curve",
        "The effect of a claim in each universe of the multiverse with its 95 % interval, in "
        "ascending order, in the colour of the verdict, on a scale that is linear near zero and "
        "logarithmic elsewhere. Dots below show which value of each choice a universe has.",
    ),
    "vae_scores": (
        "The two VAEs in all universes",
        "MMD² of the residual VAE over that of the full VAE, a point for each universe and level, "
        "one panel for each environment. Below the diagonal the residual VAE is better.",
    ),
    "verdicts": (
        "Verdicts in all universes",
        "The share of universes with each verdict, for every claim.",
    ),
}
"""Title and alt text of each kind of figure."""


@dataclass(frozen=True)
class Drawing:
    """A figure in the page.

    Attributes:
        name: of its file without suffix, such as ``mmd_pusher``.
        title: what it shows, in a few words.
        alt: what it shows, in a sentence or two.
        svg: the figure.
        view: its coordinates, as the attribute `viewBox` of an SVG.
    """

    name: str
    title: str
    alt: str
    svg: Markup
    view: str


def scripts(out: Path) -> list[ModuleType]:
    """The scripts that can draw a figure from the files of a results folder."""
    has_scores = (out / SCORES).is_file()
    return [s for s in SCRIPTS if has_scores or s is specification_curve]


def draw(out: Path) -> tuple[dict[str, Drawing], list[str]]:
    """All figures of a results folder by name, and one line for each that could not be drawn."""
    drawings: dict[str, Drawing] = {}
    areas = dict(_hovers(out))

    def write(figure: Figure, stem: Path) -> list[Path]:
        drawings[stem.name] = _drawing(figure, stem.name, areas.get(stem.name, ()))
        return []

    problems = []
    with tempfile.TemporaryDirectory(prefix="study-page-") as temporary, style.written_by(write):
        copy = Path(temporary)
        for name in FILES:
            if (out / name).is_file():
                shutil.copyfile(out / name, copy / name)
        if (out / "illustrations").is_dir():
            shutil.copytree(out / "illustrations", copy / "illustrations")
        for script in scripts(out):
            try:
                script.plot(copy)
            except Exception as error:  # one damaged file must not remove the other figures
                why = str(error) if isinstance(error, StudyError) else reason(error)
                problems.append(f"no figure: {why.replace(f'{copy}/', '').replace(str(copy), '.')}")
    return drawings, problems


def kind_and_subject(name: str) -> tuple[str, str]:
    """The kind of a figure, and its environment or nothing: ``mmd_pusher``, ``beta``."""
    kinds = [kind for kind in KINDS if name == kind or name.startswith(f"{kind}_")]
    kind = max(kinds, key=len, default=name)
    return kind, name[len(kind) + 1 :]


def _hovers(out: Path) -> Iterator[tuple[str, Hover]]:
    try:
        yield from hovers(read_scores(out))
    except StudyError:
        return


def slug(name: str) -> str:
    """A name as part of an address: letters, digits, hyphens and underscores."""
    return re.sub(r"[^A-Za-z0-9_-]", "-", name)


def _drawing(figure: Figure, name: str, hover: Hover) -> Drawing:
    kind, subject = kind_and_subject(name)
    title, alt = KINDS.get(kind, (name.replace("_", " "), name.replace("_", " ")))
    if kind == "specification":
        title = f"{title}: {subject}"
    elif subject:
        title, alt = f"{title}, {label(subject)}", f"{label(subject)}. {alt}"
    figure.draw_without_rendering()  # the layout, which positions on hover need
    figure.set_layout_engine("none")
    stream = io.StringIO()
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": name}):
        figure.savefig(
            stream, format="svg", transparent=True, metadata={"Date": None, "Creator": None}
        )
    view, svg = _inline(stream.getvalue(), slug(name), alt, _areas(figure, hover))
    return Drawing(name, title, alt, Markup(svg), view)


def _areas(figure: Figure, hover: Hover) -> str:
    """Invisible areas, whose titles are shown on hover and tap."""
    scale = POINTS_PER_INCH / figure.dpi
    height = figure.get_figheight() * POINTS_PER_INCH
    areas = []
    for area in hover:
        axes = figure.axes[area.panel]
        box = axes.get_window_extent()
        (left, _), (right, _) = axes.transData.transform([(area.left, 0), (area.right, 0)])
        areas.append(
            f'<rect class="step" x="{left * scale:.1f}" y="{height - box.y1 * scale:.1f}" '
            f'width="{(right - left) * scale:.2f}" height="{box.height * scale:.1f}">'
            f"<title>{escape(area.text)}</title></rect>"
        )
    return "".join(areas)


def _inline(svg: str, name: str, alt: str, areas: str) -> tuple[str, str]:
    """An SVG file as an element of the page: unique names, colours of the theme, an alt text.

    Returns:
        its coordinates and the element.
    """
    body = svg[svg.index("<svg") :]
    body = re.sub(r"<metadata>.*?</metadata>\s*", "", body, flags=re.DOTALL)
    box = re.search(r'viewBox="([^"]+)"', body)
    body = body[body.index(">") + 1 : body.rindex("</svg>")]
    unnamed = set(re.findall(r'(?:url\(#|href="#)([^")]+)', body))

    def named(found: re.Match[str]) -> str:
        """The name of what is used, once: equal markers are defined several times."""
        if found[1] not in unnamed:
            return ""
        unnamed.remove(found[1])
        return f' id="{name}-{found[1]}"'

    body = re.sub(r' id="([^"]+)"', named, body)
    body = re.sub(r'(url\(#|href="#)', rf"\g<1>{name}-", body)
    body = _COLOUR.sub(lambda found: f"{found[1]}: {themed(found[2])}", body)
    body = re.sub(r"(\d\.\d\d)\d+", r"\1", body)
    body = re.sub(r"\n\s*", "\n", body)
    view = box.group(1) if box else "0 0 100 100"
    # Other elements of the page show the same figure through the name of its group.
    return view, (
        f'<svg class="figure" viewBox="{view}" role="img" aria-label="{escape(alt)}" '
        f'xmlns:xlink="http://www.w3.org/1999/xlink"><g id="{name}-whole">{body}</g>{areas}</svg>'
    )
