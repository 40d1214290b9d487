"""What a recording says about itself: its properties and its README panel."""

import json
from collections.abc import Mapping, Sequence

import pyarrow as pa
import rerun as rr

Property = str | int | float
Properties = Mapping[str, Property]

README = "/readme"
# The one property that Rerun files under this name holds all of ours.
GROUP = "study"


def write_properties(stream: rr.RecordingStream, name: str, properties: Properties) -> None:
    """Name the recording, and attach its properties (cell, seed, config as JSON, versions …)."""
    stream.send_recording_name(name)
    if properties:
        # Given bare values, Rerun drops one whose type differs from the last of that name in this
        # process: a seed that is a number here, and text there.
        typed = {name: pa.array([value]) for name, value in properties.items()}
        stream.send_property(GROUP, rr.AnyValues(**typed))


def write_readme(stream: rr.RecordingStream, text: str, properties: Properties) -> None:
    """The README panel: `text` (Markdown), then every property in a table."""
    write_markdown(stream, README, f"{text.strip()}\n\n{describe(properties)}")


def write_markdown(stream: rr.RecordingStream, entity: str, text: str) -> None:
    """A Markdown panel that holds for all time."""
    stream.log(entity, rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=True)


def describe(properties: Properties) -> str:
    """The properties in Markdown; a value that is JSON becomes an indented block of its own."""
    short, blocks = [], []
    for key, value in properties.items():
        block = _indented(value) if isinstance(value, str) else None
        if block is None:
            short.append((key, str(value)))
        else:
            blocks.append(f"## {key}\n\n```json\n{block}\n```\n")
    lines = [table(("property", "value"), short)] if short else []
    return "\n\n".join([*lines, *blocks])


def table(header: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> str:
    """A Markdown table."""
    lines = [header, ("---",) * len(header), *rows]
    return "\n".join(
        "| " + " | ".join(cell.replace("|", r"\|") for cell in r) + " |" for r in lines
    )


def _indented(value: str) -> str | None:
    """`value` as indented JSON if it is a JSON object or list."""
    try:
        parsed = json.loads(value)
    except ValueError:
        return None
    return (
        json.dumps(parsed, indent=2, ensure_ascii=False)
        if isinstance(parsed, dict | list)
        else None
    )
