"""The properties of a recording and its text panels."""

import json
from collections.abc import Mapping, Sequence

import pyarrow as pa
import rerun as rr

Property = str | int | float
Properties = Mapping[str, Property]

README = "/readme"
# Rerun stores all properties of a recording as the fields of one property of this name.
GROUP = "study"


def write_properties(stream: rr.RecordingStream, name: str, properties: Properties) -> None:
    """Set the name of the recording and its properties, such as cell, seed and settings."""
    stream.send_recording_name(name)
    if properties:
        # Rerun drops a bare value if an earlier property of the same name in this process had
        # another type. A seed may be a number in one recording and text in another, for example.
        typed = {name: pa.array([value]) for name, value in properties.items()}
        stream.send_property(GROUP, rr.AnyValues(**typed))


def write_readme(stream: rr.RecordingStream, text: str, properties: Properties) -> None:
    """Write the README panel: `text` (Markdown), then every property in a table."""
    write_markdown(stream, README, f"{text.strip()}\n\n{describe(properties)}")


def write_markdown(stream: rr.RecordingStream, entity: str, text: str) -> None:
    """Write a static panel of Markdown."""
    stream.log(entity, rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=True)


def describe(properties: Properties) -> str:
    """The properties in Markdown: a table, and an indented block for each JSON value."""
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
        "| " + " | ".join(cell.replace("|", r"\|") for cell in row) + " |" for row in lines
    )


def _indented(value: str) -> str | None:
    """`value` with indentation if it is a JSON object or list, else None."""
    try:
        parsed = json.loads(value)
    except ValueError:
        return None
    if not isinstance(parsed, dict | list):
        return None
    return json.dumps(parsed, indent=2, ensure_ascii=False)
