"""The design of a multiverse from the part ``multiverse`` of a YAML file. Every error is one line.

Such a part is

    multiverse:
      bases:
        study: {}                # the first value of every choice
        as_written: {variance: homoscedastic}
      random: 24
      further_seeds: [1]         # of the base readings
      choices:
        variance:
          question: Does the variance of the decoder depend on the past?
          values:
            heteroscedastic: {vae.variance: heteroscedastic}
            homoscedastic: {vae.variance: homoscedastic}
        target:
          question: Does the decoder predict the state itself or its change over a step?
          values:
            delta: {vae.target: delta}
            state: {vae.target: state}
      exclude:
        - values: {variance: homoscedastic, target: delta}
          reason: why no careful reader would combine the two
"""

import re
from collections.abc import Mapping
from typing import Any

from study.common.errors import BadInput, nearest, shown
from study.config.tree import known_settings, unknown_setting
from study.config.values import check_setting
from study.multiverse.design import Choice, Design, Exclusion, Values

PART = "multiverse"
"""The part of the file of settings that holds the design."""
KEYS = ("bases", "choices", "random", "seed", "further_seeds", "exclude")
NAME = re.compile(r"[a-z][a-z0-9_]*")


def design_from(content: Any) -> Design:
    """The checked design.

    Args:
        content: the part ``multiverse`` of a file, as YAML gives it.

    Raises:
        BadInput: names the place in the file, what was given and what is allowed.
    """
    if content is None:
        raise BadInput(f"{PART}: missing in the file of settings; see configs/multiverse.yaml")
    part = _mapping(PART, content)
    _check_keys(PART, part, KEYS, required=("bases", "choices"))
    choices = tuple(
        _choice(f"{PART}.choices.{name}", name, entry)
        for name, entry in _mapping(f"{PART}.choices", part["choices"]).items()
    )
    _check_disjoint(choices)
    bases = {
        name: _values(f"{PART}.bases.{name}", entry, choices, complete=True)
        for name, entry in _mapping(f"{PART}.bases", part["bases"]).items()
    }
    for name in (*bases, *(choice.name for choice in choices)):
        if not NAME.fullmatch(name):
            raise BadInput(f"{PART}: got the name {shown(name)}; use lower-case letters, 0-9, _")
    if not choices or not bases:
        raise BadInput(f"{PART}: needs at least one base reading and one choice")
    return Design(
        choices,
        bases,
        tuple(_exclusions(part.get("exclude", []), choices)),
        _whole_number(f"{PART}.random", part.get("random", 0)),
        _whole_number(f"{PART}.seed", part.get("seed", 0)),
        _seeds(f"{PART}.further_seeds", part.get("further_seeds", [])),
    )


def _choice(where: str, name: str, content: Any) -> Choice:
    entry = _mapping(where, content)
    _check_keys(where, entry, ("question", "values"), required=("question", "values"))
    if not isinstance(entry["question"], str):
        raise BadInput(f"{where}.question: got {shown(entry['question'])}; it must be text")
    values = {
        value: _settings(f"{where}.values.{value}", settings)
        for value, settings in _mapping(f"{where}.values", entry["values"]).items()
    }
    if len(values) < 2:
        raise BadInput(f"{where}.values: got {len(values)}; a choice needs at least 2 values")
    return Choice(name, entry["question"], values)


def _settings(where: str, content: Any) -> dict[str, Any]:
    """Checked settings by dotted name. A value without settings leaves them as they are."""
    known = known_settings()
    checked = {}
    for key, value in _mapping(where, content).items():
        if key not in known:
            raise unknown_setting(key, f" in {where}")
        setting = known[key]
        try:
            checked[key] = check_setting(
                key, setting.kind, value, setting.default, setting.metadata
            )
        except BadInput as error:
            raise BadInput(f"{where}: {error}") from None
    return checked


def _check_disjoint(choices: tuple[Choice, ...]) -> None:
    """Check that no setting belongs to two choices, since one would undo the other."""
    owner: dict[str, str] = {}
    for choice in choices:
        for key in {key for settings in choice.values.values() for key in settings}:
            if key in owner:
                raise BadInput(
                    f"{PART}.choices: the setting {key} is in {owner[key]} and in {choice.name}; "
                    "a setting may be in one choice only"
                )
            owner[key] = choice.name


def _values(where: str, content: Any, choices: tuple[Choice, ...], complete: bool) -> Values:
    """Names of values by the name of their choice.

    Args:
        where: the place in the file.
        content: of the place.
        choices: all choices.
        complete: whether choices without an entry get their first value.
    """
    given = {
        # YAML has numbers and true, but the names of values are text.
        name: value if isinstance(value, str) else shown(value)
        for name, value in _mapping(where, content).items()
    }
    by_name = {choice.name: choice for choice in choices}
    for name, value in given.items():
        if name not in by_name:
            raise BadInput(f"{where}: unknown choice {shown(name)}; {nearest(name, by_name)}")
        if value not in by_name[name].values:
            names = nearest(value, by_name[name].values)
            raise BadInput(f"{where}.{name}: got {shown(value)}; {names}")
    defaults = {name: choice.default for name, choice in by_name.items()} if complete else {}
    return {**defaults, **given}


def _exclusions(content: Any, choices: tuple[Choice, ...]) -> list[Exclusion]:
    where = f"{PART}.exclude"
    if not isinstance(content, list):
        raise BadInput(f"{where}: got {shown(content)}; it must be a list of rules")
    rules = []
    for number, item in enumerate(content, start=1):
        entry = _mapping(f"{where}, rule {number}", item)
        _check_keys(f"{where}, rule {number}", entry, ("values", "reason"), ("values", "reason"))
        values = _values(f"{where}, rule {number}", entry["values"], choices, complete=False)
        if len(values) < 2:
            raise BadInput(f"{where}, rule {number}: a combination needs at least 2 choices")
        rules.append(Exclusion(values, str(entry["reason"])))
    return rules


def _mapping(where: str, content: Any) -> Mapping[str, Any]:
    if not isinstance(content, Mapping):
        raise BadInput(f"{where}: got {shown(content)}; it must be a section of names and values")
    return content


def _check_keys(
    where: str, content: Mapping[str, Any], allowed: tuple[str, ...], required: tuple[str, ...]
) -> None:
    for key in content:
        if key not in allowed:
            raise BadInput(f"{where}: unknown entry {shown(key)}; {nearest(key, allowed)}")
    for key in required:
        if key not in content:
            raise BadInput(f"{where}: '{key}' is missing")


def _seeds(where: str, content: Any) -> tuple[int, ...]:
    if not isinstance(content, list):
        raise BadInput(f"{where}: got {shown(content)}; it must be a list of seeds, such as [1, 2]")
    seeds = tuple(_whole_number(where, seed) for seed in content)
    if len(set(seeds)) < len(seeds):
        raise BadInput(f"{where}: got {shown(content)}; a seed is there twice")
    return seeds


def _whole_number(where: str, value: Any) -> int:
    if type(value) is not int or not 0 <= value <= 10_000:
        raise BadInput(f"{where}: got {shown(value)}; it must be a whole number, at most 10000")
    return value
