"""``multiverse.rrd``: the effects of the claims in every universe, and a page about each universe.

The timeline `universe` counts the universes in the order of the effect of the first claim. A click
into a plot selects the universe at that position, and the panel *Universe* shows it.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import rerun as rr
import rerun.blueprint as rrb

from study.claims.claim import OURS, Claim
from study.claims.judge import CLAIMS, Outcome
from study.config.names import label
from study.metrics.tables.table import cell_name
from study.multiverse.effects import VERDICTS, curve, judged, shares
from study.multiverse.folder import Multiverse
from study.plotting.palette import REFERENCE, Colour, series
from study.plotting.palette import VERDICTS as PALETTE
from study.recording import blueprints
from study.recording.blueprints import Range
from study.recording.properties import Properties, table, write_markdown, write_readme
from study.recording.streams import (
    entity_path,
    finite,
    recording,
    send_scalars,
    style_lines,
    time_column,
)

KIND = "multiverse"
TIMELINE = "universe"
UNIVERSE, ROWS = "/universe", "/rows"
_CLAIMS_OF_TAB = 4
_METRICS = {"mmd2": "MMD²", "brier": "Brier score", "energy_score": "energy score"}
_CELL_COLUMNS = ("mmd2", "brier", "energy_score", "beta", "kl")
_README = """
# The multiverse

A *universe* is one reading of the paper: one value for every choice that the paper leaves open.
Every claim is judged in every universe.

**Click into a plot** to select the universe at that position: the panel *Universe* shows its
values, verdicts and scores. The arrow keys go to the next one.

- The plots of claims have a dot for the decisive effect in each universe, in the colour of the
  verdict. The grey lines are the ends of its 95 % interval. Effects of models that diverge may be
  outside the plot: zoom out to see them.
- The plot *Choices* has a dot for each value that a universe has. The panel *Rows* has their names.

The universes are in the order of the effect of this claim: *{first}*
"""


def record_multiverse(path: Path, multiverse: Multiverse, properties: Properties) -> None:
    """Write the recording of a multiverse.

    `/effect/CLAIM/VERDICT` holds the decisive effect of a claim in the universes with a verdict,
    `/interval/CLAIM` both ends of its interval, and `/choice/CHOICE/VALUE` the row of a value in
    the universes that have it. `/universe` holds a page for each universe.

    Args:
        path: the recording.
        multiverse: the results.
        properties: of the recording.
    """
    names = judged(multiverse.effects)
    claims = [claim for claim in CLAIMS if claim.id in names]
    order = order_of_universes(multiverse, names)
    tabs = _tabs(claims)
    spans = {claim.id: span_of(curve(multiverse.effects, claim.id)["effect"]) for claim in claims}
    with recording(path, KIND, properties, _layout(tabs, spans, len(order))) as stream:
        first = claims[0].text if claims else "none, since no claim has scores"
        write_readme(stream, _README.format(first=first), properties)
        for claim in claims:
            _log_claim(stream, curve(multiverse.effects, claim.id), claim.id, order)
        _log_choices(stream, multiverse, order)
        _log_universes(stream, multiverse, claims, order)


def order_of_universes(multiverse: Multiverse, claims: Sequence[str]) -> dict[str, int]:
    """The position of each universe with scores: by the effect of the first claim, if it has one.

    Args:
        multiverse: the results.
        claims: ids of the claims with effects.
    """
    first = list(curve(multiverse.effects, claims[0])["universe"]) if claims else []
    others = [name for name in multiverse.scored if name not in set(first)]
    return {name: position for position, name in enumerate([*first, *others])}


def _log_claim(
    stream: rr.RecordingStream, rows: pd.DataFrame, claim: str, order: Mapping[str, int]
) -> None:
    """The effects of a claim as dots in the colour of the verdict, and the ends of intervals."""
    rows = rows.assign(position=rows["universe"].map(order)).sort_values("position")
    entity = entity_path("interval", claim)
    style_lines(stream, entity, ["lower end", "upper end"], [REFERENCE] * 2, 0.8)
    ends = finite(rows[["low", "high"]].to_numpy())
    send_scalars(stream, entity, TIMELINE, rows["position"], ends)
    for verdict in VERDICTS:
        part = rows[rows["verdict"] == verdict.value]
        entity = entity_path("effect", claim, verdict.value)
        _style_dots(stream, entity, verdict.value, PALETTE[verdict.value], 4.0)
        if len(part):
            effects = finite(part["effect"].to_numpy())
            send_scalars(stream, entity, TIMELINE, part["position"], effects)


def _log_choices(
    stream: rr.RecordingStream, multiverse: Multiverse, order: Mapping[str, int]
) -> None:
    """A row of dots for each value, from the top down, and the names of the rows."""
    values, row, names = multiverse.values, 0, []
    for index, choice in enumerate(multiverse.design.choices):
        for value in choice.values:
            row -= 1
            chosen = [order[name] for name in order if values[name][choice.name] == value]
            entity = entity_path("choice", choice.name, value)
            _style_dots(stream, entity, f"{choice.name}: {value}", series(index), 3.0)
            if chosen:
                send_scalars(stream, entity, TIMELINE, sorted(chosen), np.full(len(chosen), row))
            names.append((str(row), choice.name, value, f"{len(chosen)}"))
        row -= 1
    text = table(("row", "choice", "value", "universes"), names)
    questions = [f"- **{choice.name}**: {choice.question}" for choice in multiverse.design.choices]
    write_markdown(stream, ROWS, "\n".join([text, "", *questions]))


def _style_dots(
    stream: rr.RecordingStream, entity: str, name: str, colour: Colour, size: float
) -> None:
    style = rr.SeriesPoints(
        names=[name],
        colors=[colour],
        marker_sizes=[size],
        markers=[rr.components.MarkerShape.Circle],
    )
    stream.log(entity, style, static=True)


def _log_universes(
    stream: rr.RecordingStream,
    multiverse: Multiverse,
    claims: Sequence[Claim],
    order: Mapping[str, int],
) -> None:
    """The page about each universe, at its position on the timeline."""
    if not order:
        write_markdown(stream, UNIVERSE, "No universe has scores.")
        return
    pages = [page(multiverse, claims, name) for name in order]
    media = [rr.MediaType.MARKDOWN] * len(pages)
    columns = rr.TextDocument.columns(text=pages, media_type=media)
    stream.send_columns(UNIVERSE, [time_column(TIMELINE, list(order.values()))], columns)


def page(multiverse: Multiverse, claims: Sequence[Claim], name: str) -> str:
    """The page about one universe, in Markdown: its values, the verdicts and the mean scores."""
    universe = next(u for u in multiverse.universes if u.name == name)
    effects = multiverse.effects[multiverse.effects["decisive"]]
    own = effects[effects["universe"] == name].set_index("claim")
    counts = own.loc[own["effect"].notna(), "verdict"].value_counts()
    reproduced = ", ".join(f"{counts.get(v.value, 0)} {v.value}" for v in VERDICTS)
    values = [
        (choice.name, f"**{universe.values[choice.name]}**") for choice in multiverse.design.choices
    ]
    verdicts = [
        (
            f"**{row['verdict']}**",
            f"{shares(multiverse.effects, claim.id)[Outcome(str(row['verdict']))]:.0%}",
            f"{row['effect']:+.4f} [{row['low']:+.4f}, {row['high']:+.4f}]",
            claim.text,
        )
        for claim in claims
        if claim.id in own.index and np.isfinite((row := own.loc[claim.id])["effect"])
    ]
    cells = multiverse.cells[multiverse.cells["universe"] == name]
    scores = [
        (
            cell_name(row),
            *(f"{row[column]:.4g}" if pd.notna(row[column]) else "" for column in _CELL_COLUMNS),
        )
        for row in cells.to_dict("records")
    ]
    return "\n\n".join(
        [
            f"# {name}",
            f"{reproduced}.",
            table(("choice", "value"), values),
            "## Claims",
            table(("verdict", "share of universes", "effect", "claim"), verdicts),
            "## Scores",
            table(("cell", *_CELL_COLUMNS), scores),
            f"Run this universe alone: `python -m study.run multiverse --universes '{name}'`",
        ]
    )


def _tabs(claims: Sequence[Claim]) -> dict[str, list[Claim]]:
    """At most `_CLAIMS_OF_TAB` claims for each tab, by its title: the metric and the system."""
    groups: dict[str, list[Claim]] = {}
    for claim in claims:
        quantities = [quantity for c in claim.contrasts for _, quantity in c.terms]
        systems = dict.fromkeys(label(quantity.environment) for quantity in quantities)
        metric = _METRICS.get(quantities[0].metric, "variance")
        title = "checks" if claim.section == OURS else f"{metric}, {' and '.join(systems)}"
        groups.setdefault(title, []).append(claim)
    tabs = {}
    for title, group in groups.items():
        for first in range(0, len(group), _CLAIMS_OF_TAB):
            number = f" ({first // _CLAIMS_OF_TAB + 1})" if len(group) > _CLAIMS_OF_TAB else ""
            tabs[title + number] = group[first : first + _CLAIMS_OF_TAB]
    return tabs


def span_of(effects: "pd.Series[float]") -> Range:
    """The range of a plot: 0, and most effects of a claim.

    A model that diverges has an effect that is many times the others, and would hide them. So the
    range is that of 0 and the central 80 % of the effects, made twice as wide.
    """
    found = effects[np.isfinite(effects)]
    low, high = np.quantile(found, [0.1, 0.9]) if len(found) else (0.0, 0.0)
    low, high = min(float(low), 0.0), max(float(high), 0.0)
    margin = max((high - low) / 2, 1e-3)
    return low - margin, high + margin


def _layout(
    tabs: Mapping[str, Sequence[Claim]], spans: Mapping[str, Range], count: int
) -> rrb.Blueprint:
    times = (-1, count)
    pages = []
    for title, claims in tabs.items():
        plots = [
            blueprints.plot(
                claim.text,
                [f"{entity_path(kind, claim.id)}/**" for kind in ("interval", "effect")],
                legend=None,
                span=spans[claim.id],
                times=times,
            )
            for claim in claims
        ]
        choices = blueprints.plot("Choices", ["/choice/**"], legend=None, times=times)
        pages.append(
            rrb.Vertical(blueprints.grid(plots, 2), choices, row_shares=[3, 2], name=title)
        )
    notes = rrb.Tabs(blueprints.readme(), blueprints.readme(ROWS, "Rows"))
    left = rrb.Vertical(blueprints.readme(UNIVERSE, "Universe"), notes, row_shares=[3, 2])
    if not pages:
        return blueprints.blueprint(TIMELINE, left)
    right = rrb.Horizontal(left, rrb.Tabs(*pages), column_shares=[2, 3])
    return blueprints.blueprint(TIMELINE, right)
