"""What each kind of recording looks like when it is opened: its views, and its timeline."""

from collections.abc import Collection, Mapping, Sequence

import rerun as rr
import rerun.blueprint as rrb

from study.config.names import label
from study.recording import charts
from study.recording.properties import README
from study.recording.spread import TITLE as SPREAD

# Below the root of a trajectory: a frame that moves along with it.
FOLLOW = "follow"

Range = tuple[float, float]
Band = tuple[str, str, Range | None]

# A legend of more lines than these hides the plot.
_LEGIBLE = 15
# Which view of a training recording a metric belongs to: the first whose words its name contains.
_TRAINING_VIEWS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("KL divergence [nat]", ("kl",)),
    ("Learning rate", ("lr", "learning_rate")),
    ("Gradient norm", ("grad",)),
    ("Validation", ("val", "validation", "score")),
    ("Loss", ("loss", "nll", "reconstruction", "likelihood")),
)


def blueprint(
    timeline: str, *views: rrb.View | rrb.Container, playing: bool = False
) -> rrb.Blueprint:
    """A page of views over one timeline. Nothing else is shown but a slim time panel."""
    return rrb.Blueprint(
        *views,
        rrb.TimePanel(
            timeline=timeline,
            state="collapsed",
            play_state="playing" if playing else "paused",
            loop_mode="all",
            fps=24.0,
        ),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        auto_views=False,
        auto_layout=False,
    )


def readme(origin: str = README, name: str = "README") -> rrb.View:
    """A Markdown panel."""
    return rrb.TextDocumentView(origin=origin, name=name)


def plot(
    name: str,
    contents: Sequence[str],
    *,
    span: Range | None = None,
    legend: rrb.Corner2D | None = rrb.Corner2D.LeftTop,
    times: tuple[int, int] | None = None,
) -> rrb.View:
    """Curves over the timeline; `span` is the range of the y axis, `times` that of the x axis."""
    return rrb.TimeSeriesView(
        origin="/",
        contents=list(contents),
        name=name,
        axis_x=None if times is None else _time_axis(*times),
        axis_y=None if span is None else rrb.ScalarAxis(range=span),
        plot_legend=rrb.PlotLegend(corner=legend, visible=legend is not None),
    )


def chart(name: str, origin: str) -> rrb.View:
    """A chart that `charts.Chart` has drawn."""
    return rrb.Spatial2DView(origin=origin, name=name, visual_bounds=charts.BOUNDS)


def grid(views: Sequence[rrb.View], columns: int, name: str | None = None) -> rrb.Container:
    """Views in rows of `columns`; a last row of one view is as wide as the others."""
    if columns == 1 or len(views) < columns or len(views) % columns != 1:
        return rrb.Grid(*views, grid_columns=min(columns, len(views)), name=name)
    rows = len(views) // columns
    above = rrb.Grid(*views[:-1], grid_columns=columns)
    return rrb.Vertical(above, views[-1], row_shares=[rows, 1], name=name)


def training(metrics: Sequence[str]) -> rrb.Blueprint:
    """Training: metrics by what they are, in views of their own; all but the count of epochs."""
    groups: dict[str, list[str]] = {}
    for metric in metrics:
        if metric.strip("/").split("/")[-1] == "epoch":
            continue
        groups.setdefault(_training_view(metric), []).append("/" + metric.strip("/"))
    order = ["Loss", "Validation", *(title for title, _ in _TRAINING_VIEWS), "Other"]
    titles = sorted(groups, key=lambda title: ([*order, title].index(title), title))
    views = [
        plot(
            title,
            groups[title],
            # One curve is what the title says.
            legend=rrb.Corner2D.RightTop if len(groups[title]) > 1 else None,
        )
        for title in titles
    ]
    notes = rrb.Tabs(readme(), readme("/hyperparameters", "Hyperparameters"), name="Notes")
    columns = 1 if len(views) < 3 else 2
    return blueprint(
        "step",
        rrb.Horizontal(notes, grid(views, columns), column_shares=[1, 3]) if views else notes,
    )


def tuning() -> rrb.Blueprint:
    """Tuning: the score over β, how each trial came to it, and the search as it went."""
    return blueprint(
        "trial",
        rrb.Horizontal(
            readme(),
            rrb.Vertical(
                rrb.Horizontal(
                    chart("Score of each β (lower is better)", "/chart/beta"),
                    chart("Intermediate scores of each trial", "/chart/intermediate"),
                ),
                rrb.Horizontal(
                    plot(
                        "Score and best so far",
                        ["/value/**", "/best"],
                        legend=rrb.Corner2D.RightTop,
                    ),
                    plot("log₁₀ β of each trial", ["/log10_beta"], legend=None),
                ),
                row_shares=[3, 2],
            ),
            column_shares=[1, 3],
        ),
    )


def forecast(
    roots: Mapping[str, str],
    bands: Mapping[str, Sequence[Band]],
    eyes: Mapping[str, rrb.EyeControls3D],
    split: Collection[str] = (),
    columns: int = 2,
    rows: int = 3,
) -> rrb.Blueprint:
    """Forecasts: a tab a scenario with the scene in 3D, the probability of success, the bands.

    Args:
        roots: entity root of each scenario, by the tab's title.
        bands: for each root, the title, entity and range of each state dimension's bands.
        eyes: where each scene is looked at from.
        split: the roots whose variance is split into aleatoric and epistemic.
    """
    tabs = []
    for title, root in roots.items():
        grids = [
            grid(
                [plot(name, [entity], span=span, legend=None) for name, entity, span in page],
                columns,
                " · ".join(name.split(" [")[0] for name, _, _ in page),
            )
            for page in _pages(bands[root], columns * rows)
        ]
        scene = rrb.Spatial3DView(
            origin="/",
            contents=["/scene/**", f"{root}/scene/**", f"{root}/paths/**"],
            name="Observed and forecast paths",
            eye_controls=eyes[root],
            line_grid=False,
        )
        below: rrb.View | rrb.Container
        below = plot("Probability of success so far", [f"{root}/success/**"], span=(-0.05, 1.05))
        if root in split:
            below = rrb.Horizontal(below, plot(SPREAD, [f"{root}/spread"]))
        left = rrb.Vertical(scene, below, row_shares=[3, 2])
        right = rrb.Tabs(*grids, name="State") if len(grids) > 1 else grids[0]
        about = readme(f"{root}/about", "About this scenario")
        tabs.append(rrb.Horizontal(about, left, right, column_shares=[2, 5, 6], name=title))
    return blueprint("horizon", rrb.Tabs(*tabs, readme()), playing=True)


def scores(pages: Mapping[str, Mapping[str, Sequence[str]]], reliability: bool) -> rrb.Blueprint:
    """Scores: the metrics over the horizon, overall and by dimension, and the reliability diagram.

    Args:
        pages: the entities of each view, by its title, by the page that it is on.
        reliability: whether there is a reliability diagram; it stands on the first page.
    """
    tabs: list[rrb.Container] = []
    for title, curves in pages.items():
        views = [_of_scores(name, entities) for name, entities in curves.items()]
        if reliability and not tabs:
            views.append(chart("Reliability: probability of success", "/chart/reliability"))
        tabs.append(grid(views, 2, title))
    if not tabs:
        return blueprint("horizon", readme())
    shown = rrb.Tabs(*tabs) if len(tabs) > 1 else tabs[0]
    return blueprint("horizon", rrb.Horizontal(readme(), shown, column_shares=[1, 3]))


def _of_scores(name: str, entities: Sequence[str]) -> rrb.View:
    """Ratios, of which 1 is right, keep to a range that shows it: first steps can be far off."""
    contents = [f"{entity}/**" for entity in entities]
    span = (0.0, 4.0) if "ratio" in name else None
    # One curve is what the title says, and many are told apart by pointing at them.
    legend = rrb.Corner2D.RightTop if 2 < len(entities) <= 8 else None
    return plot(name, contents, span=span, legend=legend)


def _pages(
    items: Sequence[tuple[str, str, Range | None]], most: int
) -> list[list[tuple[str, str, Range | None]]]:
    """The items in as few pages of at most `most` as will do, of nearly equal length."""
    count = -(-len(items) // most)
    length = -(-len(items) // count)
    return [list(items[start : start + length]) for start in range(0, len(items), length)]


def _training_view(metric: str) -> str:
    """The title of a metric's view; what is logged of the ensemble stays apart from the model's."""
    if metric.strip("/").startswith("ensemble/"):
        return f"Ensemble: {_training_view(metric.strip('/').removeprefix('ensemble/')).lower()}"
    words = metric.lower().replace("/", "_").replace("-", "_").split("_")
    text = "_".join(words)
    for title, keys in _TRAINING_VIEWS:
        if any(key in words if len(key) < 4 else key in text for key in keys):
            return title
    return "Other"


def data(
    roots: Mapping[str, str],
    signals: Mapping[str, Sequence[tuple[str, str]]],
    eyes: Mapping[str, rrb.EyeControls3D],
    close_up: rrb.EyeControls3D | None,
) -> rrb.Blueprint:
    """Training data: a tab a trajectory, with the scene in 3D and every signal of all of them.

    Args:
        roots: entity root of each trajectory that has a tab, by the tab's title.
        signals: title and entity of each signal, by the page that they are on.
        eyes: where each scene is looked at from.
        close_up: an eye of their own for bodies that are too small beside their paths.
    """
    tabs = []
    for title, root in roots.items():
        scene = ["/scene/**", f"{root}/scene/**"]
        paths = ["/paths/**", f"{root}/paths/**"]
        distance = plot(
            "Distance to the target [m]", ["/distance", f"{root}/distance", "/radius"], legend=None
        )
        below: rrb.View | rrb.Container = distance
        if close_up is not None:
            close = _scene("Close-up", scene, close_up, f"{root}/{FOLLOW}")
            below = rrb.Horizontal(close, distance)
        left = rrb.Vertical(_scene("Paths", [*scene, *paths], eyes[root]), below, row_shares=[3, 2])
        pages = [
            grid(
                [plot(name, [entity, f"{root}{entity}"], legend=None) for name, entity in page],
                2,
                name,
            )
            for name, page in signals.items()
        ]
        about = readme(f"{root}/about", "About this trajectory")
        tabs.append(
            rrb.Horizontal(about, left, rrb.Tabs(*pages), column_shares=[2, 5, 6], name=title)
        )
    return blueprint("step", rrb.Tabs(*tabs, readme()), playing=True)


def study(
    curves: Mapping[str, Sequence[str]],
    horizons: Mapping[str, int],
    span: Range,
    texts: Mapping[str, str],
) -> rrb.Blueprint:
    """A whole study: the discrepancy of all cells, a plot an environment, and what it comes to.

    Args:
        curves: the entities of each plot, by environment.
        horizons: the last step of each environment.
        span: the range of all plots, which makes environments comparable.
        texts: the entity of each text, by its title.
    """
    plots = []
    for environment, entities in curves.items():
        horizon, legible = horizons[environment], len(entities) <= _LEGIBLE
        plots.append(
            plot(
                f"{label(environment)}: MMD² of all cells",
                entities,
                span=span,
                legend=rrb.Corner2D.RightTop if legible else None,
                # The legend stands beside the curves, not on them.
                times=(1, 4 * horizon // 3 if legible else horizon),
            )
        )
    panels = rrb.Tabs(*(readme(entity, title) for title, entity in texts.items()))
    right = rrb.Vertical(rrb.Horizontal(*plots), panels, row_shares=[3, 2])
    return blueprint("horizon", rrb.Horizontal(readme(), right, column_shares=[1, 3]))


def _time_axis(first: int, last: int) -> rrb.TimeAxis:
    """An x axis from one time to another."""
    ends = (rr.TimeRangeBoundary.absolute(seq=time) for time in (first, last))
    return rrb.TimeAxis(view_range=rr.TimeRange(*ends))


def _scene(
    name: str, contents: Sequence[str], eye: rrb.EyeControls3D, origin: str = "/"
) -> rrb.View:
    """A scene in 3D, in the frame of the entity `origin`, without Rerun's own grid."""
    return rrb.Spatial3DView(
        origin=origin, contents=list(contents), name=name, eye_controls=eye, line_grid=False
    )
