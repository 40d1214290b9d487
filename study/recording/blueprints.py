"""The layout of each kind of recording in the viewer: its views and its timeline."""

from collections.abc import Collection, Mapping, Sequence

import rerun as rr
import rerun.blueprint as rrb

from study.config.names import label
from study.recording import charts
from study.recording.properties import README
from study.recording.variance_split import TITLE as POSITION_STD

FOLLOW = "follow"
"""The entity, below the root of a trajectory, of a frame that moves along with it."""

LEGEND = "/legend"
"""The entity of the legend of a whole study."""

Range = tuple[float, float]
Band = tuple[str, str, Range | None]
"""Title, entity and y axis of a plot; None leaves the axis to the viewer."""

# Largest number of lines of a legend. A longer legend covers the plot.
_LEGIBLE = 15
# The views of a training recording. A metric is in the first view of which its name has a word.
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
    """A page of views over one timeline, with a slim time panel and no other panel."""
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
    """A view of Markdown."""
    return rrb.TextDocumentView(origin=origin, name=name)


def plot(
    name: str,
    contents: Sequence[str],
    *,
    span: Range | None = None,
    legend: rrb.Corner2D | None = rrb.Corner2D.LeftTop,
    times: tuple[int, int] | None = None,
) -> rrb.View:
    """A plot of curves over the timeline.

    Args:
        name: the title.
        contents: the entities of the curves.
        span: the range of the y axis; None for the viewer's default.
        legend: the corner of the legend; None for no legend.
        times: the range of the x axis; None for the viewer's default.
    """
    return rrb.TimeSeriesView(
        origin="/",
        contents=list(contents),
        name=name,
        axis_x=None if times is None else _time_axis(*times),
        axis_y=None if span is None else rrb.ScalarAxis(range=span),
        plot_legend=rrb.PlotLegend(corner=legend, visible=legend is not None),
    )


def chart(name: str, origin: str) -> rrb.View:
    """A view of a `charts.Chart`."""
    return rrb.Spatial2DView(origin=origin, name=name, visual_bounds=charts.BOUNDS)


def grid(views: Sequence[rrb.View], columns: int, name: str | None = None) -> rrb.Container:
    """Views in rows of `columns`. A single view in the last row fills the row."""
    if columns == 1 or len(views) < columns or len(views) % columns != 1:
        return rrb.Grid(*views, grid_columns=min(columns, len(views)), name=name)
    rows = len(views) // columns
    above = rrb.Grid(*views[:-1], grid_columns=columns)
    return rrb.Vertical(above, views[-1], row_shares=[rows, 1], name=name)


def training(metrics: Sequence[str]) -> rrb.Blueprint:
    """Training: a view for each kind of metric, without the number of the epoch."""
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
            # A single curve needs no legend beside the title.
            legend=rrb.Corner2D.RightTop if len(groups[title]) > 1 else None,
        )
        for title in titles
    ]
    notes = readme()
    columns = 1 if len(views) < 3 else 2
    return blueprint(
        "step",
        rrb.Horizontal(notes, grid(views, columns), column_shares=[1, 3]) if views else notes,
    )


def tuning() -> rrb.Blueprint:
    """Tuning: the score over β, the scores during each trial, and the trials in their order."""
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
                        ["/score/**", "/best"],
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
    has_outcomes: bool = True,
    position_unit: str = "m",
    columns: int = 2,
    rows: int = 3,
) -> rrb.Blueprint:
    """Forecasts: for each example a tab with the 3D scene, the success and the bands.

    Args:
        roots: entity root of each example, by the tab's title.
        bands: the bands of each state dimension, by root.
        eyes: the viewpoint of each scene, by root. A root without one has no scene.
        split: the roots with a variance that is split into aleatoric and epistemic.
        has_outcomes: whether there is a probability of success.
        position_unit: of the standard deviation of the position.
        columns: of plots of bands.
        rows: of plots of bands on a tab; further plots are on further tabs.
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
        contents = ["/scene/**", f"{root}/scene/**", f"{root}/paths/**"]
        left: list[rrb.View | rrb.Container] = []
        if root in eyes:
            left.append(_scene("Observed and forecast paths", contents, eyes[root]))
        below: list[rrb.View | rrb.Container] = []
        if has_outcomes:
            success = [f"{root}/success/**"]
            below.append(plot("Probability of success so far", success, span=(-0.05, 1.05)))
        if root in split:
            std = f"{POSITION_STD} [{position_unit}]"
            below.append(plot(std, [f"{root}/position_std"]))
        if below:
            left.append(rrb.Horizontal(*below) if len(below) > 1 else below[0])
        right = rrb.Tabs(*grids, name="State") if len(grids) > 1 else grids[0]
        about = readme(f"{root}/about", "About this scenario")
        if not left:
            tabs.append(rrb.Horizontal(about, right, column_shares=[2, 11], name=title))
            continue
        column = rrb.Vertical(*left, row_shares=[3, 2]) if len(left) > 1 else left[0]
        tabs.append(rrb.Horizontal(about, column, right, column_shares=[2, 5, 6], name=title))
    return blueprint("horizon", rrb.Tabs(*tabs, readme()), playing=True)


def scores(pages: Mapping[str, Mapping[str, Sequence[str]]], reliability: bool) -> rrb.Blueprint:
    """Scores: metrics over the horizon, averaged and by dimension, and the reliability diagram.

    Args:
        pages: the entities of each view, by its title, by its page.
        reliability: whether the first page has a reliability diagram.
    """
    tabs: list[rrb.Container] = []
    for title, curves in pages.items():
        views = [_score_plot(name, entities) for name, entities in curves.items()]
        if reliability and not tabs:
            views.append(chart("Reliability: probability of success", "/chart/reliability"))
        tabs.append(grid(views, 2, title))
    if not tabs:
        return blueprint("horizon", readme())
    content = rrb.Tabs(*tabs) if len(tabs) > 1 else tabs[0]
    return blueprint("horizon", rrb.Horizontal(readme(), content, column_shares=[1, 3]))


def _score_plot(name: str, entities: Sequence[str]) -> rrb.View:
    """A plot of a metric. The y axis of a ratio is fixed, since its first steps can be extreme."""
    contents = [f"{entity}/**" for entity in entities]
    span = (0.0, 4.0) if "ratio" in name else None
    # A single curve needs no legend. A long legend covers the plot; hovering shows the names too.
    dimensions = [e for e in entities if not e.endswith(("/all", "/reference"))]
    legend = rrb.Corner2D.RightTop if 2 <= len(dimensions) <= 7 else None
    return plot(name, contents, span=span, legend=legend)


def _pages(items: Sequence[Band], most: int) -> list[list[Band]]:
    """Divide the items into as few pages of at most `most` items as possible, of similar length."""
    count = -(-len(items) // most)
    length = -(-len(items) // count)
    return [list(items[start : start + length]) for start in range(0, len(items), length)]


def _training_view(metric: str) -> str:
    """The title of a metric's view."""
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
    distance_title: str = "Distance to the target [m]",
) -> rrb.Blueprint:
    """Training data: for each selected trajectory a tab with the 3D scene and every signal.

    Args:
        roots: entity root of each selected trajectory, by the tab's title.
        signals: title and entity of each signal, by its page.
        eyes: the viewpoint of each scene, by root. A root without one has no scene.
        close_up: the viewpoint of a close-up of the bodies; None for no close-up.
        distance_title: title of the plot of the distance.
    """
    tabs = []
    for title, root in roots.items():
        scene = ["/scene/**", f"{root}/scene/**"]
        paths = ["/paths/**", f"{root}/paths/**"]
        distance = plot(distance_title, ["/distance", f"{root}/distance", "/radius"], legend=None)
        below: rrb.View | rrb.Container = distance
        if close_up is not None:
            close = _scene("Close-up", scene, close_up, f"{root}/{FOLLOW}")
            below = rrb.Horizontal(close, distance)
        left = below
        if root in eyes:
            above = _scene("Paths", [*scene, *paths], eyes[root])
            left = rrb.Vertical(above, below, row_shares=[3, 2])
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
    """A whole study: the MMD² of all cells, in a plot for each environment, above the texts.

    Args:
        curves: the entities of each plot, by environment.
        horizons: the last step of each environment.
        span: the y axis of all plots, which makes environments comparable.
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
                # A third of the axis is free for the legend.
                times=(1, 4 * horizon // 3 if legible else horizon),
            )
        )
    panels = rrb.Tabs(*(readme(entity, title) for title, entity in texts.items()))
    right = rrb.Vertical(rrb.Horizontal(*plots), panels, row_shares=[3, 2])
    left = rrb.Vertical(readme(), readme(LEGEND, "Legend"), row_shares=[3, 2])
    return blueprint("horizon", rrb.Horizontal(left, right, column_shares=[1, 3]))


def _time_axis(first: int, last: int) -> rrb.TimeAxis:
    """An x axis from the time `first` to the time `last`."""
    ends = (rr.TimeRangeBoundary.absolute(seq=time) for time in (first, last))
    return rrb.TimeAxis(view_range=rr.TimeRange(*ends))


def _scene(
    name: str, contents: Sequence[str], eye: rrb.EyeControls3D, origin: str = "/"
) -> rrb.View:
    """A 3D view in the frame of the entity `origin`, without Rerun's grid."""
    return rrb.Spatial3DView(
        origin=origin, contents=list(contents), name=name, eye_controls=eye, line_grid=False
    )
